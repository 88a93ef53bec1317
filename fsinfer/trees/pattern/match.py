"""Where a part of a plot lies in the rest: by the pattern of the stems that both saw.

Stems stand still, and no two pairs of them are alike: their distances, diameters and the ground under them tell how two
maps lie on each other, without any photo or board that both have. Scans of forests are registered so (Henning and
Radtke 2008; Kelbe et al. 2016). Every pair of stems of the part that has a pair like it in the rest proposes a turn and
a shift about the vertical. The place at which most stems fall on stems is believed where chance would hardly do as
much (a contrario: Desolneux, Moisan and Morel 2000), where no other place does nearly as well (rows of a plantation
look alike after a step), and where both maps do not miss what the other one saw.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from fsinfer.trees.points.sums import Z95
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]

#: Places whose shift of the part's middle differs by more than this, metres, or whose turn by more than so many
#: degrees, are two. Source: judgement; no two stems stand so near to each other.
_OTHER_PLACE_M, _OTHER_TURN_DEG = 0.7, 6.0
#: Proposals that are looked at in one go. Source: numerics, memory.
_AT_ONCE = 2048
#: Rounds of fitting to the stems that agree and looking again who agrees. Source: numerics.
_ROUNDS = 4


@dataclass(frozen=True, kw_only=True)
class PatternSettings:
    """When two stem maps are believed to lie on each other.

    Attributes
    ----------
    reach_m: two entries this near are one stem, metres. Source: judgement; axes of stems seen from two sides lie some
        centimetres apart, those without a DBH a decimetre.
    height_m: and the ground under them differs by less than this from the usual difference, metres. Source: judgement;
        two levels that differ by a degree tell heights 10 m away 0.2 m apart.
    least_base_m: pairs of stems nearer to each other propose no turn, metres. Source: geometry; 0.2 m on 2 m turn the
        rest by 6 degrees.
    dbh_sds: two sound diameters of one stem differ by so many standard deviations at most. Source: statistics, 99.7 %.
    dbh_sd_m: to these deviations this is added, metres, for what intervals do not know. Source: judgement; stems seen
        from one side are wrong by a centimetre now and then.
    by_chance: so many places as good as the one found are expected among stems strewn at random, at most. Source:
        judgement; one walk in hundreds is torn, and a thousandth of these would be joined wrongly.
    rival_share: no other place agrees with more than this share of the stems. Source: judgement.
    seen_share: of the measured stems on ground that both saw at least this share agree. Source: judgement; of stems
        seen from far off a third is missed.
    """

    reach_m: float = 0.2
    height_m: float = 0.4
    least_base_m: float = 2.0
    dbh_sds: float = 3.0
    dbh_sd_m: float = 0.01
    by_chance: float = 1e-3
    rival_share: float = 0.6
    seen_share: float = 0.5


@dataclass(frozen=True, kw_only=True)
class StemMap:
    """Stems of one map: ``xyz`` (N, 3) metres, z the ground; ``dbh_m`` and ``sd_m`` (N,), NaN where not sound."""

    xyz: Floats
    dbh_m: Floats
    sd_m: Floats

    def __len__(self) -> int:
        return len(self.xyz)

    @classmethod
    def of(cls, trees: Sequence[Tree]) -> StemMap:
        """Of trees in metres; a doubtful diameter tells nothing here."""
        sound = [tree.status == "ok" and tree.dbh_cm is not None for tree in trees]
        dbh = [(tree.dbh_cm or 0.0) / 100.0 if ok else np.nan for tree, ok in zip(trees, sound, strict=True)]
        half = [tree.half95_cm / 100.0 if ok else np.nan for tree, ok in zip(trees, sound, strict=True)]
        return cls(
            xyz=np.array([[tree.x_m, tree.y_m, tree.z_ground_m] for tree in trees], np.float64).reshape(-1, 3),
            dbh_m=np.array(dbh, np.float64),
            sd_m=np.array(half, np.float64) / Z95,
        )


@dataclass(frozen=True, kw_only=True)
class PatternMatch:
    """A part's place: ``rest_from_part`` (4, 4), a turn about the vertical and a shift, in metres.

    Attributes
    ----------
    ours, theirs: (K,) indices of the stems that fall on each other.
    rms_m: of their distances, horizontally. by_chance: places as good as this expected among stems strewn at random.
    """

    rest_from_part: Floats
    ours: Ints
    theirs: Ints
    rms_m: float
    by_chance: float


def match_stems(ours: StemMap, theirs: StemMap, *, settings: PatternSettings | None = None) -> PatternMatch | None:
    """Where ``theirs`` lies in ``ours``; None where the pattern does not tell it beyond doubt."""
    settings = settings or PatternSettings()
    if min(len(ours), len(theirs)) < 3:
        return None
    like = _alike(ours, theirs, settings)
    turns, shifts = _proposals(ours, theirs, like, settings)
    if not len(turns):
        return None
    counts = np.concatenate(list(_counts(ours, theirs, like, turns, shifts, settings)))
    places: list[tuple[complex, complex, Ints, Ints]] = []
    middle = _complex(theirs).mean()
    for index in np.argsort(-counts, kind="stable"):
        if places and counts[index] <= settings.rival_share * len(places[0][2]) - 1:
            break
        place = _refined(ours, theirs, like, complex(turns[index]), complex(shifts[index]), settings)
        if all(_differ(place, other, middle) for other in places):
            places.append(place)
    places.sort(key=lambda entry: -len(entry[2]))
    turn, shift, mine, its = places[0]
    if len(mine) < 3 or any(len(other[2]) > settings.rival_share * len(mine) for other in places[1:]):
        return None
    chance = len(turns) * _tail(_by_chance_each(ours, like, settings), len(mine) - 2)
    if chance > settings.by_chance or not _sees_the_same(ours, theirs, (turn, shift), (mine, its), settings):
        return None
    apart = _complex(ours)[mine] - (turn * _complex(theirs)[its] + shift)
    matrix = np.eye(4)
    matrix[:2, :2] = [[turn.real, -turn.imag], [turn.imag, turn.real]]
    matrix[:3, 3] = shift.real, shift.imag, np.median(ours.xyz[mine, 2] - theirs.xyz[its, 2])
    rms = float(np.sqrt(np.mean(np.abs(apart) ** 2)))
    return PatternMatch(rest_from_part=matrix, ours=mine, theirs=its, rms_m=rms, by_chance=chance)


def _complex(stems: StemMap) -> NDArray[np.complex128]:
    """Places on the map as x + iy: a turn is a product."""
    return np.asarray(stems.xyz[:, 0] + 1j * stems.xyz[:, 1], np.complex128)


def _alike(ours: StemMap, theirs: StemMap, settings: PatternSettings) -> NDArray[np.bool_]:
    """Whether a stem of ours and one of theirs may be the same by their diameters, (M, N); unknown ones may."""
    apart = np.abs(ours.dbh_m[:, None] - theirs.dbh_m[None])
    sd = np.sqrt(ours.sd_m[:, None] ** 2 + theirs.sd_m[None] ** 2 + settings.dbh_sd_m**2)
    return np.asarray(~(apart > settings.dbh_sds * sd))  # NaN is not larger


def _proposals(
    ours: StemMap, theirs: StemMap, like: NDArray[np.bool_], settings: PatternSettings
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Turns and shifts (P,) of pairs of theirs that have a pair like them in ours."""
    z, w = _complex(ours), _complex(theirs)
    between = z[:, None] - z[None]
    turns, shifts = [], []
    for i in range(len(w)):
        for j in range(i + 1, len(w)):
            base = w[i] - w[j]
            if abs(base) < settings.least_base_m:
                continue
            fits = np.abs(np.abs(between) - abs(base)) < 2.0 * settings.reach_m
            first, second = np.nonzero(fits & like[:, i][:, None] & like[:, j][None])
            turn = between[first, second] / base
            turn /= np.abs(turn)
            turns.append(turn)
            shifts.append(0.5 * (z[first] + z[second]) - turn * 0.5 * (w[i] + w[j]))
    none = np.zeros(0, np.complex128)
    return np.concatenate([none, *turns]), np.concatenate([none, *shifts])


def _counts(
    ours: StemMap,
    theirs: StemMap,
    like: NDArray[np.bool_],
    turns: NDArray[np.complex128],
    shifts: NDArray[np.complex128],
    settings: PatternSettings,
) -> Iterator[Ints]:
    """How many of theirs fall on a stem of ours that is like them, for each proposal."""
    z, w = _complex(ours), _complex(theirs)
    for start in range(0, len(turns), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        placed = turns[some, None] * w + shifts[some, None]
        near = (np.abs(z[None, :, None] - placed[:, None]) < settings.reach_m) & like[None]
        yield np.asarray(np.minimum(near.any(axis=1).sum(axis=1), near.any(axis=2).sum(axis=1)), np.intp)


def _agreeing(
    ours: StemMap, theirs: StemMap, like: NDArray[np.bool_], turn: complex, shift: complex, settings: PatternSettings
) -> tuple[Ints, Ints]:
    """Stems of ours and theirs that are each other's nearest within reach, at the same height."""
    apart = np.abs(_complex(ours)[:, None] - (turn * _complex(theirs) + shift)[None])
    apart = np.where(like & (apart < settings.reach_m), apart, np.inf)
    mine = np.argmin(apart, axis=0)
    mutual = np.isfinite(apart.min(axis=0)) & (np.argmin(apart, axis=1)[mine] == np.arange(len(theirs)))
    mine, its = mine[mutual], np.flatnonzero(mutual)
    rise = ours.xyz[mine, 2] - theirs.xyz[its, 2]
    level = np.abs(rise - np.median(rise)) < settings.height_m if len(rise) else np.zeros(0, np.bool_)
    return np.asarray(mine[level], np.intp), np.asarray(its[level], np.intp)


def _refined(
    ours: StemMap, theirs: StemMap, like: NDArray[np.bool_], turn: complex, shift: complex, settings: PatternSettings
) -> tuple[complex, complex, Ints, Ints]:
    """Least squares (Procrustes) over the stems that agree, which may become more by it."""
    z, w = _complex(ours), _complex(theirs)
    best = (turn, shift, *_agreeing(ours, theirs, like, turn, shift, settings))
    for _ in range(_ROUNDS):
        mine, its = best[2], best[3]
        if len(mine) < 2:
            return best
        product = complex(np.vdot(w[its] - w[its].mean(), z[mine] - z[mine].mean()))
        if abs(product) == 0.0:
            return best
        turn = product / abs(product)
        shift = complex(z[mine].mean() - turn * w[its].mean())
        again = (turn, shift, *_agreeing(ours, theirs, like, turn, shift, settings))
        if len(again[2]) < len(mine):
            return best
        best = again
    return best


def _differ(
    one: tuple[complex, complex, Ints, Ints], other: tuple[complex, complex, Ints, Ints], middle: complex
) -> bool:
    """Whether two places of the part, given by its ``middle``, are not the same but for errors."""
    shift = abs(one[0] * middle + one[1] - other[0] * middle - other[1])
    return bool(shift > _OTHER_PLACE_M or abs(np.angle(one[0] / other[0], deg=True)) > _OTHER_TURN_DEG)


def _by_chance_each(ours: StemMap, like: NDArray[np.bool_], settings: PatternSettings) -> Floats:
    """Of each of their stems the probability that, put anywhere, it falls on one of ours like it, (N,)."""
    area = max(_hull_area(ours.xyz[:, :2]), np.pi * settings.reach_m**2)
    return np.asarray(np.minimum(like.sum(axis=0) * np.pi * settings.reach_m**2 / area, 1.0), np.float64)


def _tail(each: Floats, least: int) -> float:
    """Probability that of independent events with probabilities ``each`` (N,) at least so many happen.

    The two stems that proposed the place are not evidence: the two least likely ones are left out, which is on the
    safe side.
    """
    exactly: Floats = np.array([1.0])
    for p in np.sort(each)[2:]:
        exactly = np.convolve(exactly, [1.0 - p, p])
    return float(exactly[max(least, 0) :].sum())


def _sees_the_same(
    ours: StemMap,
    theirs: StemMap,
    place: tuple[complex, complex],
    pairs: tuple[Ints, Ints],
    settings: PatternSettings,
) -> bool:
    """Whether of the soundly measured stems on ground among the other's stems enough are the other's, too."""
    turn, shift = place
    moved = turn * _complex(theirs) + shift
    placed = np.stack([moved.real, moved.imag], axis=1)
    for stems, xy, other, matched in (
        (theirs, placed, ours.xyz[:, :2], pairs[1]),
        (ours, ours.xyz[:, :2], placed, pairs[0]),
    ):
        common = np.isin(np.arange(len(stems)), matched)
        among = (common | _within_hull(xy, other)) & np.isfinite(stems.dbh_m)
        if np.count_nonzero(among & common) < settings.seen_share * np.count_nonzero(among):
            return False
    return True


def _hull_area(xy: Floats) -> float:
    try:
        return float(ConvexHull(xy).volume)  # of two dimensions it is the area
    except QhullError:
        return 0.0


def _within_hull(xy: Floats, corners: Floats) -> NDArray[np.bool_]:
    """Whether places (N, 2) lie in the convex hull of others."""
    try:
        sides = ConvexHull(corners).equations
    except QhullError:
        return np.zeros(len(xy), np.bool_)
    return np.asarray((xy @ sides[:, :2].T + sides[:, 2] <= 0.0).all(axis=1))

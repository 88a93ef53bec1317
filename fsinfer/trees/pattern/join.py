"""The stems of parts of a walk in the table of the plot: each stem once.

A part was measured by itself, in a frame and on a scale of its own. Where the pattern of its stems tells how it lies on
the rest, its stems are put there. The clouds are not put together: the pattern is good to some centimetres, which is
enough to name a stem and too little to measure a wall that both saw.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.geometry.similarity import apply
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.one_entry import trust_rank
from fsinfer.trees.pattern.match import PatternMatch, PatternSettings, StemMap, match_stems
from fsinfer.trees.points.sums import Z95
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
#: Two diameters of one stem contradict each other beyond so many standard deviations of their difference. Source:
#: statistics, 99.7 %.
_CONTRADICT_SDS = 3.0
#: An entry of the part that no stem of the pattern is, but that lies this near to one of the rest, metres, is that stem
#: none the less. Source: judgement; haze far from all cameras lies decimetres from its stem.
_REACH_M = 0.3


@dataclass(frozen=True, kw_only=True)
class PartStems:
    """The stems of a part, in metres of its own frame, z up; ``name`` is that of its folder."""

    name: str
    trees: tuple[Tree, ...]


@dataclass(frozen=True, kw_only=True)
class JoinedPart:
    """A part whose stems are in the plot's table.

    Attributes
    ----------
    name: of its folder.
    common: stems that the rest saw, too; new: those that it did not.
    apart_m: RMS distance of the common ones, horizontally.
    by_chance: places as good as this expected among stems strewn at random.
    plot_from_part: (4, 4), from the part's frame to that of the plot.
    """

    name: str
    common: int
    new: int
    apart_m: float
    by_chance: float
    plot_from_part: Floats


@dataclass(frozen=True, kw_only=True)
class JoinedStems:
    """One entry a stem: of the rest those that ``stay``, and those that parts measured (``joined``).

    ``numbers`` are those that the joined ones have in their parts, by their number in the plot.
    """

    stay: tuple[Tree, ...]
    joined: tuple[Tree, ...]
    parts: tuple[JoinedPart, ...]
    numbers: dict[int, int]
    warnings: tuple[Notice, ...]


def join_parts(
    trees: Sequence[Tree],
    parts: Sequence[PartStems],
    *,
    settings: PatternSettings | None = None,
    gone: Sequence[Tree] = (),
) -> JoinedStems:
    """Put the stems of each part whose place the pattern tells into the plot.

    A stem that both measured keeps the surer entry: by its status, then by its relative interval. Its number is that
    of the rest. Where the two diameters contradict each other, the interval holds both and the stem is doubtful. Parts
    are tried again after others were joined, so that one may tie the next.

    Parameters
    ----------
    trees: of the rest, in metres; those outside of the walk count as seen, and give way to a part that measured them.
    gone: those that a person took out of it: what a part has there is no new stem.
    """
    now = list(trees)
    numbers: dict[int, int] = {}
    done: list[JoinedPart] = []
    left = list(parts)
    while left:
        found = ((part, _match(now, part, settings)) for part in left)
        part, match = next(((part, match) for part, match in found if match is not None), (None, None))
        if part is None or match is None:
            break
        left.remove(part)
        now, common, new = _put(now, part, match, numbers, gone)
        done.append(
            JoinedPart(
                name=part.name,
                common=common,
                new=new,
                apart_m=match.rms_m,
                by_chance=match.by_chance,
                plot_from_part=match.rest_from_part,
            )
        )
    return JoinedStems(
        stay=tuple(tree for tree in now if tree.part is None),
        joined=tuple(tree for tree in now if tree.part is not None),
        parts=tuple(done),
        numbers=numbers,
        warnings=tuple(
            notice(StemCode.part_joined, folder=one.name, common=one.common, new=one.new, apart_cm=100.0 * one.apart_m)
            for one in done
        ),
    )


def _match(trees: Sequence[Tree], part: PartStems, settings: PatternSettings | None) -> PatternMatch | None:
    """By the stems of both walks; ``ours`` and ``theirs`` index all trees."""
    ours = [i for i, tree in enumerate(trees) if not tree.outside]
    theirs = [i for i, tree in enumerate(part.trees) if not tree.outside]
    match = match_stems(
        StemMap.of([trees[i] for i in ours]), StemMap.of([part.trees[i] for i in theirs]), settings=settings
    )
    if match is None:
        return None
    return replace(match, ours=np.array(ours, np.intp)[match.ours], theirs=np.array(theirs, np.intp)[match.theirs])


def _put(
    trees: Sequence[Tree], part: PartStems, match: PatternMatch, numbers: dict[int, int], gone: Sequence[Tree]
) -> tuple[list[Tree], int, int]:
    """The trees with those of the part, and how many of its stems were there already and how many are new."""
    now = list(trees)
    free = set(range(len(trees))) - set(match.ours.tolist())
    same = dict(zip(match.theirs.tolist(), match.ours.tolist(), strict=True))
    first_free = max((tree.tree_id for tree in now), default=0) + 1
    common = new = 0
    places = np.array([[tree.x_m, tree.y_m, tree.z_ground_m] for tree in part.trees]).reshape(-1, 3)
    for index, (tree, (x, y, z)) in enumerate(zip(part.trees, apply(match.rest_from_part, places), strict=True)):
        moved = replace(tree, x_m=float(x), y_m=float(y), z_ground_m=float(z), part=part.name)
        at = same[index] if index in same else _standing_in(moved, trees, free)
        free.discard(-1 if at is None else at)
        if at is None:
            if tree.outside or _standing_in(moved, gone, range(len(gone))) is not None:
                continue
            numbers[first_free] = tree.tree_id
            now.append(replace(moved, tree_id=first_free))
            first_free, new = first_free + 1, new + 1
            continue
        common += not tree.outside
        mine = now[at]
        # It was seen from within the walk of one of them.
        better, worse = (moved, mine) if _rank(moved) < _rank(mine) else (mine, moved)
        if better is moved:
            numbers[mine.tree_id] = tree.tree_id
        now[at] = _agreed(replace(better, tree_id=mine.tree_id), worse)
    return now, common, new


def _standing_in(tree: Tree, others: Sequence[Tree], which: Collection[int]) -> int | None:
    """Index of the stem, of those in ``which``, that a tree stands in or within reach of; of several the nearest."""
    apart = {i: float(np.hypot(tree.x_m - others[i].x_m, tree.y_m - others[i].y_m)) for i in which}
    near = [i for i in which if apart[i] < max(_REACH_M, tree.radius_m + others[i].radius_m)]
    return min(near, key=apart.__getitem__, default=None)


def _rank(tree: Tree) -> tuple[bool, int, float, float]:
    width = float("inf") if not tree.dbh_cm else tree.half95_cm / tree.dbh_cm
    return tree.outside, trust_rank(tree), width, -tree.arc_coverage


def _agreed(better: Tree, worse: Tree) -> Tree:
    """The better entry; doubtful, with an interval that holds both, where a sound other one contradicts it."""
    one, other = better.dbh_cm, worse.dbh_cm
    if one is None or other is None or worse.status != "ok" or better.status != "ok":
        return better
    sd = float(np.hypot(better.half95_cm, worse.half95_cm)) / Z95
    if abs(one - other) <= _CONTRADICT_SDS * sd:
        return better
    lo = min(entry for tree in (better, worse) if (entry := tree.dbh_lo95_cm) is not None)
    hi = max(entry for tree in (better, worse) if (entry := tree.dbh_hi95_cm) is not None)
    said = notice(StemCode.parts_disagree, other_cm=other)
    return replace(better, dbh_lo95_cm=lo, dbh_hi95_cm=hi, status="doubtful", reasons=(*better.reasons, said))

"""Tree height, where the top was plausibly seen: most photographs and many scans end below it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.conventions.breast_height import BREAST_HEIGHT_M
from fsinfer.trees.points.cells import PlanIndex, rows, thin
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.search.stem import Stem

Floats = NDArray[np.float64]


#: Crowns are thinned to cells of this width, metres: their form, not their density, tells the top. Source: numerics.
CELL_M = 0.05
#: Cell of the index of crowns, metres, of the order of a crown's radius. Source: numerics.
INDEX_CELL_M = 0.5
#: Above it lies what may be crown, metres; below stand shrubs. Source: not recorded.
FOOT_M = 1.0
#: Least points of a crown, and of a layer that is not empty. Source: not recorded.
LEAST_POINTS, LEAST_OF_LAYER = 20, 3
#: The top of a tree, metres below its height. Source: judgement; two layers.
TOP_M = 1.0
#: The spread of the upper third is told by this percentile of the distances. Source: not recorded.
SPREAD_PERCENTILE = 80


@dataclass(frozen=True, kw_only=True)
class TopSettings:
    """Constants of :func:`tree_height`.

    Attributes
    ----------
    crown_radius_m: about the continued axis; wider takes in the neighbours' crowns. Source: not recorded.
    reach_m: from the stem's place at breast height; leaning tops farther off are not followed. Source: not recorded.
    lean_share: heavy leans measured over two metres must not be continued over twenty. Source: not recorded.
    at_side: what is found along it lies at the side of what is looked at where its top metre is so much of the crown's
        radius aside: then the tree may be straight, and is looked for along all of its lean. Source: simulated trees of
        10 to 25 m that lean by up to 20 degrees; a top that the cylinder cuts off is 0.7 and more aside.
    layer_m: layers in which a gap is looked for. Source: not recorded.
    max_gap_m: a longer empty stretch separates a tree from what hangs above it. Source: not recorded.
    min_height_m: lower tops are shrubs or cuts. Source: not recorded.
    min_slenderness: height over diameter. Source: forest trees have 50-120, open-grown ones 30-50.
    crown_spread: the upper third must spread wider than this times the stem's radius. Source: not recorded.
    thinning: points in the top layer against the crown's densest: a crown tapers, a cut does not. Source: not recorded.
    tip_spread: what ends below a gap with more above it is a top where its highest metre spreads by less than this
        times the widest metre of the upper two thirds; else the tree may go on behind what hid it. Source: gaps cut
        into the columns of scanned pines; 19 of 20 end wider.
    bare_spread: ... unless it spreads by less than this times the diameter: that is bark, and the stem goes on. Source:
        bark spreads by half of the diameter, and is noisy; tips of scanned pines spread by 0.9 and more.
    max_slenderness: what is higher than this times the diameter is not carried by it: another tree's crown, above a gap
        or without one. Source: suppressed trees of dense stands have up to 150.
    """

    crown_radius_m: float = 0.8
    reach_m: float = 4.0
    lean_share: float = 0.5
    at_side: float = 0.5
    layer_m: float = 0.5
    max_gap_m: float = 1.5
    min_height_m: float = 3.0
    min_slenderness: float = 35.0
    crown_spread: float = 2.0
    thinning: float = 0.6
    tip_spread: float = 0.5
    bare_spread: float = 0.6
    max_slenderness: float = 150.0


@dataclass(frozen=True, kw_only=True)
class _Top:
    """Where what stands about an axis ends, how far aside of it, metres, and whether the tree may go on above a gap."""

    height_m: float
    aside_m: float
    may_go_on: bool


def axis_path(
    stem: Stem,
    highest_m: float,
    *,
    bh_m: float = BREAST_HEIGHT_M,
    lean_share: float | None = None,
    settings: TopSettings | None = None,
) -> tuple[Floats, Floats]:
    """Where the continued axis stands in plan at 1 m above the ground and ``highest_m``, or leaves reach (2,).

    It leans by ``lean_share`` of what was measured, without it by that of the settings.
    """
    s = settings or TopSettings()
    start = stem.axis.center_at(bh_m)
    slope = stem.axis.parameters[2:4] * (s.lean_share if lean_share is None else lean_share)
    rise = max(highest_m, bh_m) - bh_m
    lean = float(np.hypot(*slope))
    rise = min(rise, (s.reach_m + s.crown_radius_m) / lean) if lean > 0 else rise
    return start - (bh_m - FOOT_M) * slope, start + rise * slope


def lean_shares(
    stem: Stem, highest_m: float, *, bh_m: float = BREAST_HEIGHT_M, settings: TopSettings | None = None
) -> tuple[float, ...]:
    """The shares of its lean along which a stem is looked for up to ``highest_m``: one where more would be the same."""
    s = settings or TopSettings()
    apart = (1.0 - s.lean_share) * float(np.hypot(*stem.axis.parameters[2:4])) * (highest_m - bh_m)
    return (s.lean_share,) if apart <= s.at_side * s.crown_radius_m else (s.lean_share, 1.0)


def top_may_be_seen(stem: Stem, dbh_m: float | None, highest_m: float, *, settings: TopSettings | None = None) -> bool:
    """Whether the cloud reaches so high that it may show the top of a tree of that diameter."""
    s = settings or TopSettings()
    diameter = dbh_m if dbh_m is not None else 2.0 * stem.axis.radius_m
    return highest_m >= max(s.min_height_m, s.min_slenderness * diameter)


def tree_height(
    stand: PlanIndex,
    stem: Stem,
    centers: Floats,
    number: int,
    dbh_m: float | None,
    *,
    level_m: float = 0.0,
    highest_m: float,
    bh_m: float = BREAST_HEIGHT_M,
    settings: TopSettings | None = None,
) -> float | None:
    """Height of the stem's top above the ground at its foot, from an index of x, y, z; None where it was not seen.

    ``level_m`` is the z of that ground, above which ``stem`` is given too; no point of its crown is more than
    ``highest_m`` above it. The index holds what stands above the ground, without the ground itself. Points nearer to
    another stem's position in ``centers`` (T, 2) are left to that one. Where a gap ends what is seen and more that may
    be this tree's is above it, there is a height only if it ends in a top.
    """
    s = settings or TopSettings()
    if not top_may_be_seen(stem, dbh_m, highest_m, settings=s):
        return None
    for lean_share in lean_shares(stem, highest_m, bh_m=bh_m, settings=s):
        top = _top_along(stand, stem, centers, number, dbh_m, lean_share, level_m, highest_m, bh_m, s)
        if top is None:
            return None
        straight = len(lean_shares(stem, top.height_m, bh_m=bh_m, settings=s)) == 1
        if top.aside_m <= s.at_side * s.crown_radius_m or straight:
            return None if top.may_go_on else top.height_m
    return None


def _top_along(
    stand: PlanIndex,
    stem: Stem,
    centers: Floats,
    number: int,
    dbh_m: float | None,
    lean_share: float,
    level_m: float,
    highest_m: float,
    bh_m: float,
    s: TopSettings,
) -> _Top | None:
    """The top about the axis continued by so much of its lean."""
    start = stem.axis.center_at(bh_m)
    slope = stem.axis.parameters[2:4] * lean_share
    # All that lies within the crown's radius of the continued axis and within reach, found by one disc about both.
    low, high = axis_path(stem, highest_m, bh_m=bh_m, lean_share=lean_share, settings=s)
    disc = stand.near(0.5 * (low + high), s.crown_radius_m + 0.5 * float(np.hypot(*(high - low))))
    disc = disc - np.array([0.0, 0.0, level_m])
    x, y, rise = disc[:, 0] - start[0], disc[:, 1] - start[1], disc[:, 2] - bh_m
    inside = (x * x + y * y <= s.reach_m**2) & (disc[:, 2] > FOOT_M)
    x -= slope[0] * rise
    y -= slope[1] * rise
    inside &= x * x + y * y <= s.crown_radius_m**2
    near = thin(rows(disc, inside), CELL_M)
    if len(near) < LEAST_POINTS:
        return None
    own = centers[number]
    apart = lengths(centers - own)
    own_side = np.ones(len(near), dtype=bool)
    x, y = near[:, 0] - own[0], near[:, 1] - own[1]
    for gap in centers[(apart > 0.0) & (apart <= 2.0 * (s.reach_m + s.crown_radius_m))] - own:
        # Not beyond the line half way between the two stems.
        own_side &= gap[0] * x + gap[1] * y <= 0.5 * (gap[0] ** 2 + gap[1] ** 2)
    near = rows(near, own_side)
    layer = np.floor((near[:, 2] - FOOT_M) / s.layer_m).astype(np.int64)
    if len(layer) == 0:
        return None
    count = np.bincount(layer)
    empty = 0
    top = 0
    for level, here in enumerate(count):
        empty = 0 if here >= LEAST_OF_LAYER else empty + 1
        if empty * s.layer_m > s.max_gap_m:
            break
        top = level if here >= LEAST_OF_LAYER else top
    height = float(near[layer <= top, 2].max())
    diameter = dbh_m if dbh_m is not None else 2.0 * stem.axis.radius_m
    if height < s.min_height_m or height < s.min_slenderness * diameter:
        return None
    if dbh_m is not None and height > s.max_slenderness * dbh_m + bh_m:
        return None
    upper = rows(near, (near[:, 2] > FOOT_M + (height - FOOT_M) * 2.0 / 3.0) & (near[:, 2] <= height))
    spread = _width(upper)
    crown = count[max(top // 3, 0) : top + 1]
    tapers = count[top] <= s.thinning * crown.max()
    if spread <= s.crown_spread * 0.5 * diameter or not tapers:
        return None
    # About the axis.
    near[:, :2] -= start + slope * (near[:, 2:3] - bh_m)
    return _Top(
        height_m=height,
        aside_m=_aside(rows(near, (near[:, 2] > height - TOP_M) & (near[:, 2] <= height))),
        may_go_on=_may_go_on(near, height, diameter, s),
    )


def _aside(points: Floats) -> float:
    """How far aside of the axis the middle of points (N, 3) about it lies, metres."""
    return float(np.hypot(*np.median(points[:, :2], axis=0)))


def _may_go_on(near: Floats, height: float, diameter: float, s: TopSettings) -> bool:
    """Whether what is above a gap over ``height``, of ``near`` (N, 3) about the axis, may be the same tree's.

    Twigs hide the middle of a crown, and what is seen below it thins out like a top.
    """
    above = rows(near, near[:, 2] > height)
    layer, count = np.unique(np.floor(above[:, 2] / s.layer_m), return_counts=True)
    filled = layer[count >= LEAST_OF_LAYER]
    if len(above) < LEAST_POINTS or len(filled) == 0:
        return False
    if s.layer_m * (filled[-1] + 1.0) > s.max_slenderness * diameter or _aside(above) > s.at_side * s.crown_radius_m:
        return False
    metre = np.floor((height - near[:, 2]) / TOP_M)
    upper = range(max(int((height - FOOT_M) * 2.0 / 3.0 / TOP_M), 1))
    widths = [_width(rows(near, metre == below)) for below in upper]
    return widths[0] > s.tip_spread * max(widths) or widths[0] < s.bare_spread * diameter


def _width(points: Floats) -> float:
    """By how much points (N, 3) spread about their middle in plan, metres; of fewer than a layer has, 0."""
    if len(points) < LEAST_OF_LAYER:
        return 0.0
    return float(np.percentile(lengths(points[:, :2] - np.median(points[:, :2], axis=0)), SPREAD_PERCENTILE))

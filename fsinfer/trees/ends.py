"""Where a stem plainly ends in the cloud: stumps, posts and people have a top that is seen, trees have none there.

A stem ends where its wall does, or what stands upon it (a head upon shoulders), and next to nothing stands in its
column beyond, though points could be there. What something hides has what hides it in the way, or is seen in part.
What is closed at its top is no stem, however few of its sides are seen: a wall, a boulder, a car.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.cylinder.axis import axis_coordinates
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
#: The column of a stem reaches so far beyond its wall, and so much above and below its ends belongs to them, metres.
#: Source: judgement; bark, burrs, and the layers in which ends are told.
COLUMN_M, NEAR_END_M = 0.05, 0.15
#: Points beyond an end are next to nothing up to this share of what the wall would have there, if it would have so
#: many. Source: judgement; stray points.
STRAY, LEAST_EXPECTED = 0.02, 30.0
#: The cloud holds points so far above an end, metres, or it may end itself there. Source: judgement.
CLOUD_ABOVE_M = 1.0
#: Share of its girth that is seen of a stem whose ends are told: what hides its upper part hides a side, too. Source:
#: judgement; a far stem of a rendered plot, of which less was seen.
LEAST_ARC = 0.5
#: What stands upon a stem belongs to it where it has this share of the wall's points a metre, and nowhere so many
#: metres without a point. Source: judgement; a head has a half, what is hidden is seen by a few points.
UPON, UPON_GAP_M = 0.25, 0.3
#: Share of the points upon a stem that lies below their top. Source: judgement; stray points.
HIGHEST = 0.98
#: A lid fills the middle of a stem, up to this share of a radius of at least so many metres, with this share of the
#: points that as much of the wall has, and with so many times those of the middle below it. Source: judgement; noise
#: fills a thin stem from wall to wall, as far down as it goes.
LID_REACH, LID_RADIUS_M, LID_SHARE, LID_TIMES = 0.8, 0.10, 0.5, 3.0
#: What ends so little below breast height may be a stem all the same, metres. Source: the layers of the search.
BELOW_BH_M = 0.05


@dataclass(frozen=True, kw_only=True)
class Ends:
    """Heights in metres above the level of a stem at which it plainly ends; None where it does not."""

    top_m: float | None = None
    bottom_m: float | None = None


def ends_of(near: Floats, stem: Stem, *, cloud_top_m: float, slab_m: tuple[float, float], s: StemSettings) -> Ends:
    """The ends of a stem among the points ``near`` (N, 3) it, of x, y, height above its level.

    ``slab_m`` are the heights between which there are points, and ``cloud_top_m`` that of the cloud's own top, above
    the same level.
    """
    offset, _ = axis_coordinates(near, stem.axis.parameters, stem.axis.height_m)
    away = lengths(offset)
    column = away <= stem.axis.radius_m + COLUMN_M
    away, height = away[column], near[column, 2]
    on_wall = np.count_nonzero((height >= stem.bottom_m) & (height <= stem.top_m))
    a_metre = on_wall / max(stem.top_m - stem.bottom_m, NEAR_END_M)

    def empty(low: float, high: float) -> bool:
        expected = a_metre * max(high - low, 0.0)
        found = np.count_nonzero((height >= low) & (height <= high))
        return bool(expected >= LEAST_EXPECTED and found <= STRAY * expected)

    low, high = slab_m
    # What stands upon the stem is its top where it is dense from there on, and does not hide more.
    above = height[(height > stem.top_m) & (height <= high)]
    alone = empty(stem.top_m + NEAR_END_M, high)
    top = stem.top_m if alone or not len(above) else max(stem.top_m, float(np.quantile(above, HIGHEST)))
    upon = np.sort(above[above <= top])
    dense = len(upon) >= UPON * a_metre * (top - stem.top_m) and np.diff([stem.top_m, *upon, top]).max() <= UPON_GAP_M
    is_end = (alone or dense) and empty(top + NEAR_END_M, high) and cloud_top_m > top + CLOUD_ABOVE_M
    seen_round = stem.arc_coverage >= LEAST_ARC
    ends_above = is_end and ((seen_round and top < s.post_top_m) or _has_lid(away, height, top, stem, a_metre))
    ends_below = seen_round and empty(low + NEAR_END_M, stem.bottom_m - NEAR_END_M)
    return Ends(top_m=top if ends_above else None, bottom_m=stem.bottom_m if ends_below else None)


def _has_lid(away: Floats, height: Floats, top_m: float, stem: Stem, a_metre: float) -> bool:
    """Whether a column is closed at its top: of points ``away`` (N,) from its axis, ``a_metre`` of them on its wall."""
    radius = stem.axis.radius_m
    if radius < LID_RADIUS_M:
        return False
    layer = 2.0 * NEAR_END_M
    middle = height[away <= LID_REACH * radius]
    lid = np.count_nonzero(np.abs(middle - top_m) <= NEAR_END_M)
    below = np.count_nonzero((middle >= stem.bottom_m) & (middle < top_m - NEAR_END_M))
    below_a_layer = below * layer / max(top_m - NEAR_END_M - stem.bottom_m, layer)
    of_wall = a_metre / (2.0 * np.pi * radius * max(stem.arc_coverage, NEAR_END_M))
    wanted = LID_SHARE * of_wall * np.pi * (LID_REACH * radius) ** 2
    return bool(lid >= max(wanted, LID_TIMES * below_a_layer, LEAST_EXPECTED))


def with_ends(section: Section, ends: Ends, bh_m: float) -> Section:
    """A section with what the ends of its stem make doubtful; without a diameter where it ends below breast height."""
    if ends.top_m is not None and ends.top_m < bh_m - BELOW_BH_M:
        reasons: tuple[Notice, ...] = (notice(StemCode.ends_low, top_m=round(ends.top_m, 2)),)
        return replace(section, dbh_m=None, sd_m=float("nan"), status="unmeasured", reasons=reasons)
    told = [notice(StemCode.top_seen, top_m=round(ends.top_m, 2))] if ends.top_m is not None else []
    if ends.bottom_m is not None:
        told.append(notice(StemCode.hangs, bottom_m=round(ends.bottom_m, 2)))
    if not told:
        return section
    # Of one without a diameter it is told as well: its edges in photographs may give it one.
    status = section.status if section.dbh_m is None else "doubtful"
    return replace(section, status=status, reasons=(*section.reasons, *told))


def without_stumps(
    pairs: Sequence[tuple[Tree, Section]],
) -> tuple[list[tuple[Tree, Section]], tuple[Notice, ...]]:
    """Trees with their sections but for those that end below breast height, and where these stand."""
    stumps = [tree for tree, section in pairs if any(reason.code == StemCode.ends_low for reason in section.reasons)]
    if not stumps:
        return list(pairs), ()
    places = tuple(f"({tree.x_m:.1f}, {tree.y_m:.1f})" for tree in stumps)
    kept = [pair for pair in pairs if pair[0] not in stumps]
    return kept, (notice(StemCode.stumps_left_out, places=places),)

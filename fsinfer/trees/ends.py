"""Where a stem plainly ends in the cloud: stumps, posts and people have a top that is seen, trees have none there.

A stem ends where its wall does and next to nothing stands in its column beyond, though points could be there. What
something hides has what hides it in the way, or is seen in part.
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
BESIDE_M, NEAR_END_M = 0.05, 0.15
#: Points beyond an end are next to nothing up to this share of what the wall would have there, if it would have so
#: many. Source: judgement; stray points.
STRAY, LEAST_EXPECTED = 0.02, 30.0
#: The cloud holds points so far above an end, metres, or it may end itself there. Source: judgement.
CLOUD_ABOVE_M = 1.0
#: Share of its girth that is seen of a stem whose ends are told: what hides its upper part hides a side, too. Source:
#: judgement; a far stem of a rendered plot, of which less was seen.
LEAST_ARC = 0.5
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
    if stem.arc_coverage < LEAST_ARC:
        return Ends()
    offset, _ = axis_coordinates(near, stem.axis.parameters, stem.axis.height_m)
    height = near[lengths(offset) <= stem.axis.radius_m + BESIDE_M, 2]
    on_wall = np.count_nonzero((height >= stem.bottom_m) & (height <= stem.top_m))
    a_metre = on_wall / max(stem.top_m - stem.bottom_m, NEAR_END_M)

    def empty(low: float, high: float) -> bool:
        expected = a_metre * max(high - low, 0.0)
        found = np.count_nonzero((height >= low) & (height <= high))
        return bool(expected >= LEAST_EXPECTED and found <= STRAY * expected)

    low, high = slab_m
    ends_above = stem.top_m < s.post_top_m and cloud_top_m > stem.top_m + CLOUD_ABOVE_M
    ends_above = ends_above and empty(stem.top_m + NEAR_END_M, high)
    ends_below = empty(low + NEAR_END_M, stem.bottom_m - NEAR_END_M)
    return Ends(top_m=stem.top_m if ends_above else None, bottom_m=stem.bottom_m if ends_below else None)


def with_ends(section: Section, ends: Ends, bh_m: float) -> Section:
    """A section with what the ends of its stem make doubtful; without a diameter where it ends below breast height."""
    if ends.top_m is not None and ends.top_m < bh_m - BELOW_BH_M:
        reasons: tuple[Notice, ...] = (notice(StemCode.ends_low, top_m=round(ends.top_m, 2)),)
        return replace(section, dbh_m=None, sd_m=float("nan"), status="unmeasured", reasons=reasons)
    told = [notice(StemCode.top_seen, top_m=round(ends.top_m, 2))] if ends.top_m is not None else []
    if ends.bottom_m is not None:
        told.append(notice(StemCode.hangs, bottom_m=round(ends.bottom_m, 2)))
    if not told or section.dbh_m is None:
        return section
    return replace(section, status="doubtful", reasons=(*section.reasons, *told))


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

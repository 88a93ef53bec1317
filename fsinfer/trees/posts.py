"""Posts of markers are no trees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.measure import PlotResult

#: A marker's board and the post behind it lie within this of the marker's centre, metres. Source: boards of 30 cm.
MARKER_REACH_M = 0.25


def without_posts(result: PlotResult, marker_xyz: NDArray[np.float64]) -> PlotResult:
    """Take out what stands where a marker is and does not measure as a sound stem: the marker's post or board.

    A marker pinned to a tree stays with its tree, as long as the tree's DBH is beyond doubt. What was taken out is said
    in the warnings, because it might have been a tree after all. ``marker_xyz``: (M, 3) metres, the cloud's frame.
    """
    kept, warnings = [], []
    for index, tree in enumerate(result.trees):
        apart = np.hypot(*(marker_xyz[:, :2] - [tree.x_m, tree.y_m]).T) if len(marker_xyz) else np.array([np.inf])
        if tree.status == "ok" or apart.min() > MARKER_REACH_M:
            kept.append(index)
            continue
        warnings.append(notice(StemCode.post_of_marker, x_m=tree.x_m, y_m=tree.y_m))
    return replace(
        result,
        trees=tuple(result.trees[i] for i in kept),
        sections=tuple(result.sections[i] for i in kept),
        warnings=(*result.warnings, *warnings),
    )

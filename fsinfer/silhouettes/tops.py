"""Whether the photographs that a stem was measured in can have shown its top.

The cloud of a walk ends where the photographs end: a few metres up, thinning out, since ever fewer of them reach there.
That looks like a crown that tapers. So the upper edge of the photographs tells: a top was seen where those nearest to
the stem, which show it best, reach well above it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.geometry.similarity import apply
from fsinfer.scene import Scene, in_picture, project
from fsinfer.trees import PlotResult, Tree

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class TopViewSettings:
    """Constants of :func:`heights_in_view`.

    Attributes
    ----------
    nearest: of the photographs that show a stem at breast height so many are asked. Source: judgement, about what a
        stem is measured in.
    min_share: of them that have to reach above the top. Source: judgement, more than half.
    above_m: how far above. Source: geometry, the last layer of a crown and a lean.
    """

    nearest: int = 10
    min_share: float = 0.6
    above_m: float = 1.0


def heights_in_view(
    result: PlotResult, scene: Scene, cloud_from_scene: Floats, *, settings: TopViewSettings | None = None
) -> PlotResult:
    """``result`` (metres) with heights for those trees only whose tops the photographs can have shown.

    A tree without a DBH has none either: what was not clear at breast height is not clear at the top.
    """
    s = settings or TopViewSettings()
    if all(tree.height_m is None for tree in result.trees):
        return result
    scene_from_cloud = np.linalg.inv(cloud_from_scene)

    def in_scene(tree: Tree, height_m: float) -> Floats:
        place = np.array([tree.x_m, tree.y_m, tree.z_ground_m + height_m])
        return apply(np.asarray(scene_from_cloud, dtype=np.float64), place)

    trees = []
    for tree, section in zip(result.trees, result.sections, strict=True):
        seen = tree.height_m
        if seen is not None:
            stem, top = in_scene(tree, section.bh_m), in_scene(tree, seen + s.above_m)
            if tree.dbh_cm is None or _share_in_view(scene, stem, top, s.nearest) < s.min_share:
                seen = None
        trees.append(replace(tree, height_m=seen))
    return replace(result, trees=tuple(trees))


def _share_in_view(scene: Scene, stem: Floats, top: Floats, nearest: int) -> float:
    """Of the ``nearest`` views that show the place ``stem`` (3,) the share that shows ``top`` (3,), too."""
    shown = []
    for view in scene.views:
        places, depth = project(np.stack([stem, top]), view.camera)
        # The principal point lies within a few pixels of the middle.
        width, height = 2.0 * view.camera.intrinsic[:2, 2] + 1.0
        inside = in_picture(places, depth, (width, height))
        if inside[0]:
            shown.append((float(depth[0]), bool(inside[1])))
    shown.sort()
    return float(np.mean([reaches for _, reaches in shown[:nearest]])) if shown else 0.0

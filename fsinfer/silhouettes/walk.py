"""Which stems stand outside of the walk: nobody went there, and the photographs know them from afar only.

A stem 13 m away has a handful of pixels, seen from one side: it was found three times, and once with a sixth of its
size. Stems that the cameras surround, or that some cameras came near to, belong to the walk; the others are listed
apart, at the end of the table with the status ``outside``, do not count in the stand, and are not measured unless that
is asked for. Ground is sorted by the same rule, so that none is left in the stand's area whose stems do not count.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError, cKDTree

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.scene import Scene
from fsinfer.trees import PlotResult, Section, Tree
from fsinfer.trees.diameter.section import unmeasured_section
from fsinfer.trees.measure import trees_found
from fsinfer.trees.stem_measurement import with_diameter
from fsinfer.trees.tree import OUTSIDE

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class WalkSettings:
    """Constants of :func:`apart_from_walk`.

    Attributes
    ----------
    near_m: a stem nearer than this to ``near_photos`` cameras belongs to the walk. Source: geometry, beyond it a depth
        map knows a stem's surface to centimetres only and a pixel is as wide.
    near_photos: see there. Source: geometry, a stem's edges need some photographs.
    measure_far: measure the stems outside of the walk too; they are listed apart all the same. Source: option.
    """

    near_m: float = 8.0
    near_photos: int = 3
    measure_far: bool = False


def outside_walk(places: Floats, cameras: Floats, settings: WalkSettings | None = None) -> tuple[Bools, Floats]:
    """Which of the places (T, 2) lie outside of the walk with cameras (K, 2), and how far (T,) the nearest camera is.

    Metres in plan. Inside is what lies in the convex hull of the cameras, or near enough to some of them. Without
    cameras nothing is outside.
    """
    s = settings or WalkSettings()
    if len(cameras) == 0 or len(places) == 0:
        return np.zeros(len(places), dtype=bool), np.full(len(places), np.inf)
    # The cells of a large plot times its photographs would be too many distances to hold.
    distance, _ = cKDTree(cameras).query(places, k=[1, min(s.near_photos, len(cameras))])
    far = distance[:, 1] > s.near_m
    # Fewer than three cameras, or all on a line, surround nothing.
    with suppress(QhullError, ValueError):
        far &= Delaunay(cameras).find_simplex(places) < 0
    return np.asarray(far), distance[:, 0]


def camera_places(scene: Scene, cloud_from_scene: Floats) -> Floats:
    """(K, 2) where the photographs were taken, in the plan of the cloud."""
    centers = np.array([view.camera.center for view in scene.views]).reshape(-1, 3)
    return np.asarray((centers @ cloud_from_scene[:3, :3].T + cloud_from_scene[:3, 3])[:, :2])


def apart_from_walk(
    result: PlotResult, cameras: Floats, *, settings: WalkSettings | None = None, kept: frozenset[int] = frozenset()
) -> PlotResult:
    """Put the stems outside of the walk with ``cameras`` (K, 2) to the end, without a DBH unless that is asked for.

    Numbers stay, and the ground outside leaves the plot's area. Trees in ``kept`` were put there by hand: a person
    wants them.
    """
    s = settings or WalkSettings()
    places = np.array([[tree.x_m, tree.y_m] for tree in result.trees]).reshape(-1, 2)
    far, nearest = outside_walk(places, cameras, s)
    far &= ~np.isin([tree.tree_id for tree in result.trees], list(kept))
    if result.seen_ground is not None:
        ground = result.seen_ground.only(~outside_walk(result.seen_ground.middles, cameras, s)[0])
        # A stem at the walk's edge may stand in a cell whose middle is outside: it stands on seen ground all the same.
        known = result.seen_ground.area(places[~far]) > 0
        result = replace(result, seen_ground=ground, plot_area_m2=ground.area(np.zeros((0, 2))) if known else 0.0)
    if not far.any():
        return result
    pairs = list(zip(result.trees, result.sections, strict=True))
    inside = [pair for pair, apart in zip(pairs, far, strict=True) if not apart]
    beyond = [_apart(*pair, float(nearest[i]), s) for i, pair in enumerate(pairs) if far[i]]
    told = () if s.measure_far else (stems_outside_walk([tree for tree, _ in beyond]),)
    return replace(
        result,
        trees=tuple(tree for tree, _ in (*inside, *beyond)),
        sections=tuple(section for _, section in (*inside, *beyond)),
        diagnosis=trees_found([tree for tree, _ in inside]),
        warnings=(*result.warnings, *told),
    )


def stems_outside_walk(trees: Sequence[Tree]) -> Notice:
    """That these are listed apart and not counted."""
    return notice(StemCode.stems_outside_walk, stems=len(trees), trees=tuple(str(tree.tree_id) for tree in trees))


def _apart(tree: Tree, section: Section, nearest_m: float, s: WalkSettings) -> tuple[Tree, Section]:
    said = notice(StemCode.outside_walk, nearest_m=nearest_m)
    if s.measure_far:
        reasons = (*section.reasons, said)
        return replace(tree, reasons=reasons), replace(section, reasons=reasons)
    radius = float(section.circle_m[2]) if section.dbh_m is None else section.dbh_m / 2.0
    unmeasured = unmeasured_section(
        section.center,
        section.bh_m,
        (said,),
        radius_m=radius,
        lean_deg=section.lean_deg,
        slope=section.slope,
        taper=section.taper,
        top_m=section.top_m,
        offsets_m=section.offsets_m,
        half_slice_m=section.half_slice_m,
    )
    apart = replace(unmeasured, status=OUTSIDE)
    return replace(with_diameter(tree, apart), height_m=None), apart

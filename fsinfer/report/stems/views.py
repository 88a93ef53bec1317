"""Which photographs show a tree best: unhidden by the depth maps, large, and near the middle of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMap, seen_and_hidden
from fsinfer.scene import Camera, project

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ViewSettings:
    """Constants of :func:`choose_views`.

    Attributes
    ----------
    default_radius_m: where no diameter is known. Source: layout.
    below_m, top_m: the crop shows the foot and the stem above breast height. Source: layout.
    checked_m: of the stem on either side of breast height is compared with the depth map. Source: judgement.
    tolerance_of_depth: the depth map agrees with the stem within this, or within a radius. Source: judgement.
    min_seen: share of the checked points that the depth map shows where the stem is. Source: judgement.
    max_hidden: share behind something nearer. Source: judgement.
    good_width_px: more than this is no better for the eye. Source: layout.
    least_width_px: less than this shows no bark. Source: layout.
    apart_deg: two chosen photographs look from directions at least this far apart, if there are any. Source: layout.
    least_apart_deg: and no nearer than this. Source: layout.
    worth: of the best score, below which a photograph is not shown. Source: layout.
    """

    default_radius_m: float = 0.12
    below_m: float = 0.15
    top_m: float = 2.2
    checked_m: float = 0.4
    tolerance_of_depth: float = 0.05
    min_seen: float = 0.35
    max_hidden: float = 0.35
    good_width_px: float = 120.0
    least_width_px: float = 8.0
    apart_deg: float = 40.0
    least_apart_deg: float = 12.0
    worth: float = 0.3


@dataclass(frozen=True, kw_only=True)
class StandingTree:
    """A tree in the scene's coordinates.

    Attributes
    ----------
    tree_id: its number.
    breast: (3,) the stem's centre at breast height.
    up: (3,) the step of one metre upwards (one cloud unit where the scale is unknown).
    radius: of the stem, scene units; ``measured`` says whether it is one or a guess.
    bh_m: height of ``breast`` over the foot, in steps of ``up``.
    """

    tree_id: int
    breast: Floats
    up: Floats
    radius: float
    measured: bool
    bh_m: float

    def at(self, height_m: float) -> Floats:
        """Centre (3,) of an upright stem at ``height_m`` over its foot."""
        return np.asarray(self.breast + (height_m - self.bh_m) * self.up)


@dataclass(frozen=True, kw_only=True)
class RatedView:
    """How well view ``view`` (index into the scene) shows tree ``tree_id``; ``direction`` (3,) points to the camera."""

    tree_id: int
    view: int
    score: float
    direction: Floats
    distance_m: float


def rate_view(
    tree: StandingTree,
    view: int,
    camera: Camera,
    size_px: tuple[int, int],
    depth_map: DepthMap | None,
    *,
    settings: ViewSettings | None = None,
) -> RatedView | None:
    """Rate one photograph for one tree; None where it does not show the stem at breast height.

    Parameters
    ----------
    size_px: width and height of the photograph.
    depth_map: of this view; without one nothing is known of what stands before the tree.
    """
    s = settings or ViewSettings()
    metre = float(np.linalg.norm(tree.up))
    stem = np.stack([tree.at(h) for h in np.linspace(-s.below_m, s.top_m, 12)])
    pixels, depths = project(np.vstack([tree.breast[None], stem]), camera)
    depth = float(depths[0])
    if depth <= max(2 * tree.radius, 0.3 * metre) or depths.min() <= 0:
        return None
    width_px = float(camera.intrinsic[0, 0]) * 2 * tree.radius / depth
    size = np.array(size_px, dtype=np.float64)
    if width_px < s.least_width_px or (pixels[0] < width_px / 2).any() or (pixels[0] > size - 1 - width_px / 2).any():
        return None
    inside = float(((pixels[1:] >= 0) & (pixels[1:] <= size - 1)).all(axis=1).mean())
    seen = 0.5
    if depth_map is not None:
        seen, hidden = _seen_and_hidden(tree, camera, depth_map, s)
        if seen < s.min_seen or hidden > s.max_hidden:
            return None
    off_centre = float(np.linalg.norm(pixels[0] - size / 2) / np.linalg.norm(size / 2))
    score = seen * min(width_px / s.good_width_px, 1.0) ** 0.5 * inside * (1 - 0.5 * off_centre**2)
    offset = camera.center - tree.breast
    distance = float(np.linalg.norm(offset))
    return RatedView(
        tree_id=tree.tree_id, view=view, score=score, direction=offset / distance, distance_m=distance / metre
    )


def choose_views(
    rated: Sequence[RatedView], count: int, *, settings: ViewSettings | None = None
) -> tuple[RatedView, ...]:
    """Choose up to ``count`` of the views of one tree, best first, from directions well apart where there are any."""
    s = settings or ViewSettings()
    best_first = sorted(rated, key=lambda r: (-r.score, r.view))
    chosen: list[RatedView] = []
    for apart_deg in (s.apart_deg, s.least_apart_deg):
        for candidate in best_first:
            if len(chosen) >= count or candidate.score < s.worth * best_first[0].score:
                break
            cosines = [float(candidate.direction @ other.direction) for other in chosen]
            if all(cosine < np.cos(np.radians(apart_deg)) for cosine in cosines):
                chosen.append(candidate)
    return tuple(chosen)


def breast_height_ring(tree: StandingTree, camera: Camera) -> Floats:
    """The half (M, 2) of the stem's circle at breast height that faces the camera, in pixels of the photograph."""
    across, towards = _horizontal(tree, camera)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 33)[:, None]
    points = tree.breast + tree.radius * (np.sin(angle) * across + np.cos(angle) * towards)
    return project(points, camera)[0]


def _seen_and_hidden(tree: StandingTree, camera: Camera, depth_map: DepthMap, s: ViewSettings) -> tuple[float, float]:
    """Shares of points on the near side of the stem that the depth map shows, and that something nearer hides."""
    across, towards = _horizontal(tree, camera)
    side, height = np.meshgrid(np.linspace(-0.7, 0.7, 5), np.linspace(-s.checked_m, s.checked_m, 9))
    side, height = side.reshape(-1, 1), height.reshape(-1, 1)
    surface = tree.radius * (side * across + np.sqrt(1 - side**2) * towards)
    points = tree.breast + height * tree.up + surface
    tolerance = np.maximum(tree.radius, s.tolerance_of_depth * project(points, camera)[1])
    return seen_and_hidden(points, tolerance, camera, depth_map)


def _horizontal(tree: StandingTree, camera: Camera) -> tuple[Floats, Floats]:
    """Level unit vectors (3,) at the stem: across the line of sight, and towards the camera."""
    up = tree.up / np.linalg.norm(tree.up)
    offset = camera.center - tree.breast
    towards = offset - (offset @ up) * up
    towards /= max(float(np.linalg.norm(towards)), 1e-12)
    return np.cross(up, towards), towards

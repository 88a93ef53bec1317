"""Crops of the photographs that see a tree, with the line at breast height drawn in."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMaps
from fsinfer.errors import FsinferError
from fsinfer.processes import shared_out
from fsinfer.report.contents import Contents, number
from fsinfer.report.stems.views import (
    RatedView,
    StandingTree,
    ViewSettings,
    breast_height_ring,
    choose_views,
    rate_view,
)
from fsinfer.scene import Scene, View, project, read_scene, read_view_image, view_image_size

#: A crop is enlarged so many times at most. Source: layout; more only shows its pixels.
MAX_ENLARGEMENT = 2.5
#: What lies outside the photograph, and the line at breast height. Source: layout.
OUTSIDE_RGB, LINE_RGB = (233, 236, 232), (255, 122, 0)
#: Fixed-point bits of the line's coordinates in OpenCV. Source: numerics.
_SHIFT = 4


@dataclass(frozen=True, kw_only=True)
class TreePhoto:
    """One crop: (h, w, 3) RGB ``image`` of photograph ``name``, taken from ``distance_m`` away."""

    name: str
    image: NDArray[np.uint8]
    distance_m: float


def tree_photos(
    contents: Contents,
    *,
    per_tree: int = 3,
    height_px: int = 480,
    settings: ViewSettings | None = None,
) -> tuple[dict[int, list[TreePhoto]], str]:
    """Crops of the best ``per_tree`` photographs of each tree, and one sentence where there are none.

    Needs the scene, ``cloud_from_scene`` of ``plot.json`` and the trees' positions; depth maps where there are any
    say which photographs see the tree.
    """
    settings = settings or ViewSettings()
    trees = standing_trees(contents)
    if not trees:
        return {}, "This folder does not hold what ties the trees to their photos."
    try:
        scene = read_scene(contents.out / "scene")
    except FsinferError as error:
        return {}, f"The photos of the trees cannot be shown: {error}"
    rated = _rate(contents, scene, trees, settings)
    chosen = {tree.tree_id: choose_views(rated[tree.tree_id], per_tree, settings=settings) for tree in trees}
    return _crops(scene, {tree.tree_id: tree for tree in trees}, chosen, height_px, settings), ""


def standing_trees(contents: Contents) -> list[StandingTree]:
    """The trees of ``trees.csv`` in the scene's coordinates; none where ``plot.json`` does not tie the two."""
    similarity = contents.cloud_from_scene
    if similarity is None:
        return []
    scene_from_cloud = np.linalg.inv(similarity)
    # Coordinates of trees.csv are those of cloud.ply times the factor that fsinfer trees was given.
    cloud_per_tree = 1.0 / contents.trees_per_cloud
    up = np.asarray(scene_from_cloud[:3, 2] * cloud_per_tree * contents.metre, dtype=np.float64)
    per_metre = float(np.linalg.norm(up))
    found = []
    for row in contents.trees or ():
        values = [number(row.get(name)) for name in ("tree_id", "x_m", "y_m", "z_ground_m", "bh_m")]
        if any(value is None for value in values):
            continue
        tree_id, x, y, z, bh_m = (float(value) for value in values if value is not None)
        dbh_cm = number(row.get("dbh_cm"))
        foot = scene_from_cloud[:3, :3] @ (cloud_per_tree * np.array([x, y, z])) + scene_from_cloud[:3, 3]
        radius_m = ViewSettings().default_radius_m if dbh_cm is None else dbh_cm / 200
        found.append(
            StandingTree(
                tree_id=int(tree_id),
                breast=foot + bh_m * up,
                up=up,
                radius=radius_m * per_metre,
                measured=dbh_cm is not None,
                bh_m=bh_m,
            )
        )
    return found


def _rate(
    contents: Contents, scene: Scene, trees: Sequence[StandingTree], settings: ViewSettings
) -> dict[int, list[RatedView]]:
    maps: DepthMaps | None
    try:
        maps = DepthMaps(scene, contents.out, cache_maps=2)
    except FsinferError:
        maps = None
    rated: dict[int, list[RatedView]] = defaultdict(list)
    for of_view in shared_out(partial(_rate_one, scene, maps, trees, settings), range(len(scene.views))):
        for tree_id, rating in of_view:
            rated[tree_id].append(rating)
    return rated


def _rate_one(
    scene: Scene, maps: DepthMaps | None, trees: Sequence[StandingTree], settings: ViewSettings, index: int
) -> list[tuple[int, RatedView]]:
    """What one view is worth for each tree's number that it may show."""
    view = scene.views[index]
    try:
        size = view_image_size(view)
        depth_map = maps.get(index) if maps is not None and index in maps.available else None
    except FsinferError:
        return []  # a damaged photograph or depth map is told elsewhere; the tree has other views
    ratings = (
        (tree.tree_id, rate_view(tree, index, view.camera, size, depth_map, settings=settings)) for tree in trees
    )
    return [(tree_id, rating) for tree_id, rating in ratings if rating is not None]


def _crops(
    scene: Scene,
    trees: Mapping[int, StandingTree],
    chosen: Mapping[int, Sequence[RatedView]],
    height_px: int,
    settings: ViewSettings,
) -> dict[int, list[TreePhoto]]:
    """Cut them out photograph by photograph, so that each is read once; the order of ``chosen`` is kept."""
    by_view: dict[int, list[RatedView]] = defaultdict(list)
    for views in chosen.values():
        for rated in views:
            by_view[rated.view].append(rated)
    cut: dict[tuple[int, int], TreePhoto] = {}
    for index, views_of_photo in by_view.items():
        view = scene.views[index]
        try:
            image = read_view_image(view)
        except FsinferError:
            continue
        for rated in views_of_photo:
            crop = crop_tree(image, view, trees[rated.tree_id], height_px=height_px, settings=settings)
            cut[rated.tree_id, index] = TreePhoto(name=view.name, image=crop, distance_m=rated.distance_m)
    return {
        tree_id: [cut[tree_id, rated.view] for rated in views if (tree_id, rated.view) in cut]
        for tree_id, views in chosen.items()
    }


def crop_tree(
    image: NDArray[np.uint8],
    view: View,
    tree: StandingTree,
    *,
    height_px: int = 480,
    settings: ViewSettings | None = None,
) -> NDArray[np.uint8]:
    """Cut the lower stem out of its photograph, the tree upright, and draw the line at breast height.

    Parameters
    ----------
    image: (H, W, 3) RGB photograph of ``view``.
    height_px: of the crop; it is two thirds as wide. It shows the stem from its foot to 2.2 m.

    Returns
    -------
    (height_px, 2 * height_px // 3, 3) uint8 RGB; grey beyond the photograph.
    """
    s = settings or ViewSettings()
    width_px = 2 * height_px // 3
    ends, _ = project(np.stack([tree.at(-s.below_m), tree.at(s.top_m)]), view.camera)
    rise = ends[1] - ends[0]
    # In a photograph taken on its side the tree lies: turned by quarters, it looks as the eye saw it.
    quarter = round(float(np.arctan2(rise[0], -rise[1])) / (np.pi / 2))
    turn = -quarter * np.pi / 2
    linear = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    extent = np.abs(linear.T @ np.array([width_px, height_px]))
    size = np.array([image.shape[1], image.shape[0]], dtype=np.float64)
    # From very near the photograph does not reach from foot to top: then the crop shows as much as there is.
    wanted = max(height_px / max(float(np.linalg.norm(rise)), 1.0), float((extent / size).max()))
    scale = min(wanted, MAX_ENLARGEMENT)
    half = extent / (2 * scale)
    # Shifted back into the photograph as far as it reaches.
    middle = np.where(2 * half <= size, np.clip(ends.mean(axis=0), half, np.maximum(size - half, half)), size / 2)
    if scale < 1.0:
        # Averaged down first: the warp samples single pixels.
        image = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    factor = max(scale, 1.0)
    shrink = min(scale, 1.0)
    crop_from_image = np.column_stack(
        [factor * linear, [width_px / 2, height_px / 2] - factor * linear @ (shrink * middle)]
    )
    crop = cv2.warpAffine(
        image,
        crop_from_image,
        (width_px, height_px),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=OUTSIDE_RGB,
    )
    ring = shrink * breast_height_ring(tree, view.camera) @ crop_from_image[:, :2].T + crop_from_image[:, 2]
    points = [np.rint(ring * 2**_SHIFT).astype(np.int32)]
    cv2.polylines(crop, points, False, (255, 255, 255), 5, cv2.LINE_AA, _SHIFT)
    cv2.polylines(crop, points, False, LINE_RGB, 2, cv2.LINE_AA, _SHIFT)
    return np.asarray(crop, dtype=np.uint8)

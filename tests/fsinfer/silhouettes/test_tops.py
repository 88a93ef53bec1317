"""Heights only of trees whose tops the photographs can have shown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.scene import Camera, Scene, View
from fsinfer.silhouettes.tops import heights_in_view
from fsinfer.trees import PlotResult
from tests.fsinfer.silhouettes.test_walk import entry, plot

WIDTH, HEIGHT, FOCAL = 640, 480, 500.0


def camera(x_m: float, y_m: float, *, up_deg: float) -> Camera:
    """At 1.5 m, towards the origin, tilted up."""
    flat = -np.array([x_m, y_m, 0.0]) / np.hypot(x_m, y_m)
    forward = np.cos(np.radians(up_deg)) * flat + np.array([0.0, 0.0, np.sin(np.radians(up_deg))])
    right = np.cross(flat, [0.0, 0.0, 1.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ [x_m, y_m, 1.5]
    intrinsic = np.array([[FOCAL, 0.0, (WIDTH - 1) / 2], [0.0, FOCAL, (HEIGHT - 1) / 2], [0.0, 0.0, 1.0]])
    return Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=0.5, depth_max=40.0)


def walk(*distances_m: float, up_deg: float = 0.0) -> Scene:
    views = []
    for number, distance in enumerate(distances_m):
        angle = 0.7 * number
        shown = camera(distance * np.cos(angle), distance * np.sin(angle), up_deg=up_deg)
        views.append(View(name=str(number), image_path=Path("none.jpg"), camera=shown, sources=()))
    return Scene(folder=Path(), views=tuple(views))


def stem(height_m: float | None, *, dbh_cm: float | None = 11.0) -> PlotResult:
    tree, section = entry(1, 0.0)
    return plot((replace(tree, y_m=0.0, z_ground_m=0.0, height_m=height_m, dbh_cm=dbh_cm), section))


# The upper edge of level photographs lies 1.5 m + 0.48 times the distance above the ground: 3.4 m from 4 m away, 7.3 m
# from 12 m.
NEAR, FAR = (4.0,) * 10, (12.0,) * 10


@pytest.mark.parametrize(
    ("height_m", "scene", "seen"),
    [
        (4.4, walk(*NEAR), False),  # where the photographs end, the cloud thins out like a crown
        (4.4, walk(*NEAR, *FAR), False),  # farther ones show what is above, too faintly for points
        (4.4, walk(*FAR), True),
        (7.0, walk(*FAR), False),  # less than a metre below the edge
        (4.4, walk(*NEAR, up_deg=20.0), True),
        (4.4, walk(*NEAR[:4], *FAR[:6]), True),
        (4.4, walk(*NEAR[:5], *FAR[:5]), False),
        (4.4, walk(), False),
    ],
)
def test_a_top_is_seen_where_the_nearest_photographs_reach_above_it(height_m: float, scene: Scene, seen: bool) -> None:
    """Trees of 10 to 18 m were given as 3 to 7 m, on seven rendered plots."""
    (tree,) = heights_in_view(stem(height_m), scene, np.eye(4)).trees
    assert tree.height_m == (height_m if seen else None)


def test_photographs_are_in_a_frame_of_their_own() -> None:
    scene = walk(*FAR)
    cloud_from_scene = np.diag([2.0, 2.0, 2.0, 1.0])
    cloud_from_scene[:3, 3] = [100.0, -50.0, 700.0]
    found = stem(2 * 4.4)
    moved = replace(found.trees[0], x_m=100.0, y_m=-50.0, z_ground_m=700.0)
    (tree,) = heights_in_view(replace(found, trees=(moved,)), scene, cloud_from_scene).trees
    assert tree.height_m == 8.8
    higher = replace(found, trees=(replace(moved, height_m=14.0),))
    assert heights_in_view(higher, scene, cloud_from_scene).trees[0].height_m is None


def test_without_a_diameter_there_is_no_height() -> None:
    assert heights_in_view(stem(4.4, dbh_cm=None), walk(*FAR), np.eye(4)).trees[0].height_m is None
    bare = stem(None)
    assert heights_in_view(bare, walk(*FAR), np.eye(4)) is bare

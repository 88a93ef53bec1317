"""A database of COLMAP with the matches of a walk round a cloud of points, and pairs that are false."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.geometric_check import check_pairs
from tests.fsinfer.poses.joining.test_parts import look_at

PHOTOS = 14
POINTS = 240
FOCAL_PX = 900.0
WIDTH, HEIGHT = 1200, 900
STEP_DEG = 12.0
NOISE_PX = 0.3


def names() -> list[str]:
    """Of the photos in the order of walking; COLMAP numbers them from 1."""
    return [f"{number:02d}.jpg" for number in range(PHOTOS)]


def pose(number: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation and shift that take the world to a photo's camera; all stand on an arc and look past its middle.

    Cameras whose axes meet tell no focal length (Sturm 2000), so that each looks another way.
    """
    angle = np.radians(STEP_DEG * number)
    center = np.array([5 * np.sin(angle), 0.15 * (number % 2), -5 * np.cos(angle)])
    aside = Rotation.from_euler("yx", [[-12, 0, 12][number % 3], [8, -8][number % 2]], degrees=True)
    rotation = aside.as_matrix() @ look_at(center)
    return rotation, -rotation @ center


def cloud() -> NDArray[np.float64]:
    return np.random.default_rng(5).uniform(-1.5, 1.5, (POINTS, 3))


def pixels(number: int, *, farther: tuple[int, float] | None = None) -> NDArray[np.float64]:
    """(POINTS, 2) of the cloud in a photo; ``farther``: so many times as far from another photo as it is."""
    rotation, shift = pose(number)
    points = cloud()
    if farther is not None:
        turn, moved = pose(farther[0])
        center = -turn.T @ moved
        points = center + farther[1] * (points - center)
    inside = points @ rotation.T + shift
    noise = np.random.default_rng(100 + number).normal(0, NOISE_PX, (POINTS, 2))
    return np.asarray(FOCAL_PX * inside[:, :2] / inside[:, 2:] + [WIDTH / 2, HEIGHT / 2] + noise)


def pairs_of_walk(
    path: Path,
    *,
    focal_px: float = FOCAL_PX,
    known: bool = False,
    neighbours: int = 4,
    further: Sequence[tuple[int, int]] = (),
    false: Mapping[tuple[int, int], int] | None = None,
    along: Mapping[tuple[int, int], float] | None = None,
    few: Mapping[tuple[int, int], int] | None = None,
) -> Path:
    """The database: photos match their next ``neighbours`` and the ``further`` ones, and ``false`` pairs.

    Parameters
    ----------
    focal_px: what the camera is said to have; ``known`` for sure.
    false: by pair of ranks the photo that the second one is taken for: it shows the same there, as look-alike trees do.
    along: by pair of ranks how many times as far from the first photo everything is that the second one is taken to
        show: on the same epipolar lines, as litter that repeats.
    few: by pair of ranks how many points it has instead of all.
    """
    import pycolmap

    false, along, few = false or {}, along or {}, few or {}
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=[focal_px, 600.0, 450.0, 0.0])
    camera.has_prior_focal_length = known
    places: dict[int, list[NDArray[np.float64]]] = {number: [pixels(number)] for number in range(PHOTOS)}
    true = {(i, j) for i in range(PHOTOS) for j in range(i + 1, min(PHOTOS, i + 1 + neighbours))} | set(further)
    matches: dict[tuple[int, int], NDArray[Any]] = {}
    every = np.arange(POINTS)
    for pair in sorted(true):
        matches[pair] = np.column_stack([every, every])[: few.get(pair)]
    shown = {pair: pixels(taken_for) for pair, taken_for in false.items()}
    shown |= {(first, second): pixels(second, farther=(first, factor)) for (first, second), factor in along.items()}
    for (first, second), there in shown.items():
        begin = sum(len(part) for part in places[second])
        places[second].append(there[:60])
        matches[first, second] = np.column_stack([every[:60], begin + every[:60]])
    with open_database(path) as opened:
        number_of_camera = opened.write_camera(camera)
        for number in range(PHOTOS):
            image = opened.write_image(pycolmap.Image(name=names()[number], camera_id=number_of_camera))
            opened.write_keypoints(image, np.concatenate(places[number]).astype(np.float32))
        for (first, second), found in matches.items():
            opened.write_matches(first + 1, second + 1, found.astype(np.uint32))
    check_pairs(path, [(names()[first], names()[second]) for first, second in matches], 1)
    return path

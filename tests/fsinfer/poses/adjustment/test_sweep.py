"""How far off the corners of a photo are, by a sweep through its neighbours; photos of a painted wall and floor."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from fsinfer.io.images import luminance, read_image
from fsinfer.poses.adjustment.problem import Unknowns
from fsinfer.poses.adjustment.projection import Floats
from fsinfer.poses.adjustment.sweep import Sweep, corners, small_picture
from tests.support.painted_corner import hits, painted_corner
from tests.support.phone_walk import HEIGHT, PHONE, WIDTH

NEIGHBOURS = np.array([3, 5, 6])


def sweep_of(folder: Path, truth: Unknowns, *, larger: float = 1.0) -> Sweep:
    """Of photos that are so many times larger than features are looked for in; their cameras are the true ones."""
    count = len(truth.rotations)
    size = (round(WIDTH * larger), round(HEIGHT * larger))
    pictures = []
    for photo in range(count):
        grey = cv2.resize(luminance(read_image(folder / f"{photo:05d}.jpg")), size)
        pictures.append(small_picture(np.asarray(grey, np.uint8), larger))
    lenses, own = truth.lenses.copy(), truth.own.copy()
    lenses[:, :4] *= larger
    own[:, 1:3] *= larger
    at = Unknowns(
        rotations=truth.rotations, translations=truth.translations, own=own, lenses=lenses, points=truth.points
    )
    return Sweep(pictures=pictures, sizes=np.array([size] * count), camera=np.zeros(count, np.int64), at=at)


def off(truth: Unknowns, photo: int, xy: Floats, points: Floats) -> Floats:
    """How far from the true depth found points are, as a share of it; ``xy`` are pixels of the photo as written."""
    places, _ = hits(truth, photo, xy)
    depth, found = ((p @ truth.rotations[photo].T + truth.translations[photo])[:, 2] for p in (places, points))
    return np.asarray(np.abs(found / depth - 1))


@pytest.mark.parametrize(
    ("effects", "larger"), [(None, 1.0), (PHONE, 1.7)], ids=["held still", "a phone, large photos"]
)
def test_the_depth_of_corners_is_found(tmp_path: Path, effects: Floats | None, larger: float) -> None:
    _, truth = painted_corner(tmp_path, effects=effects)
    sweep = sweep_of(tmp_path, truth, larger=larger)
    xy = corners(sweep.pictures[4], 300) * sweep.scale(4)
    assert 200 < len(xy) <= 320
    found = sweep.of(4, xy, 1.5, 12.0, NEIGHBOURS)
    alike = found.likeness > 0.6
    # At the rim two neighbours do not show it.
    assert alike.mean() > 0.7
    errors = off(truth, 4, xy[alike] / larger, found.points[alike])
    # One step of the sweep is some two per cent.
    assert np.median(errors) < 0.015
    assert (errors < 0.04).mean() > 0.95


def test_where_the_photos_show_nothing_nothing_is_alike(tmp_path: Path) -> None:
    _, truth = painted_corner(tmp_path, painted=False)
    sweep = sweep_of(tmp_path, truth)
    xy = corners(sweep.pictures[4], 100) * sweep.scale(4)
    assert (sweep.of(4, xy, 1.5, 12.0, NEIGHBOURS).likeness > 0.6).mean() < 0.05


def test_one_neighbour_is_enough_and_one_behind_is_none(tmp_path: Path) -> None:
    _, truth = painted_corner(tmp_path)
    sweep = sweep_of(tmp_path, truth)
    xy = corners(sweep.pictures[4], 100) * sweep.scale(4)
    alone = sweep.of(4, xy, 1.5, 12.0, NEIGHBOURS[:1])
    assert (off(truth, 4, xy[alone.likeness > 0.8], alone.points[alone.likeness > 0.8]) < 0.04).mean() > 0.8
    # A photo that was taken the other way shows none of it.
    turned = truth.rotations.copy()
    turned[3] = np.diag([-1.0, 1.0, -1.0]) @ turned[3]
    shifted = truth.translations.copy()
    shifted[3] = np.diag([-1.0, 1.0, -1.0]) @ shifted[3]
    away = Unknowns(rotations=turned, translations=shifted, own=truth.own, lenses=truth.lenses, points=truth.points)
    assert (sweep_of(tmp_path, away).of(4, xy, 1.5, 12.0, NEIGHBOURS[:1]).likeness == -1).all()


def test_corners_are_spread_over_the_whole_picture() -> None:
    rng = np.random.default_rng(5)
    picture = rng.integers(0, 255, (120, 200)).astype(np.uint8)
    found = corners(picture, 60)
    assert 40 <= len(found) <= 60
    cells = np.unique((found // [50, 40]).astype(int), axis=0)
    assert len(cells) == 12
    assert ((found > 8) & (found < [192, 112])).all()
    # Pixels' middles, COLMAP's origin.
    np.testing.assert_array_equal(found % 1, 0.5)
    # A picture without structure has none, and one that is too small for so many neither.
    assert len(corners(np.full((120, 200), 90, np.uint8), 60)) == 0
    assert len(corners(picture[:20, :20], 60)) == 0

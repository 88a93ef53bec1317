"""Corners of photos become points where others show them, and cameras that few features place become surer by it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.poses.adjustment.adjust import adjust_photos
from fsinfer.poses.adjustment.evidence import asked_again, tried_in_turn
from fsinfer.poses.adjustment.fit import with_points_fitted
from fsinfer.poses.adjustment.last_fit import like
from fsinfer.poses.adjustment.new_points import with_new_points
from fsinfer.poses.adjustment.problem import Group, Observations, Unknowns, from_model
from fsinfer.poses.adjustment.projection import Floats
from fsinfer.poses.adjustment.rematch import Photos
from fsinfer.poses.adjustment.settings import AdjustmentSettings, NewPointSettings
from fsinfer.threads import one_blas_thread
from tests.fsinfer.poses.adjustment.test_fit import weighting
from tests.support.painted_corner import FLOOR_M, WALL_M, painted_corner
from tests.support.phone_walk import HEIGHT, PHONE, WIDTH, model_of, phone_walk

pytest.importorskip("pycolmap")
FEW = NewPointSettings(per_photo=150)


@pytest.fixture(scope="module")
def corner(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Observations, Unknowns]:
    """Photos of a painted wall and floor, features 0.4 pixels off, and the truth."""
    folder = tmp_path_factory.mktemp("corner")
    return folder, *painted_corner(folder)


def photos(folder: Path, count: int) -> Photos:
    return Photos(
        files=[folder / f"{i:05d}.jpg" for i in range(count)], sizes=np.array([[WIDTH, HEIGHT]] * count), step_px=1.0
    )


def off_the_paint(points: Floats) -> Floats:
    """Metres from the wall or the floor, whichever is nearer."""
    return np.minimum(np.abs(points[:, 1] - WALL_M), np.abs(points[:, 2] + FLOOR_M))


@pytest.mark.parametrize("threads", [1, 2])
def test_corners_become_points_where_they_are(corner: tuple[Path, Observations, Unknowns], threads: int) -> None:
    folder, seen, truth = corner
    settings = AdjustmentSettings(new_points=FEW)
    found, points = with_new_points(seen, truth, photos(folder, 10), settings, threads=threads)
    count = len(truth.points)
    np.testing.assert_array_equal(points[:count], truth.points)
    new = points[count:]
    assert len(new) > 500
    assert np.percentile(off_the_paint(new), 95) < 0.02
    # What was seen before is seen still, and all is in the order of photos.
    keys = found.photo * len(points) + found.point
    assert (np.diff(keys) > 0).all()
    np.testing.assert_array_equal(keys[found.point < count], np.sort(seen.photo * len(points) + seen.point))
    of_new = found.of(found.point >= count)
    assert np.bincount(of_new.point - count, minlength=len(new)).min() >= 3
    assert (of_new.weight == 1).all()
    np.testing.assert_allclose(found.tau, found.xy[:, 1] / HEIGHT - 0.5)
    residuals = replace(truth, points=points).residuals(of_new)
    assert np.median(np.linalg.norm(residuals, axis=1)) < 0.15


def test_what_is_seen_under_no_angle_is_no_point(corner: tuple[Path, Observations, Unknowns]) -> None:
    """As clouds in the sky are: infinitely far, they would say where the cameras look, and move in the wind."""
    folder, seen, truth = corner
    count = len(truth.points)
    wide = AdjustmentSettings(new_points=replace(FEW, min_angle_deg=20.0))
    found, points = with_new_points(seen, truth, photos(folder, 10), wide)
    everything, _ = with_new_points(seen, truth, photos(folder, 10), AdjustmentSettings(new_points=FEW))
    assert 50 < len(points) - count < 0.9 * (everything.point.max() + 1 - count)
    lines = truth.centers[found.photo] - points[found.point]
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    for point in range(count, len(points), 25):
        of_it = lines[found.point == point]
        assert np.degrees(np.arccos(np.clip((of_it @ of_it.T).min(), -1, 1))) > 20.0


@pytest.mark.parametrize(
    "settings",
    [NewPointSettings(per_photo=0), NewPointSettings(most=5), NewPointSettings(min_base=5.0, max_base=9.0)],
    ids=["none wanted", "too many photos", "no neighbour"],
)
def test_without_corners_all_stays_as_it_is(
    corner: tuple[Path, Observations, Unknowns], settings: NewPointSettings
) -> None:
    folder, seen, truth = corner
    found, points = with_new_points(seen, truth, photos(folder, 10), AdjustmentSettings(new_points=settings))
    assert found is seen
    assert points is truth.points


def test_of_photos_without_structure_no_corner_is_a_point(tmp_path: Path) -> None:
    seen, truth = painted_corner(tmp_path, painted=False)
    found, points = with_new_points(seen, truth, photos(tmp_path, 10), AdjustmentSettings(new_points=FEW))
    assert len(points) - len(truth.points) < 10
    assert len(found.photo) - len(seen.photo) < 40


@one_blas_thread()
def test_cameras_of_few_features_become_surer_by_corners(corner: tuple[Path, Observations, Unknowns]) -> None:
    folder, seen, truth = corner
    few, used = seen.of_points(np.arange(len(truth.points)) % 4 == 0)
    rng = np.random.default_rng(3)
    start = replace(
        truth,
        translations=truth.translations + rng.normal(0, 0.004, truth.translations.shape),
        points=truth.points[used] + rng.normal(0, 0.004, (len(used), 3)),
    )

    def error(per_photo: int) -> tuple[float, int, float]:
        settings = AdjustmentSettings(new_points=NewPointSettings(per_photo=per_photo))
        found, told = adjust_photos(model_of(few, start), settings, images=folder)
        centers = like(from_model(found)[1], truth).centers
        std = float(np.median([one.center_std for one in told.precisions.values()]))
        return float(np.sqrt(((centers - truth.centers) ** 2).sum(1).mean())), told.patches, std

    (without, patches, std), (found, more, surer) = error(0), error(400)
    assert more > 3 * patches
    assert found < 0.7 * without
    assert surer < 0.7 * std


def test_patches_are_asked_for_what_features_do_not_bear_out() -> None:
    """Features half a pixel off show the turning alone; what is known to a twentieth shows all there is."""
    settings = AdjustmentSettings(decide_with=100)
    effects = PHONE * [0.4, 0, 0, 1, 1, 1, 0, 0, 0]
    seen, truth = phone_walk(effects=effects, noise_px=0.6)
    start = replace(truth, own=np.zeros_like(truth.own))
    by_features = tried_in_turn(seen, start, weighting(16), settings)
    assert by_features is not None
    features = by_features.evidence
    assert features.groups == (Group.turn,)
    exact, _ = phone_walk(effects=effects, noise_px=0.05)
    at = with_points_fitted(exact, replace(features.cameras, points=truth.points), 1.0)
    found = asked_again(features, exact, at, weighting(16), settings)
    assert set(found.groups) == {Group.turn, Group.focal}
    # Each group is told of once: that which was kept by what kept it, the others by the features.
    assert sorted(trial.group.name for trial in found.trials) == ["drift", "focal", "principal", "turn"]
    assert {trial.group for trial in found.trials if trial.kept} == set(found.groups)
    # Where features bear out nothing patches are not asked, and where they bear out everything neither.
    for groups in ((), tuple(Group)):
        told = replace(features, groups=groups)
        assert asked_again(told, exact, at, weighting(16), settings) is told

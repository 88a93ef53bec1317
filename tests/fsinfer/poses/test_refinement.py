"""The last adjustment: a lens as rich as the photographs bear, and points worth keeping."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fsinfer.poses.refinement import RefinementSettings, is_monotone, refine, settle
from fsinfer.progress import silent

pycolmap = pytest.importorskip("pycolmap")


def camera(model: str, *params: float) -> Any:
    return pycolmap.Camera(camera_id=1, model=model, width=1000, height=800, params=[900.0, 500.0, 400.0, *params])


@pytest.mark.parametrize("k1", [0.0, -0.1, 0.15])
def test_lenses_of_phones_are_monotone(k1: float) -> None:
    assert is_monotone(camera("RADIAL", k1, 0.0))


@pytest.mark.parametrize(
    ("k1", "k2"), [(-0.7, 0.0), (0.3, -0.9), (1.0, 1.0)], ids=["folds", "folds at the corners", "runs off"]
)
def test_lenses_that_fold_or_run_off_within_the_image_are_not(k1: float, k2: float) -> None:
    assert not is_monotone(camera("RADIAL", k1, k2))


NOISE_PX = 0.2


def model_of(frames: int, params: list[float]) -> Any:
    """A model whose observations are those of a RADIAL lens, with a simple lens that is a little off."""
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, frames
    options.num_points3D, options.num_points2D_without_point3D = 150, 0
    options.camera_model_id = pycolmap.CameraModelId.RADIAL
    options.camera_params = params
    model = pycolmap.synthesize_dataset(options)
    (lens,) = model.cameras.values()
    lens.model = pycolmap.CameraModelId.SIMPLE_RADIAL
    lens.params = [params[0] * 1.01, params[1], params[2], 0.0]
    rng = np.random.default_rng(0)
    for image in model.images.values():
        for point in image.points2D:
            point.xy += rng.normal(0, NOISE_PX, 2)
    return model


def error_px(lens: Any, params: list[float]) -> float:
    """Greatest distance of a ray's pixel from that of the true RADIAL lens, out to where the points are seen."""
    radius, angle = np.meshgrid(np.linspace(0, 0.22, 12), np.linspace(0, 6, 12))
    rays = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones_like(radius)], axis=-1).reshape(-1, 3)
    true = pycolmap.Camera(camera_id=1, model="RADIAL", width=lens.width, height=lens.height, params=params)
    return float(np.linalg.norm(lens.img_from_cam(rays) - true.img_from_cam(rays), axis=1).max())


def test_the_lens_of_the_photographs_is_found() -> None:
    true = [1280.0, 512.0, 384.0, -0.5, 2.0]
    given = model_of(9, true)
    found = refine(given, RefinementSettings(), silent)
    (lens,) = found.cameras.values()
    # Once two coefficients explain the photographs a richer lens gains nothing.
    assert lens.model.name == "RADIAL"
    assert error_px(lens, true) < 0.3
    assert found.compute_mean_reprojection_error() < 1.5 * NOISE_PX
    (untouched,) = given.cameras.values()
    assert untouched.model.name == "SIMPLE_RADIAL"
    assert error_px(untouched, true) > 2.5


def test_few_photographs_keep_the_simple_lens() -> None:
    true = [1280.0, 512.0, 384.0, -0.5, 0.0]
    found = refine(model_of(7, true), RefinementSettings(), silent)
    (lens,) = found.cameras.values()
    assert lens.model.name == "SIMPLE_RADIAL"
    assert error_px(lens, true) < 0.3


def test_observations_far_off_are_dropped() -> None:
    given = model_of(9, [1280.0, 512.0, 384.0, -0.05, 0.0])
    observed = sum(len(point.track.elements) for point in given.points3D.values())
    point_id = next(iter(given.points3D))
    element = given.points3D[point_id].track.elements[0]
    given.images[element.image_id].points2D[element.point2D_idx].xy += np.array([40.0, 0.0])
    found = refine(given, RefinementSettings(), silent)
    assert sum(len(point.track.elements) for point in found.points3D.values()) == observed - 1
    before = found.compute_mean_reprojection_error()
    settle(found)
    assert found.compute_mean_reprojection_error() < before
    assert found.compute_mean_reprojection_error() < 1.5 * NOISE_PX

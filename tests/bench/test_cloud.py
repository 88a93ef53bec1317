"""Precision and recall of a cloud: what lies off the surface, and what of the surface is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsinfer.scene import read_scene
from tests.bench.cloud import CELL_M, cloud_figures, true_surface
from tests.support.plane_scene import PLANE_DEPTH, write_plane_scene

STEM = {"x_m": 0.0, "y_m": 0.0, "z_ground_m": 0.0, "dbh_cm": 30.0}


def bark(radius_m: float, turned: float = 2 * np.pi) -> np.ndarray:
    """A stem from the ground to 2.5 m."""
    angle, height = np.meshgrid(np.arange(0, turned, 0.02), np.arange(0, 2.5, 0.01))
    return np.column_stack([radius_m * np.cos(angle.ravel()), radius_m * np.sin(angle.ravel()), height.ravel()])


CAMERAS = np.array([[3.0, 0, 1.5]])


def test_a_cloud_that_is_the_surface_is_right_and_whole() -> None:
    found = cloud_figures(bark(0.15), bark(0.15), CAMERAS, [STEM])
    assert [value for name, value in found.items() if name != "points"] == pytest.approx([100.0] * 12)


def test_what_lies_beside_the_surface_and_what_is_missing_count() -> None:
    # Half of the stem, and a fringe of as many points 1.5 cm outside of the other half.
    cloud = np.concatenate([bark(0.15, np.pi), bark(0.165, np.pi)])
    found = cloud_figures(cloud, bark(0.15), CAMERAS, [STEM])
    assert found["stems_precision_10mm_percent"] == pytest.approx(50, abs=2)
    assert found["stems_precision_20mm_percent"] == pytest.approx(100)
    assert found["stems_recall_10mm_percent"] == pytest.approx(50, abs=4)
    far = np.array([[20.0, 0, 1.5]])
    assert np.isnan(cloud_figures(cloud, bark(0.15), far, [STEM])["precision_10mm_percent"])


def test_only_what_is_about_breast_height_is_a_stem() -> None:
    low = bark(0.15)[bark(0.15)[:, 2] < 0.5]
    found = cloud_figures(np.concatenate([bark(0.15), 1.2 * low]), bark(0.15), CAMERAS, [STEM])
    assert found["stems_precision_10mm_percent"] == pytest.approx(100)
    assert found["precision_10mm_percent"] < 90
    beside = bark(0.15) + np.array([0.6, 0, 0])  # a stem that is none
    found = cloud_figures(np.concatenate([bark(0.15), beside]), bark(0.15), CAMERAS, [STEM])
    assert found["stems_precision_10mm_percent"] == pytest.approx(100)
    assert found["precision_10mm_percent"] == pytest.approx(50, abs=1)


def test_the_true_surface_is_where_the_views_see_it(tmp_path: Path) -> None:
    points = true_surface(read_scene(write_plane_scene(tmp_path)))
    np.testing.assert_allclose(points[:, 2], PLANE_DEPTH, atol=1e-5)
    assert len(np.unique(np.floor(points[:, :2] / CELL_M), axis=0)) == len(points)

"""What is mapped apart from the rest has its calibration, where the rest knows one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsinfer.poses.colmap import with_calibration
from fsinfer.poses.mapping import tells_focal_length

pycolmap = pytest.importorskip("pycolmap")


def looking(*headings_deg: float) -> Any:
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="SIMPLE_RADIAL", width=100, height=80, params=[90.0, 50.0, 40.0, 0.01], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    for number, heading in enumerate(headings_deg):
        turn = pycolmap.Rotation3d(Rotation.from_euler("y", heading, degrees=True).as_quat())
        image = pycolmap.Image(f"{number:02d}.jpg", np.zeros((0, 2)), 1, number + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(turn, np.array([0.0, 0.0, number])))
    return model


def test_who_only_walks_ahead_does_not_know_the_focal_length() -> None:
    assert not tells_focal_length(looking(0, 5, -8, 10, 20))
    assert tells_focal_length(looking(0, 20, 40, 70))


def test_a_copy_of_the_database_gets_the_calibration_and_the_database_keeps_its_own(tmp_path: Path) -> None:
    given = pycolmap.Camera(model="SIMPLE_RADIAL", width=100, height=80, params=[120.0, 50.0, 40.0, 0.0], camera_id=1)
    with pycolmap.Database.open(tmp_path / "given.db") as opened:
        opened.write_camera(given, use_camera_id=True)
    model = looking(0, 90)
    copy = with_calibration(tmp_path / "given.db", [model.cameras[1]], tmp_path / "alone.db")
    with pycolmap.Database.open(copy) as opened:
        np.testing.assert_allclose(opened.read_camera(1).params, [90.0, 50.0, 40.0, 0.01])
    with pycolmap.Database.open(tmp_path / "given.db") as opened:
        np.testing.assert_allclose(opened.read_camera(1).params, [120.0, 50.0, 40.0, 0.0])
    assert not model.cameras[1].has_prior_focal_length  # the model is not changed

"""Distances from epipolar lines: none where cameras are true, and what they are off by where one is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.scene import read_scene
from tests.bench.epipolar import followed, fundamental, main, off_their_lines
from tests.support.plane_scene import write_plane_scene


def test_points_of_true_cameras_lie_on_their_lines(tmp_path: Path) -> None:
    one, other = (view.camera for view in read_scene(write_plane_scene(tmp_path)).views[:2])
    points = np.random.default_rng(0).uniform([-0.3, -0.3, 1], [0.3, 0.3, 3], (50, 3))
    in_one = points @ one.intrinsic.T
    world = (np.column_stack([points, np.ones(50)]) @ np.linalg.inv(one.cam_from_world).T)[:, :3]
    in_other = (world @ other.cam_from_world[:3, :3].T + other.cam_from_world[:3, 3]) @ other.intrinsic.T
    pixels = [at[:, :2] / at[:, 2:] for at in (in_one, in_other)]
    assert off_their_lines(fundamental(one, other), *pixels).max() < 1e-6
    # A principal point that is off moves all lines by as much as is across them.
    intrinsic = other.intrinsic.copy()
    intrinsic[:2, 2] += 2.0
    off = off_their_lines(fundamental(one, replace(other, intrinsic=intrinsic)), *pixels)
    assert 0.5 < off.max() < 2.9


def test_corners_are_followed_over_a_plane(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_plane_scene(tmp_path, height=216, width=280)
    main([str(scene)])
    told = capsys.readouterr().out
    assert float(told.split(" px off")[0].split()[-1]) < 0.1
    assert " 0 corners" not in told


def test_a_picture_without_corners_has_none_to_follow() -> None:
    flat = np.full((60, 80), 7, np.uint8)
    one, other = followed(flat, flat)
    assert len(one) == len(other) == 0

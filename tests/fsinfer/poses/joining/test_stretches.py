"""A model whose second half was put on wrongly is cut, put together by the matches left over, and refined."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fsinfer.geometry.similarity import apply, fit_similarity
from fsinfer.poses.joining import stretches
from fsinfer.poses.joining.stretches import cut_and_join
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.verification.pair_votes import pair_votes
from fsinfer.progress import silent

pycolmap = pytest.importorskip("pycolmap")

PHOTOS = 12


def synthetic(database: Path) -> Any:
    pycolmap.set_random_seed(0)  # where its cameras stand, and how upright, is drawn
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, PHOTOS
    options.num_points3D = 200
    with pycolmap.Database.open(database) as opened:
        return pycolmap.synthesize_dataset(options, opened)


def bend(model: Any, image_ids: list[int]) -> None:
    """Move these photos, with points of their own, to another place, turn and scale."""
    turn = Rotation.from_rotvec([0.1, 0.4, -0.2])
    moved = pycolmap.Sim3d(1.3, pycolmap.Rotation3d(turn.as_quat()), np.array([2.0, -0.5, 1.0]))
    for point_id in list(model.point3D_ids()):
        point = model.points3D[point_id]
        own = [(e.image_id, e.point2D_idx) for e in point.track.elements if e.image_id in image_ids]
        xyz, color = moved * point.xyz, point.color
        for image_id, index in own:
            if model.images[image_id].points2D[index].has_point3D():  # a point seen but once is gone
                model.delete_observation(image_id, index)
        if len(own) >= 2:
            track = pycolmap.Track()
            for image_id, index in own:
                track.add_element(image_id, index)
            model.add_point3D(xyz, track, color)
    for image_id in image_ids:
        image = model.images[image_id]
        rotation = image.cam_from_world().rotation * pycolmap.Rotation3d(turn.inv().as_quat())
        center = moved * image.projection_center()
        pose = pycolmap.Rigid3d(rotation, -(rotation.matrix() @ center))
        model.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)


def straightened(model: Any, folder: Path, walk: list[str]) -> Any:
    database = folder / "database.db"
    votes = pair_votes(model, database)
    return cut_and_join(model, votes, database, walk, (), folder, PoseSettings(threads=1), silent)


def test_a_bent_walk_is_straightened(tmp_path: Path) -> None:
    model = synthetic(tmp_path / "database.db")
    (tmp_path / "images").mkdir()
    image_ids = sorted(model.reg_image_ids())
    walk = [model.images[i].name for i in image_ids]
    true = np.array([model.images[i].projection_center() for i in image_ids])
    bend(model, image_ids[7:])
    straight = straightened(model, tmp_path, walk)
    assert straight is not None
    assert sorted(straight.reg_image_ids()) == image_ids
    found = np.array([straight.images[i].projection_center() for i in image_ids])
    aligned = fit_similarity(found, true)
    assert aligned is not None
    assert np.linalg.norm(apply(aligned, found) - true, axis=1).max() < 1e-3 * np.ptp(true)


def test_its_stretches_are_joined_before_the_mapper_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = synthetic(tmp_path / "database.db")
    image_ids = sorted(model.reg_image_ids())
    walk = [model.images[i].name for i in image_ids]
    bend(model, image_ids[7:])
    monkeypatch.setattr(stretches, "reconstruct", lambda *_given, start: [start])
    straight = straightened(model, tmp_path, walk)
    assert straight is not None
    assert sorted(straight.reg_image_ids()) == image_ids


def test_a_walk_that_was_not_bent_is_left_alone(tmp_path: Path) -> None:
    model = synthetic(tmp_path / "database.db")
    walk = [model.images[i].name for i in sorted(model.reg_image_ids())]
    assert straightened(model, tmp_path, walk) is None
    assert not (tmp_path / "cut").exists()

"""A walk that was followed, and drifted on the way, is closed by the pairs that come back to a place."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.geometry.similarity import apply, fit_similarity
from fsinfer.poses.closing import closed, right_share
from fsinfer.poses.pairs import PairSettings
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.sure_pairs import SurePairs, map_sure, sure_pairs
from fsinfer.progress import silent
from tests.support.pairs_of_walk import PHOTOS, POINTS, names, pairs_of_walk, pose

pycolmap = pytest.importorskip("pycolmap")

#: A walk, however few its photos are.
SETTINGS = PoseSettings(threads=1, pairs=PairSettings(overlap=4, exhaustive_up_to=5))
FURTHER = ((0, 9), (2, 11), (3, 12), (0, 13))


@pytest.fixture
def sure(tmp_path: Path) -> SurePairs:
    """Of a walk that was followed from its first photo to its last."""
    (tmp_path / "images").mkdir()  # COLMAP asks for the photos' folder and reads none of them
    database = pairs_of_walk(tmp_path / "pairs.db", known=True, further=FURTHER)
    found = sure_pairs(database, names(), tmp_path, SETTINGS, silent)
    assert found.followed is not None
    assert found.followed.num_reg_images() == PHOTOS
    return found


def centers(model: Any) -> NDArray[np.float64]:
    """(PHOTOS, 3) in the order of walking."""
    by_name = {model.images[i].name: model.images[i].projection_center() for i in model.reg_image_ids()}
    return np.array([by_name[name] for name in names()])


def off(model: Any) -> float:
    """How far the cameras are from the truth, RMS; they stand 5 from the middle, 1.05 apart."""
    true = np.array([-rotation.T @ shift for rotation, shift in map(pose, range(PHOTOS))])
    there = fit_similarity(centers(model), true)
    assert there is not None
    return float(np.sqrt(((apply(there, centers(model)) - true) ** 2).sum(1).mean()))


def drifted(model: Any, by: float) -> Any:
    """The model with each photo turned and moved a little more than the one before, and its points as they were."""
    changed = deepcopy(model)
    for i in changed.reg_image_ids():
        image = changed.images[i]
        step = names().index(image.name) * by
        turn = Rotation.from_rotvec([0.0, 0.01 * step, 0.004 * step]).as_matrix()
        there = image.cam_from_world().matrix()
        moved = np.column_stack([turn @ there[:, :3], turn @ there[:, 3] + [0.02 * step, 0.01 * step, 0.0]])
        image.frame.set_cam_from_world(image.camera_id, pycolmap.Rigid3d(moved))
    return changed


@pytest.mark.parametrize("by", [0.1, 0.5])
def test_a_walk_that_drifted_comes_back(sure: SurePairs, by: float) -> None:
    """The second one is adjusted twice."""
    given = drifted(sure.followed, by)
    assert off(given) > 0.04 * by
    assert right_share(given, sure.true, sure.database) < 0.5
    before = centers(given)
    model = closed(given, sure.true, sure.database)
    assert model is not None
    assert off(model) < 0.002
    assert model.num_points3D() > 0.95 * POINTS
    # Photos at both ends see the same points as one.
    assert max(point.track.length() for point in model.points3D.values()) == PHOTOS
    assert np.array_equal(centers(given), before)  # what was given stays


def test_one_in_which_true_pairs_are_wrong_is_none(sure: SurePairs) -> None:
    assert closed(drifted(sure.followed, 40.0), sure.true, sure.database) is None


def test_the_share_counts_matches_of_true_pairs_alone(sure: SurePairs, tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "false.db", known=True, further=FURTHER, false={(1, 12): 2})
    true, false = frozenset({(1, 10), (3, 12)}), frozenset({(2, 13)})
    assert right_share(sure.followed, true, database) == 1.0
    # 240 of each true pair, 60 of the false one.
    assert right_share(sure.followed, true | false, database) == pytest.approx(480 / 540, abs=0.01)
    assert right_share(sure.followed, frozenset(), database) == 0.0


def test_a_followed_walk_is_closed_and_not_mapped_anew(
    sure: SurePairs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def reconstruct(*_: Any, **__: Any) -> list[Any]:
        raise AssertionError

    monkeypatch.setattr("fsinfer.poses.sure_pairs.reconstruct", reconstruct)
    told: list[tuple[int, int, str]] = []
    (model,) = map_sure(
        sure,
        tmp_path / "images",
        tmp_path / "models",
        SETTINGS,
        lambda done, total, what: told.append((done, total, what)),
    )
    assert off(model) < 0.01
    assert told == [(0, PHOTOS, "placing photos"), (PHOTOS, PHOTOS, "placing photos")]


def test_a_walk_that_does_not_close_is_mapped_anew(
    sure: SurePairs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsinfer.poses.sure_pairs.closed", lambda *_: None)
    (model,) = map_sure(sure, tmp_path / "images", tmp_path / "models", SETTINGS, silent)
    assert model.num_reg_images() == PHOTOS
    assert off(model) < 0.01


def test_a_walk_that_was_followed_in_parts_is_none_to_close(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    few = {(i, j): 0 for i in range(PHOTOS) for j in range(i + 1, PHOTOS) if i < 7 <= j and j - i <= 2}
    database = pairs_of_walk(tmp_path / "pairs.db", known=True, few=few, further=FURTHER)
    assert sure_pairs(database, names(), tmp_path, SETTINGS, silent).followed is None

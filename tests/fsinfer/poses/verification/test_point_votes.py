"""Matches whose points lie elsewhere are false, though they lie on their epipolar lines."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from fsinfer.poses.colmap import reconstruct
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.verification.misplaced import drop
from fsinfer.poses.verification.pair_votes import pair_votes
from fsinfer.poses.verification.point_votes import PointVote, point_votes
from fsinfer.progress import silent
from tests.support.pairs_of_walk import FOCAL_PX, PHOTOS, POINTS, pairs_of_walk

pytest.importorskip("pycolmap")

#: Photo 12 is taken to show what photo 2 sees; photo 9 all that 4 sees twice as far away.
FALSE, ALONG = {(1, 12): 2}, {(4, 9): 2.0}


@pytest.fixture
def database(tmp_path: Path) -> Path:
    few = {(0, 11): 14}  # too few to count
    return pairs_of_walk(
        tmp_path / "pairs.db", known=True, further=((0, 9), (0, 11)), false=FALSE, along=ALONG, few=few
    )


@pytest.fixture
def model(database: Path, tmp_path: Path) -> Any:
    true = pairs_of_walk(tmp_path / "true.db", known=True)
    # The photos of both have the same numbers and begin with the same features.
    (model,) = reconstruct(true, tmp_path, tmp_path / "models", PoseSettings(threads=1), silent)
    assert model.num_reg_images() == PHOTOS
    return model


def by_rank(votes: list[PointVote]) -> dict[tuple[int, int], PointVote]:
    return {(vote.first - 1, vote.second - 1): vote for vote in votes}


def test_points_tell_true_pairs_from_false_ones(database: Path, model: Any) -> None:
    votes = by_rank(point_votes(model, database))
    assert set(votes) == {(i, j) for i in range(PHOTOS) for j in range(i + 1, min(PHOTOS, i + 5))} | {
        (0, 9), *FALSE, *ALONG,
    }  # fmt: skip
    for pair, vote in votes.items():
        if pair in FALSE or pair in ALONG:
            assert vote.error > 0.05
            assert vote.points == 60  # of the first photo; the features of the second are in no track
        else:
            assert vote.error < 1.0 / FOCAL_PX
            assert vote.points > 1.9 * POINTS
            assert vote.matches == POINTS
    asked = {(5, 10), (1, 10), (1, 14)}
    assert by_rank(point_votes(model, database, asked)) == {pair: votes[pair] for pair in ((4, 9), (0, 9))}


def test_epipolar_lines_do_not_tell_what_lies_along_them(database: Path, model: Any) -> None:
    agrees = {(vote.first, vote.second): vote.agrees for vote in pair_votes(model, database)[1]}
    assert agrees[4, 9]
    assert not agrees[1, 12]


def test_photos_without_a_place_have_no_vote_and_pairs_without_points_no_error(database: Path, model: Any) -> None:
    number = {str(model.images[i].name): i for i in model.reg_image_ids()}
    drop(model, [number["00.jpg"]])
    assert all(vote.first != 1 for vote in point_votes(model, database))
    for point in list(model.points3D):
        model.delete_point3D(point)
    votes = point_votes(model, database)
    assert votes
    assert {vote.points for vote in votes} == {0}
    assert all(math.isnan(vote.error) for vote in votes)


def test_a_point_behind_a_photo_is_infinitely_far_off(database: Path, model: Any) -> None:
    (first,) = (i for i in model.reg_image_ids() if model.images[i].name == "00.jpg")
    image = model.images[first]
    behind = image.projection_center() - 5.0 * image.cam_from_world().rotation.matrix()[2]
    for point in list(model.points3D):
        model.points3D[point].xyz = behind
    votes = by_rank(point_votes(model, database))
    assert math.isinf(votes[0, 1].error)
    assert not math.isinf(votes[9, 13].error)

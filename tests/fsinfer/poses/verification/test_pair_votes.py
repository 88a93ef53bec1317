"""A photo placed against its own matches is found, also where several vouch for each other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.poses.adjustment.last_fit import usual_step
from fsinfer.poses.adjustment.problem import from_model
from fsinfer.poses.verification.misplaced import drop_contradicted
from fsinfer.poses.verification.pair_votes import (
    Ballot,
    PairVote,
    contradicted,
    false_pairs,
    outvoted_stretch,
    pair_votes,
    parallax,
    sampson_error,
    telling,
    telling_votes,
)


def ring_of_votes(count: int, wrong: set[int], rng: np.random.Generator) -> list[PairVote]:
    """Each photo is matched with six next ones; pairs across the border of the wrong part mostly contradict."""
    votes = []
    for first in range(count):
        for step in range(1, 7):
            second = (first + step) % count
            agrees = (first in wrong) == (second in wrong)
            votes.append(PairVote(first=first, second=second, matches=int(rng.integers(30, 200)), agrees=agrees))
    return votes


@settings(max_examples=30)
@given(st.integers(40, 80), st.integers(1, 18), st.integers(0, 999))
def test_a_wrong_block_is_found_and_nothing_else(count: int, size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = int(rng.integers(0, count - size))
    wrong = set(range(start, start + size))
    found = contradicted(ring_of_votes(count, wrong, rng), count)
    assert wrong <= set(np.flatnonzero(found))
    assert found.sum() <= size + 2  # a neighbour on the border may go with them


def test_a_part_tied_in_by_false_matches_is_found_and_the_false_pairs_named() -> None:
    rng = np.random.default_rng(1)
    wrong = set(range(20, 38))
    votes = ring_of_votes(120, wrong, rng)
    # Two pairs of look-alikes share as many matches as poor neighbours do.
    votes.append(PairVote(first=30, second=90, matches=120, agrees=True))
    votes.append(PairVote(first=31, second=91, matches=90, agrees=True))
    votes.append(PairVote(first=60, second=100, matches=40, agrees=False))
    found = contradicted(votes, 120)
    assert set(np.flatnonzero(found)) == wrong
    assert {(vote.first, vote.second) for vote in false_pairs(votes, found)} == {(30, 90), (31, 91), (60, 100)}


@given(st.integers(3, 7), st.integers(0, 9999))
@settings(max_examples=30)
def test_the_worst_stretch_is_that_of_a_search_by_hand(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = np.array([(a, b) for a in range(count) for b in range(count) if a < b and rng.random() < 0.8], int)
    ends = ends.reshape(-1, 2)
    weight, agrees = rng.integers(15, 200, len(ends)).astype(float), rng.random(len(ends)) < 0.6
    best, shares = 0.5, {}
    for start in range(count):
        for end in range(start + 1, min(start + count // 2, count) + 1):
            inside = (ends >= start) & (ends < end)
            leaving = inside.sum(axis=1) == 1
            if leaving.any():
                shares[start, end] = weight[leaving & agrees].sum() / weight[leaving].sum()
                best = min(best, shares[start, end])
    found = np.flatnonzero(
        outvoted_stretch(Ballot(ends=ends, weight=weight, agrees=agrees), np.ones(count, dtype=bool), 0.5)
    )
    assert bool(len(found)) == (best < 0.5)
    if len(found):
        assert shares[found[0], found[-1] + 1] == pytest.approx(best)
        assert len(found) == found[-1] + 1 - found[0]


def test_a_stretch_is_found_though_its_false_ties_are_stronger_than_its_true_ones() -> None:
    rng = np.random.default_rng(2)
    wrong = set(range(20, 38))
    votes = ring_of_votes(120, wrong, rng)
    votes += [PairVote(first=30 + k, second=90 + k, matches=400, agrees=True) for k in range(3)]
    assert set(np.flatnonzero(contradicted(votes, 120, stretches="before"))) == wrong


def test_those_who_vouch_for_each_other_fall_one_after_the_other() -> None:
    # 1 and 2 support each other, all others contradict 1; once 1 is gone, nobody speaks for 2.
    others = [PairVote(first=0, second=k, matches=500, agrees=True) for k in range(3, 8)]
    votes = [
        *others,
        PairVote(first=1, second=2, matches=100, agrees=True),
        PairVote(first=0, second=1, matches=90, agrees=False),
        PairVote(first=2, second=3, matches=40, agrees=False),
    ]
    assert list(np.flatnonzero(contradicted(votes, 8))) == [1, 2]


def test_without_votes_nobody_is_wrong() -> None:
    assert not contradicted([], 4).any()


def test_sampson_error_of_true_matches_is_zero_and_grows_with_the_distance() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform([-1, -1, 3], [1, 1, 6], (50, 3))
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix()
    motion[:3, 3] = [0.5, 0.1, -0.2]
    moved = points @ motion[:3, :3].T + motion[:3, 3]
    one, other = points / points[:, 2:], moved / moved[:, 2:]
    assert sampson_error(one, other, motion).max() < 1e-12
    # Across the epipolar line (baseline along x, roughly) by 0.01: two rays share the error.
    shifted = sampson_error(one, other + np.array([0, 0.01, 0]), motion)
    assert 0.003 < np.median(shifted) < 0.01


def test_what_is_far_away_does_not_vote() -> None:
    rng = np.random.default_rng(0)
    near = rng.uniform([-1, -1, 3], [1, 1, 6], (40, 3))
    far = 4000 * near[:30] + rng.uniform(-900, 900, (30, 3))
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix()
    motion[:3, 3] = [0.5, 0.1, -0.2]

    def rays(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        moved = points @ motion[:3, :3].T + motion[:3, 3]
        return points / points[:, 2:], moved / moved[:, 2:]

    def counts(points: NDArray[np.float64], assumed: NDArray[np.float64]) -> tuple[int, int, int]:
        one, other = rays(points)
        fits, tells = telling(one, other, assumed, 0.003, parallax(one, other, assumed[:3, :3]) > 0.006)
        return int(fits.sum()), int(tells.sum()), int((fits & tells).sum())

    both = np.concatenate([near, far])
    assert counts(both, motion) == (70, 40, 40)
    # One camera was put 15 m aside: what is far away fits there as well, what is near does not.
    aside = motion.copy()
    aside[:3, 3] = [-2.0, 15.0, 1.0]
    fit, tell, both_fit = counts(both, aside)
    assert tell == 40
    assert both_fit <= 4
    assert fit - both_fit == 30
    assert counts(far, aside) == (30, 0, 0)
    # A wrong turn contradicts what is far away as well.
    turned = motion.copy()
    turned[:3, :3] = Rotation.from_rotvec([0.1, -0.1, 0.05]).as_matrix()
    fit, tell, _ = counts(far, turned)
    assert tell == 30
    assert fit <= 8


def test_votes_of_what_tells_leave_out_pairs_that_see_nothing_near() -> None:
    votes = [
        PairVote(first=0, second=1, matches=200, agrees=True, telling=40, telling_agrees=False),
        PairVote(first=1, second=2, matches=200, agrees=True, telling=5, telling_agrees=False),
    ]
    assert telling_votes(votes) == [PairVote(first=0, second=1, matches=40, agrees=False)]


def test_parts_that_were_joined_by_other_evidence_are_not_outvoted() -> None:
    # Twelve photos and six more that vouch for each other; across, false matches speak against them.
    votes = [PairVote(first=a, second=b, matches=100, agrees=True) for a in range(12) for b in range(a)]
    votes += [PairVote(first=a, second=b, matches=100, agrees=True) for a in range(12, 18) for b in range(12, a)]
    votes += [PairVote(first=a, second=a + 12, matches=30, agrees=a == 0) for a in range(6)]
    assert contradicted(votes, 18).tolist() == [False] * 12 + [True] * 6
    assert not contradicted(votes, 18, parts=False).any()
    # A single photo is.
    votes += [PairVote(first=a, second=18, matches=100, agrees=False) for a in range(8)]
    assert np.flatnonzero(contradicted(votes, 19, parts=False)).tolist() == [18]


def test_a_moved_photo_leaves_the_model(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 7
    options.num_points3D = 300
    with pycolmap.Database.open(tmp_path / "database.db") as database:
        model = pycolmap.synthesize_dataset(options, database)
    image_ids, votes = pair_votes(model, tmp_path / "database.db")
    assert len(image_ids) == 7
    assert len(votes) == 21
    assert all(vote.agrees for vote in votes)
    assert drop_contradicted(model, tmp_path / "database.db") == []
    image = model.images[image_ids[3]]
    pose = image.cam_from_world()
    turn = pycolmap.Rotation3d(Rotation.from_rotvec([0.0, 0.2, 0.1]).as_quat())
    model.frame(image.frame_id).set_cam_from_world(
        image.camera_id, pycolmap.Rigid3d(turn, np.array([0.3, 0, 0])) * pose
    )
    # None of its true matches agreed with where it was, so that none is forgotten.
    _, votes = pair_votes(model, tmp_path / "database.db")
    assert false_pairs(votes, contradicted(votes, 7)) == []
    assert drop_contradicted(model, tmp_path / "database.db") == [image.name]


def test_photos_of_two_cameras_in_turn_are_numbered_as_they_were_taken(tmp_path: Path) -> None:
    # Held upright and across in turn: COLMAP's ids go camera by camera, and neighbours would stand far apart by them.
    pycolmap = pytest.importorskip("pycolmap")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 2, 1, 6
    options.num_points3D = 300
    with pycolmap.Database.open(tmp_path / "database.db") as database:
        model = pycolmap.synthesize_dataset(options, database)
    ids = sorted(model.reg_image_ids())
    taken = [f"{2 * (rank % 6) + rank // 6:05d}.jpg" for rank in range(12)]
    for image_id, name in zip(ids, taken, strict=True):
        model.images[image_id].name = name
    image_ids, votes = pair_votes(model, tmp_path / "database.db")
    assert [model.images[i].name for i in image_ids] == sorted(taken)
    assert image_ids != ids
    assert all(vote.agrees for vote in votes)
    # The adjustment's usual step is that from photo to photo, too.
    seen, start, numbers = from_model(model)
    assert list(numbers.images) == image_ids
    centers = [model.images[i].projection_center() for i in image_ids]
    assert usual_step(start) == pytest.approx(np.median(np.linalg.norm(np.diff(centers, axis=0), axis=1)))
    assert (np.diff(seen.photo) >= 0).all()

"""A part that hangs on the rest by a few points is found; a firmly joined one, or a single photo, is not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from fsinfer.poses.verification.loose_parts import MIN_POINTS, loose_parts
from fsinfer.poses.verification.misplaced import LEFT_OUT, drop_loose_parts


def chain(photos: int, start: int, per_pair: int, first_point: int) -> tuple[list[tuple[int, int]], int]:
    """Photos in a row, each sharing ``per_pair`` points with the next."""
    seen = []
    point = first_point
    for photo in range(start, start + photos - 1):
        for _ in range(per_pair):
            seen += [(point, photo), (point, photo + 1)]
            point += 1
    return seen, point


def two_chains(
    first: int, second: int, joint: int, seed: int = 0
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """(points, photos, order) of two chains joined by ``joint`` points, the photos in a shuffled order."""
    left, point = chain(first, 0, 300, 0)
    right, point = chain(second, first, 300, point)
    # The joint lies between photos in the middle of both, as where a walk comes back to a place.
    ties = [(point + k, photo) for k in range(joint) for photo in (first // 2, first + second // 2)]
    order = np.random.default_rng(seed).permutation(first + second)
    points, photos = np.array(left + right + ties).T
    return points, order[photos], order


@given(st.integers(12, 40), st.integers(2, 11), st.integers(1, MIN_POINTS - 1), st.integers(0, 99))
def test_the_smaller_part_at_a_weak_joint_is_loose(first: int, second: int, joint: int, seed: int) -> None:
    points, photos, order = two_chains(first, second, joint, seed)
    loose = loose_parts(points, photos, first + second)
    assert loose[order[first:]].all()
    assert not loose[order[:first]].any()


@given(st.integers(3, 30), st.integers(2, 11), st.integers(MIN_POINTS, 400))
def test_a_firm_joint_holds(first: int, second: int, joint: int) -> None:
    points, photos, _ = two_chains(first, second, joint)
    assert not loose_parts(points, photos, first + second).any()


def test_many_weak_pairs_make_a_firm_joint() -> None:
    left, point = chain(10, 0, 300, 0)
    right, point = chain(8, 10, 300, point)
    # 8 pairs of photos across, 30 points each: no pair alone is firm, together they are.
    ties = [(point + 30 * pair + k, photo) for pair in range(8) for k in range(30) for photo in (pair, 10 + pair)]
    points, photos = np.array(left + right + ties).T
    assert not loose_parts(points, photos, 18).any()


def test_a_single_photo_is_left_to_itself() -> None:
    points, photos, _ = two_chains(10, 1, 20)
    assert not loose_parts(points, photos, 11).any()


def test_both_of_two_loose_parts_go() -> None:
    seen, point = chain(20, 0, 300, 0)
    for start, photos in ((20, 6), (26, 5)):
        part, point = chain(photos, start, 300, point)
        ties = [(point + k, photo) for k in range(40) for photo in (start - 3, start + 2)]
        seen += part + ties
        point += 40
    points, numbers = np.array(seen).T
    loose = loose_parts(points, numbers, 31)
    assert loose[20:].all()
    assert not loose[:20].any()


def test_no_points_make_no_part() -> None:
    nothing = np.zeros(0, dtype=np.intp)
    assert not loose_parts(nothing, nothing, 5).any()


def test_photos_of_a_loose_part_leave_the_model() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 8
    options.num_points3D = 400
    model = pycolmap.synthesize_dataset(options)
    ids = sorted(model.reg_image_ids())
    assert drop_loose_parts(model) == []
    # All but 30 points are now seen by the first five or by the last three photos only.
    for number, (point_id, point) in enumerate(list(model.points3D.items())):
        if number < 30:
            continue
        kept = ids[:5] if number % 2 else ids[5:]
        seen = [(element.image_id, element.point2D_idx) for element in point.track.elements]
        if sum(image_id in kept for image_id, _ in seen) < 2:
            model.delete_point3D(point_id)
            continue
        for image_id, index in seen:
            if image_id not in kept:
                model.delete_observation(image_id, index)
    expected = {model.images[i].name for i in ids[5:]}
    assert set(drop_loose_parts(model)) == expected
    assert set(model.reg_image_ids()) == set(ids[:5])
    told = sentence(notice(LEFT_OUT["loose"], photos=8, names=tuple(expected)))
    assert told.startswith(f"{len(expected)} of 8 photos left out ({', '.join(sorted(expected))})")
    assert "too few points" in told

"""Matches in COLMAP's database: each pair once, and as COLMAP takes them up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.descriptors import Descriptors, prepared
from fsinfer.poses.matches import inliers_by_rank, match_pairs
from fsinfer.poses.matching import PairMatcher
from fsinfer.poses.settings import PoseSettings
from fsinfer.progress import silent

pycolmap = pytest.importorskip("pycolmap")

NAMES = ["a.jpg", "b.jpg", "c.jpg"]
COUNT = 40


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """Three photos of the same features, those of each one further round."""
    rng = np.random.default_rng(0)
    values = rng.gamma(0.7, 1.0, (COUNT, 128))
    features = np.round(512 * values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.uint8)
    places = rng.uniform(20, 80, (COUNT, 2))
    path = tmp_path / "database.db"
    with open_database(path) as opened:
        camera = opened.write_camera(
            pycolmap.Camera(model="SIMPLE_RADIAL", width=100, height=100, params=[90, 50, 50, 0])
        )
        # Numbers in another order than the names.
        for rank in (2, 0, 1):
            number = opened.write_image(pycolmap.Image(name=NAMES[rank], camera_id=camera))
            opened.write_keypoints(number, np.roll(places + 4.0 * rank, rank, axis=0).astype(np.float32))
            opened.write_descriptors(
                number,
                pycolmap.FeatureDescriptors(
                    type=pycolmap.FeatureExtractorType.SIFT, data=np.roll(features, rank, axis=0)
                ),
            )
    return path


def matches(database: Path, first: str, second: str) -> NDArray[Any] | None:
    with open_database(database) as opened:
        numbers = [opened.read_image_with_name(name).image_id for name in (first, second)]
        return np.asarray(opened.read_matches(*numbers)) if opened.exists_matches(*numbers) else None


def matcher(database: Path) -> PairMatcher:
    return PairMatcher(database, NAMES, max_ratio=0.8, max_angle=0.7)


def test_each_pair_asked_for_is_matched_in_the_order_of_its_photos(database: Path) -> None:
    matcher(database).match([(0, 1), (2, 1)], threads=2)
    of_first = np.arange(COUNT)
    for first, second, by in (("a.jpg", "b.jpg", 1), ("c.jpg", "b.jpg", -1)):
        found = matches(database, first, second)
        assert found is not None
        assert sorted(map(tuple, found.tolist())) == sorted(zip(of_first, (of_first + by) % COUNT, strict=True))
    assert matches(database, "a.jpg", "c.jpg") is None


def test_a_pair_that_the_database_has_is_not_searched_again(database: Path) -> None:
    with open_database(database) as opened:
        numbers = [opened.read_image_with_name(name).image_id for name in ("a.jpg", "b.jpg")]
        opened.write_matches(*numbers, np.array([[3, 5]], dtype=np.uint32))
    asked = matcher(database)
    for _ in range(2):  # what was kept of photos is for the next pairs, and no reason to search these again
        asked.match([(0, 1), (0, 2)], threads=1)
    found = matches(database, "a.jpg", "b.jpg")
    assert found is not None
    assert found.tolist() == [[3, 5]]
    other = matches(database, "a.jpg", "c.jpg")
    assert other is not None
    assert len(other) == COUNT


def test_photos_are_kept_as_long_as_the_next_pairs_need_them(database: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of all photos of a long walk would not fit into memory."""
    made: list[int] = []

    def counted(descriptors: NDArray[np.uint8]) -> Descriptors:
        made.append(len(descriptors))
        return prepared(descriptors)

    monkeypatch.setattr("fsinfer.poses.matching.prepared", counted)
    asked = matcher(database)
    for pair, all_made in (((0, 1), 2), ((1, 2), 3), ((0, 2), 4)):  # the second photo is still there, the first is not
        asked.match([pair], threads=1)
        assert len(made) == all_made
        assert matches(database, *(NAMES[rank] for rank in pair)) is not None


def test_colmap_checks_what_it_is_given_and_searches_nothing(database: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of the first photo's features with those of the second, but for ten: its own search would find all."""
    given = np.column_stack([np.arange(30), np.arange(30) + 1]).astype(np.uint32)
    monkeypatch.setattr("fsinfer.poses.matching.matched", lambda *_, **__: given)
    match_pairs(database, NAMES, [(0, 1)], PoseSettings(), silent)
    found = matches(database, "a.jpg", "b.jpg")
    assert found is not None
    assert sorted(found.tolist()) == given.tolist()
    assert inliers_by_rank(database, NAMES) == {(0, 1): len(given)}

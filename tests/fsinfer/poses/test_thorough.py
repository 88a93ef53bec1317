"""Where a walk tears its photos are looked at again with more features, and only there."""

from __future__ import annotations

from pathlib import Path

import pytest

from fsinfer.io.images import write_image
from fsinfer.poses.colmap import extract_features
from fsinfer.poses.estimate import estimate_poses
from fsinfer.poses.matches import match_pairs
from fsinfer.poses.settings import PoseSettings, ThoroughSettings
from fsinfer.poses.thorough import rematch, seams, thorough_pairs, torn
from fsinfer.progress import silent
from tests.support.rendered_room import photographs

pycolmap = pytest.importorskip("pycolmap")

#: So few features that three of the eight photos hold together.
POOR = PoseSettings(max_features=60, enlarge_below_px=10, threads=1, thorough=ThoroughSettings(max_features=1000))


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    for index, image in enumerate(photographs()):
        write_image(folder / f"{index}.png", image)
    return folder


def test_a_walk_is_torn_below_the_share() -> None:
    settings = PoseSettings()
    assert not torn([True] * 97 + [False] * 3, settings)
    assert torn([True] * 96 + [False] * 4, settings)


def test_seams_reach_to_both_sides_of_what_is_missing() -> None:
    placed = [True] * 10 + [False] * 2 + [True] * 10
    assert seams(placed, 2) == [8, 9, 10, 11, 12, 13]
    assert seams([False, True, True, True], 1) == [0, 1]


def test_only_pairs_of_the_torn_places_are_matched_again() -> None:
    settings = PoseSettings(thorough=ThoroughSettings(overlap=3, net_stride=50, beside=2))
    placed = [True] * 20 + [False] * 2 + [True] * 20
    affected = seams(placed, 2)
    pairs = thorough_pairs(placed, affected, {(2, 19): 30, (3, 30): 80, (1, 20): 10}, settings)
    assert all(first < second for first, second in pairs)
    assert all(first in affected or second in affected for first, second in pairs)
    assert {(20, 23), (17, 20), (2, 19)} <= set(pairs)
    assert (1, 20) not in pairs  # fewer matches than count
    assert (3, 30) not in pairs  # neither of them is near the tear


def test_photos_beyond_the_tear_keep_their_features(room: Path, tmp_path: Path) -> None:
    walk = [f"{i}.png" for i in range(8)]
    database = tmp_path / "database.db"
    extract_features(database, room, {"camera": walk}, POOR, silent)
    match_pairs(database, walk, [(0, 1), (1, 2), (6, 7)], POOR, silent)
    settings = PoseSettings(
        max_features=60,
        enlarge_below_px=10,
        threads=1,
        thorough=ThoroughSettings(max_features=1000, beside=1, overlap=1, net_stride=9),
    )
    richer = rematch(database, room, {"camera": walk}, walk, [True] * 7 + [False], settings, silent)
    counts = []
    for path in (database, richer):
        with pycolmap.Database.open(path) as opened:
            ids = {image.name: image.image_id for image in opened.read_all_images()}
            counts.append([opened.num_keypoints_for_image(ids[name]) for name in walk])
            assert opened.exists_matches(ids["0.png"], ids["1.png"])
    assert counts[1][:6] == counts[0][:6]
    assert min(counts[1][6:]) > 4 * max(counts[0][6:])
    # The old matches of the photos at the tear would point at features that are no more.
    with pycolmap.Database.open(richer) as opened:
        pair = opened.read_matches(ids["6.png"], ids["7.png"])
        assert pair.max() > max(counts[0])


def test_photos_that_are_enlarged_have_a_limit_of_their_own(room: Path, tmp_path: Path) -> None:
    counts = {}
    for name, below in (("as it is", 10), ("enlarged", 10_000)):
        settings = PoseSettings(max_features=400, max_enlarged_features=100, enlarge_below_px=below, threads=1)
        extract_features(tmp_path / f"{name}.db", room, {"camera": ["0.png"]}, settings, silent)
        with pycolmap.Database.open(tmp_path / f"{name}.db") as opened:
            counts[name] = opened.num_keypoints()
    # COLMAP stops after the scale at which there are enough.
    assert 100 <= counts["enlarged"] < 300 < counts["as it is"]


def test_a_torn_walk_is_held_together_by_looking_again(room: Path, tmp_path: Path) -> None:
    result = estimate_poses(room, tmp_path / "scene", settings=POOR)
    assert (result.registered, result.warnings) == (8, ())

"""The geometric check of pairs: with fewer samples, and the same pairs count."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.geometric_check import check_pairs
from fsinfer.poses.matches import inliers_by_rank
from fsinfer.poses.pairs import MIN_INLIERS

pycolmap = pytest.importorskip("pycolmap")

#: Of each pair: matches, and how many of them are right.
PAIRS = [(15, 15), (17, 15), (18, 15), (20, 16), (21, 15), (24, 17), (25, 15), (29, 16), (30, 16), (60, 24), (200, 90)]
WRONG = [(15, 5), (18, 8), (21, 6), (25, 7), (29, 0), (40, 5), (100, 6)]
FOCAL = 500.0


def two_views(matches: int, right: int, rng: np.random.Generator) -> tuple[NDArray[Any], NDArray[Any]]:
    """Places in two photos of 640x480, 1 m apart and turned; the first ``right`` are of one point each."""
    points = np.column_stack([rng.uniform(-3, 3, matches), rng.uniform(-2, 2, matches), rng.uniform(4, 12, matches)])
    angle = 0.2
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    seen = [points, (points - [1.0, 0.1, 0.3]) @ turn.T]
    first, second = (FOCAL * p[:, :2] / p[:, 2:] + [320, 240] + rng.normal(0, 0.3, (matches, 2)) for p in seen)
    second[right:] = rng.uniform([0, 0], [640, 480], (matches - right, 2))
    return first, second


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """Pairs of photos, two of each of its own, with their matches."""
    rng = np.random.default_rng(5)
    path = tmp_path / "database.db"
    with open_database(path) as opened:
        camera = opened.write_camera(
            pycolmap.Camera(model="SIMPLE_RADIAL", width=640, height=480, params=[FOCAL, 320, 240, 0])
        )
        for rank, (matches, right) in enumerate(PAIRS + WRONG):
            numbers = []
            for name, places in zip("ab", two_views(matches, right, rng), strict=True):
                number = opened.write_image(pycolmap.Image(name=f"{rank:02d}{name}.jpg", camera_id=camera))
                opened.write_keypoints(number, places.astype(np.float32))
                none = np.zeros((matches, 128), dtype=np.uint8)
                opened.write_descriptors(
                    number, pycolmap.FeatureDescriptors(type=pycolmap.FeatureExtractorType.SIFT, data=none)
                )
                numbers.append(number)
            opened.write_matches(*numbers, np.column_stack([np.arange(matches)] * 2).astype(np.uint32))
    return path


def names() -> list[str]:
    return [f"{rank:02d}{which}.jpg" for rank in range(len(PAIRS + WRONG)) for which in "ab"]


def pairs() -> list[tuple[str, str]]:
    return [(f"{rank:02d}a.jpg", f"{rank:02d}b.jpg") for rank in range(len(PAIRS + WRONG))]


def counted(database: Path) -> dict[int, int]:
    """Of each pair that counts what agrees."""
    found = inliers_by_rank(database, names())
    return {first // 2: inliers for (first, _), inliers in found.items() if inliers >= MIN_INLIERS}


def reference(database: Path) -> dict[int, int]:
    """The same with all of COLMAP's samples for all pairs."""
    copy = database.parent / "reference" / "database.db"
    copy.parent.mkdir()
    shutil.copy(database, copy)
    listed = copy.parent / "pairs.txt"
    listed.write_text("".join(f"{first} {second}\n" for first, second in pairs()))
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 1
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    pycolmap.match_image_pairs(
        copy, pairing_options=pairing, verification_options=verification, device=pycolmap.Device.cpu
    )
    return counted(copy)


def test_the_same_pairs_count_as_with_all_samples(database: Path) -> None:
    expected = reference(database)
    assert set(range(len(PAIRS))) >= set(expected)
    assert len(expected) >= len(PAIRS) - 1
    check_pairs(database, pairs(), threads=2)
    found = counted(database)
    assert set(found) == set(expected)
    assert all(abs(found[pair] - expected[pair]) <= 2 for pair in found)


def test_samples_are_spared_where_few_matches_leave_little_to_be_wrong(
    database: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And never so many that a pair of just enough right matches is missed."""
    asked: list[tuple[int, float]] = []
    estimate = pycolmap.estimate_two_view_geometry

    def recorded(*arguments: Any) -> Any:
        matches, options = arguments[-2:]
        asked.append((len(matches), float(options.ransac.min_inlier_ratio)))
        return estimate(*arguments)

    monkeypatch.setattr(pycolmap, "estimate_two_view_geometry", recorded)
    check_pairs(database, pairs(), threads=1)
    assert [matches for matches, _ in asked] == [matches for matches, _ in PAIRS + WRONG]
    for matches, least in asked:
        assert max(0.25, 0.85 * MIN_INLIERS / matches) <= least <= max(0.25, MIN_INLIERS / matches)
    # A run that was stopped goes on where it was.
    check_pairs(database, pairs(), threads=1)
    assert len(asked) == len(PAIRS + WRONG)


def test_several_threads_find_what_one_finds(database: Path) -> None:
    copy = database.parent / "copy.db"
    shutil.copy(database, copy)
    check_pairs(database, pairs(), threads=1)
    check_pairs(copy, pairs(), threads=3)
    assert inliers_by_rank(database, names()) == inliers_by_rank(copy, names())


def test_a_pair_without_matches_is_none(database: Path) -> None:
    with open_database(database) as opened:
        numbers = [opened.read_image_with_name(name).image_id for name in ("00a.jpg", "01b.jpg")]
        opened.write_matches(*numbers, np.zeros((0, 2), dtype=np.uint32))
    check_pairs(database, [("00a.jpg", "01b.jpg")], threads=1)
    assert counted(database) == {}

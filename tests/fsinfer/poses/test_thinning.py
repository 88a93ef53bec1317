"""Fewer matches of a pair for the mapper, and the points of all of them afterwards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.poses.colmap import reconstruct
from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.pairs import MIN_INLIERS
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.thinning import add_points, thinned
from tests.support.pairs_of_walk import PHOTOS, POINTS, names, pairs_of_walk, pose

pytest.importorskip("pycolmap")

SETTINGS = PoseSettings(threads=1)
MOST = 60


def matches_of(database: Path) -> dict[tuple[int, int], set[tuple[int, int]]]:
    import pycolmap

    with open_database(database) as opened:
        return {
            pycolmap.pair_id_to_image_pair(pair_id): {(int(i), int(j)) for i, j in geometry.inlier_matches}
            for pair_id, geometry in zip(*opened.read_two_view_geometries(), strict=True)
        }


def mapped(database: Path, work: Path) -> Any:
    (work / "images").mkdir(exist_ok=True)
    (model,) = reconstruct(database, work / "images", work / "models", SETTINGS, lambda *_: None)
    return model


def test_no_pair_has_more_and_what_it_has_was_there(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", known=True, few={(0, 1): 40})
    before = matches_of(database)
    after = matches_of(thinned(database, MOST, tmp_path / "thinned.db"))
    assert matches_of(database) == before
    assert set(after) == set(before)
    assert all(found <= before[pair] for pair, found in after.items())
    assert all(len(found) == min(MOST, len(before[pair])) for pair, found in after.items())
    assert after[1, 2] == before[1, 2]


def keep_only(database: Path, pair: tuple[int, int], features: range) -> None:
    """Of a pair's matches those of these features of its first photo."""
    with open_database(database) as opened:
        geometry = opened.read_two_view_geometry(*pair)
        matches = np.asarray(geometry.inlier_matches)
        geometry.inlier_matches = matches[np.isin(matches[:, 0], features)]
        opened.delete_two_view_geometry(*pair)
        opened.write_two_view_geometry(*pair, geometry)


def test_features_of_weak_pairs_are_kept_first(tmp_path: Path) -> None:
    """A photo that hangs on the rest by few finds its place only by features that have a point."""
    database = pairs_of_walk(tmp_path / "pairs.db", known=True)
    weak, others = range(POINTS - 25, POINTS), range(POINTS - 25)
    keep_only(database, (1, 2), weak)
    # They are seen by fewer pairs than all others.
    for pair in ((1, 3), (1, 4), (2, 3), (2, 4), (2, 5)):
        keep_only(database, pair, others)
    told = {i for i, _ in matches_of(database)[1, 2]}
    kept = {i for i, _ in matches_of(thinned(database, MOST, tmp_path / "thinned.db"))[2, 6]}
    assert MIN_INLIERS <= len(told) <= MOST
    assert kept >= told & {i for i, _ in matches_of(database)[2, 6]}


def test_features_that_more_pairs_see_are_kept_before_others(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", known=True)
    half, rest = range(POINTS // 2, POINTS), range(POINTS // 2)
    for pair, features in (((2, 6), half), ((3, 6), half), ((4, 6), rest)):
        keep_only(database, pair, features)
    kept = matches_of(thinned(database, MOST, tmp_path / "thinned.db"))
    assert {i for i, _ in kept[5, 6]} <= set(half)


def test_a_map_of_fewer_gets_the_points_of_all_and_stays_where_it_is(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", known=True)
    model = mapped(thinned(database, MOST, tmp_path / "thinned.db"), tmp_path)
    assert model.num_reg_images() == PHOTOS
    # All pairs keep the same features, as far as noise lets them.
    fewer = model.num_points3D()
    assert fewer < 0.6 * POINTS
    poses = {i: model.images[i].cam_from_world().matrix().copy() for i in model.reg_image_ids()}
    came = add_points(model, database)
    assert 0.95 * POINTS < model.num_points3D() <= POINTS
    assert came >= model.num_points3D() - fewer
    assert all((model.images[i].cam_from_world().matrix() == poses[i]).all() for i in poses)
    # As exactly as a map of all: in shape, whatever its scale.
    centers = np.array([-pose(k)[0].T @ pose(k)[1] for k in range(PHOTOS)])
    found = np.array([model.images[names().index(name) + 1].projection_center() for name in names()])
    sides = [np.linalg.norm(np.diff(each, axis=0), axis=1) for each in (centers, found)]
    ratio = sides[1] / sides[0]
    assert np.abs(ratio / np.median(ratio) - 1).max() < 0.01


def test_only_the_photos_that_are_asked_for_get_points(tmp_path: Path) -> None:
    database = pairs_of_walk(tmp_path / "pairs.db", known=True)
    model = mapped(thinned(database, MOST, tmp_path / "thinned.db"), tmp_path)
    before = {i: model.images[i].num_points3D for i in model.reg_image_ids()}
    assert add_points(model, database, {3}) > 0
    grown = {i for i in before if model.images[i].num_points3D > before[i]}
    # Photo 3 and those that it has pairs with, four on and four back.
    assert 3 in grown
    assert grown <= {1, 2, 3, 4, 5, 6, 7}
    assert add_points(model, database, {99}) == 0

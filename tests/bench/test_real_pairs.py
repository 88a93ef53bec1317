"""Real pairs and photographs as judges, on a plane whose depth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.scene import read_scene
from tests.bench import judged, real_pairs
from tests.support.plane_scene import PLANE_DEPTH, write_plane_scene


def test_errors_are_pixels_of_the_other_photograph(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path))
    pairs = list(real_pairs.pairs_of(scene, 13.0))
    # The views stand in a row, a tenth of the depth apart: each has a neighbour.
    assert [(pair.view.name, pair.other.name) for pair in pairs] == [("0", "1"), ("1", "0"), ("2", "1")]
    assert pairs[0].percent == pytest.approx(10.0)
    assert list(real_pairs.pairs_of(scene, 9.0)) == []
    # Ten pixels of parallax: a depth that is a tenth too great moves by a tenth of 1 / 1.1 of them.
    found = np.full((108, 140), 1.1 * PLANE_DEPTH, np.float32)
    errors = real_pairs.errors_of(found, pairs[0])
    assert errors == pytest.approx(10 - 10 / 1.1, abs=1e-4)
    # Only what both show is judged: ten columns leave the picture.
    assert len(errors) == 108 * 130
    found[:, 70:] = 0
    assert np.isinf(real_pairs.errors_of(found, pairs[0])).mean() == pytest.approx(70 / 130)


def test_errors_know_the_grid_of_a_truth_at_half_size(tmp_path: Path) -> None:
    folder = write_plane_scene(tmp_path)
    for path in (folder / "depths").iterdir():
        write_pfm(path, np.ascontiguousarray(read_pfm(path)[::2, ::2]))
    pair = next(iter(real_pairs.pairs_of(read_scene(folder), 13.0)))
    found = np.full((108, 140), PLANE_DEPTH, np.float32)
    assert real_pairs.errors_of(found, pair).max() < 1e-3


def test_semi_global_matching_finds_the_plane(tmp_path: Path) -> None:
    pair = next(iter(real_pairs.pairs_of(read_scene(write_plane_scene(tmp_path, height=216, width=280)), 13.0)))
    errors = real_pairs.errors_of(real_pairs.semi_global(pair), pair)
    assert np.median(errors) < 0.1
    assert (errors < 1).mean() > 0.9


def test_judges_bear_out_the_right_depth(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path, views=4, height=216, width=280))
    right = np.full((108, 140), PLANE_DEPTH, np.float32)
    wrong = right.copy()
    wrong[30:80, 60:110] *= 1.2
    judges = [scene.views[1], scene.views[2]]
    said = judged.verdict(right, wrong, scene.views[0], judges)
    inside, outside = said[40:70, 70:100], said[:20]
    assert (inside == 1).mean() > 0.95
    assert not outside.any()
    other_way = judged.verdict(wrong, right, scene.views[0], judges)
    assert (other_way[40:70, 70:100] == -1).mean() > 0.95
    # Where there is no truth neither is borne out.
    hole = np.where(wrong > PLANE_DEPTH, np.float32(0), wrong)
    assert not judged.verdict(right, hole, scene.views[0], judges)[45:65, 75:95].any()


def test_what_is_like_the_judges_is_asked_of_the_best_two(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path, views=4, height=216, width=280))
    view, *others = scene.views
    depth = np.full((108, 140), PLANE_DEPTH, np.float32)
    torn = replace(others[2], camera=replace(others[2].camera, cam_from_world=np.eye(4)))
    middle = judged.likeness(depth, view, [*others[:2], torn])[20:90, 20:100]
    assert middle.min() > 0.95
    assert judged.likeness(depth, view, [others[0], torn])[20:90, 20:100].mean() < 0.8


def figures_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, float]:
    judged.main([str(folder)])
    return {name: float(value) for name, value in map(str.split, capsys.readouterr().out.splitlines())}


def test_the_command_counts_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_plane_scene(tmp_path, views=7, height=144, width=192)
    before = figures_told(folder, capsys)
    path = folder / "depths" / "3.pfm"
    truth = read_pfm(path)
    truth[40:100, 60:120] *= 1.3
    write_pfm(path, truth)
    told = figures_told(folder, capsys)
    assert told["views"] == 7
    share = 100 * 60 * 60 / told["pixels"]
    more = {name: told[name] - before[name] for name in told}
    assert more["wrong_unconfirmed_percent"] == pytest.approx(share, rel=0.02)
    assert more["wrong_unconfirmed_ours_percent"] > 0.8 * share
    assert more["wrong_unconfirmed_truth_percent"] == pytest.approx(0, abs=1e-6)
    assert more["wrong_confirmed_percent"] == pytest.approx(0, abs=0.02)

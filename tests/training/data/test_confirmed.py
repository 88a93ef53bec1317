"""True depth counts where the true maps of neighbours say the same."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.scene import read_scene
from tests.bench import depth
from tests.support.plane_scene import PLANE_DEPTH, write_plane_scene
from training import evaluate
from training.data.confirmed import ConfirmedTruth, agree
from training.data.true_scene import DepthsFolder

#: Rows and columns of what is wrong in the first view's true map: in the middle, where both neighbours look.
WRONG = (slice(20, 32), slice(40, 64))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three views of a plane; the first one's truth is a fiftieth too far in its middle."""
    scene = write_plane_scene(tmp_path / "scene", height=64, width=96)
    depth = read_pfm(scene / "depths" / "0.pfm")
    depth[WRONG] *= 1.02
    write_pfm(scene / "depths" / "0.pfm", depth)
    return scene


@pytest.mark.parametrize("reduced", [1, 4])
def test_what_neighbours_do_not_confirm_is_unknown(folder: Path, reduced: int) -> None:
    for path in (folder / "depths").iterdir():
        write_pfm(path, np.ascontiguousarray(read_pfm(path)[reduced // 2 :: reduced, reduced // 2 :: reduced]))
    truth = DepthsFolder(folder=folder)
    view = read_scene(folder).views[0]
    for votes in (1, 2):
        found = ConfirmedTruth(scene=truth, votes=votes).true_depth(view)
        assert found is not None
        wrong = np.zeros((64, 96), bool)
        wrong[WRONG] = True
        wrong = wrong[::reduced, ::reduced]
        # The views lie 10 pixels apart: so many columns on the left one neighbour or both do not see.
        first = np.arange(0, 96, reduced)
        seen, unseen = first >= 10 * votes, first + reduced <= 10 * votes
        assert (found[wrong] == 0).all()
        assert (found[~wrong & seen] == np.float32(PLANE_DEPTH)).all()
        assert (found[:, unseen] == 0).all()


def test_a_view_without_a_map_confirms_nothing(folder: Path) -> None:
    (folder / "depths" / "2.pfm").unlink()
    scene = read_scene(folder)
    assert ConfirmedTruth(scene=DepthsFolder(folder=folder), votes=1).true_depth(scene.views[2]) is None
    found = ConfirmedTruth(scene=DepthsFolder(folder=folder), votes=2).true_depth(scene.views[0])
    assert found is not None
    assert not found.any()


def test_places_behind_the_other_view_do_not_agree(folder: Path) -> None:
    first, second, _ = read_scene(folder).views
    depth = np.full((64, 96), PLANE_DEPTH, np.float32)
    assert agree(depth, first, depth, second)[:, 10:].all()
    turned = second.camera.cam_from_world
    turned[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    assert not agree(depth, first, depth, second).any()


def test_the_evaluation_asks_for_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reports = []
    for options in ([], ["--confirmed", "2"]):
        assert evaluate.main([str(folder), "--subpixel-rounds", "0", "--json", *options]) == 0
        reports.append(json.loads(capsys.readouterr().out))
    wrong = (WRONG[0].stop - WRONG[0].start) * (WRONG[1].stop - WRONG[1].start)
    pixels = [[report["views"][f"scene/{i}"]["pixels"] for i in range(3)] for report in reports]
    # The middle view sees ten columns less with each of the others, and where the first one's truth is wrong it has one
    # vote alone; so has the third.
    assert pixels == [[64 * 96] * 3, [64 * (96 - 20) - wrong] * 3]
    assert "confirmed" not in reports[0]
    assert reports[1]["confirmed"] == pytest.approx(sum(pixels[1]) / (3 * 64 * 96))
    assert depth.figures_of(reports[1], None)["confirmed_percent"] == pytest.approx(100 * reports[1]["confirmed"])

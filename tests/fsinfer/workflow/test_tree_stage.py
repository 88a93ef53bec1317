"""Markers' posts are no trees, unless the stem behind the marker measures well."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from fsinfer.io.cloud import PointCloud
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import is_remark
from fsinfer.notices.stems import StemCode
from fsinfer.scale.scale import UNKNOWN, marker_centers
from fsinfer.trees import analyse_plot
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.edit_rows import TreeEdit
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.plot_doubt import all_doubtful
from fsinfer.trees.posts import without_posts
from fsinfer.workflow import tree_stage
from fsinfer.workflow.tree_stage import PlotCloudInput, TreeStageSettings, measure_plot
from tests.support.boards import board, scale_of_boards
from tests.support.stem_clouds import stem_plot


def test_markers_are_placed_in_the_cloud() -> None:
    similarity = np.eye(4)
    similarity[:3] *= 2.0
    similarity[:3, 3] = [1, 0, -1]
    scale = scale_of_boards([board(1, (1.0, 2.0, 3.0), "abc"), board(2, (0.0, 0.0, 0.0), "abc")])
    np.testing.assert_allclose(marker_centers(scale, similarity), [[3, 4, 5], [1, 0, -1]])
    assert marker_centers(UNKNOWN, similarity).shape == (0, 3)


def test_a_doubtful_stem_at_a_marker_is_taken_for_its_post() -> None:
    plot = stem_plot(trees=4, seed=3)
    result = analyse_plot(plot.points)
    assert len(result.trees) >= 3
    doubt = notice(StemCode.edges_alone, photos=5, refused=notice(StemCode.not_round))
    doubtful = replace(
        result.trees[0],
        status="doubtful",
        reasons=(doubt,),
    )
    sound = replace(result.trees[1], status="ok", reasons=())
    unmeasured = replace(result.trees[2], status="unmeasured", dbh_cm=None)
    changed = replace(result, trees=(doubtful, sound, unmeasured, *result.trees[3:]))
    markers = np.array([[t.x_m + 0.1, t.y_m, 1.0] for t in (doubtful, sound)])
    kept = without_posts(changed, markers)
    assert [t.tree_id for t in kept.trees] == [t.tree_id for t in changed.trees[1:]]
    assert kept.sections == changed.sections[1:]
    assert [given.code for given in kept.warnings] == [StemCode.post_of_marker]
    assert is_remark(kept.warnings[0])
    assert without_posts(changed, np.empty((0, 3))).trees == changed.trees


def test_a_post_that_was_deleted_by_hand_may_be_known_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plot = stem_plot(trees=4, seed=3)
    result = analyse_plot(plot.points)
    posts = replace(result, trees=(replace(result.trees[0], status="doubtful"), *result.trees[1:]))
    monkeypatch.setattr(tree_stage, "analyse_plot", lambda *_, **__: posts)
    post, other = posts.trees[0], posts.trees[1]
    edits = [TreeEdit(action="delete", row=row, tree_id=n) for row, n in ((2, post.tree_id), (3, other.tree_id))]
    given = PlotCloudInput(
        cloud=PointCloud(xyz=plot.points), edits=edits, marker_xyz=np.array([[post.x_m, post.y_m, 1.0]])
    )
    assert measure_plot(given, tmp_path).trees == len(result.trees) - 2
    numbers = [row.tree_id for row in read_trees(tmp_path / "trees.csv")]
    assert numbers == [tree.tree_id for tree in posts.trees[2:]]


def test_what_speaks_against_all_stems_leaves_none_that_is_ok(tmp_path: Path) -> None:
    plot = stem_plot(trees=4, seed=3)
    doubt = notice(StemCode.boards_elsewhere, boards="21, 22", apart_m=4.2)
    rows = []
    for name, why in (("sure", None), ("doubted", doubt)):
        measure_plot(PlotCloudInput(cloud=PointCloud(xyz=plot.points), doubt=why), tmp_path / name)
        with (tmp_path / name / "trees.csv").open(encoding="utf-8") as text:
            rows.append(list(csv.DictReader(text)))
    sure, doubted = rows
    assert [row["dbh_cm"] for row in doubted] == [row["dbh_cm"] for row in sure]
    assert "ok" in {row["status"] for row in sure}
    for before, after in zip(sure, doubted, strict=True):
        if before["dbh_cm"]:
            assert after["status"] == "doubtful"
            assert "boards 21, 22 stand at two places each, up to 4.2 m apart" in after["reason"]
        else:
            assert after == before


def test_stems_of_joined_parts_are_doubtful_too() -> None:
    result = analyse_plot(stem_plot(trees=4, seed=3).points)
    measured = next(tree for tree in result.trees if tree.dbh_cm is not None)
    bare = replace(measured, dbh_cm=None, status="unmeasured", reasons=())
    joined = (replace(measured, tree_id=90, part="part-2"), replace(bare, tree_id=91, part="part-2"))
    doubt = notice(StemCode.boards_elsewhere, boards="21, 22", apart_m=4.2)
    found = all_doubtful(replace(result, joined=joined), doubt)
    assert found.joined[0].status == "doubtful"
    assert found.joined[0].reasons[-1] == doubt
    assert found.joined[1] == joined[1]
    assert {section.status for section in found.sections if section.dbh_m is not None} == {"doubtful"}


@pytest.mark.parametrize("with_photos", [True, False])
def test_two_walls_of_a_cloud_of_photographs_are_refused(
    with_photos: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []

    def measured(_given: Any, _out: Path, settings: TreeStageSettings, _progress: Any) -> None:
        asked.append(settings.trees.dbh.most_walls_m)

    monkeypatch.setattr("fsinfer.workflow.tree_stage._measure_plot", measured)
    cloud = PointCloud(xyz=np.zeros((1, 3)))
    measure_plot(PlotCloudInput(cloud=cloud, photos=cast(Any, object()) if with_photos else None), tmp_path)
    assert asked == [0.0 if with_photos else DbhSettings().most_walls_m]


@pytest.mark.parametrize(("camera_height", "told"), [(None, True), (1.5, False), (4.9, True)])
def test_thick_stems_are_of_another_unit_unless_cameras_vouch_for_the_metre(
    camera_height: float | None, told: bool, tmp_path: Path
) -> None:
    """Veteran trees that were photographed are thick; a phone is not held at 4.9 m, which are 1.5 m in feet."""
    plot = stem_plot(trees=5, seed=5, spacing_m=0.03, dbh_cm=(80.0, 110.0))
    given = PlotCloudInput(cloud=PointCloud(xyz=plot.points), camera_height=camera_height)
    warnings = measure_plot(given, tmp_path).warnings
    assert (StemCode.all_thick in [warning.code for warning in warnings]) == told

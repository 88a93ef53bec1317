"""A part that was measured apart comes into the plot's tables, maps, figures and area by the pattern of its stems."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import InputError
from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.io.images import read_image
from fsinfer.notices.stems import StemCode
from fsinfer.output.json_values import as_json, of_json
from fsinfer.output.plot_json import write_plot
from fsinfer.plot_border.request import BorderRequest
from fsinfer.scene import write_camera, write_pairs
from fsinfer.silhouettes.walk import WalkSettings
from fsinfer.trees.edit_rows import TreeEdit
from fsinfer.trees.outputs.table import read_trees
from fsinfer.workflow.joined_parts import digests_of
from fsinfer.workflow.tree_stage import PlotCloudInput, TreeStageSettings, measure_plot
from fsinfer.workflow.trees_result import TreesResult
from tests.support.stem_clouds import StemPlot, stem_plot
from tests.support.walked_plot import UNIT, make_plot
from tests.support.workbook import read_sheets

#: The rest holds x up to the one, the part from the other on; between them stand stems that both have.
_REST_TO_M, _PART_FROM_M = 8.9, 4.5
_TURN_DEG = 100.0


def turned(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """In the frame of the part."""
    cos, sin = np.cos(np.radians(_TURN_DEG)), np.sin(np.radians(_TURN_DEG))
    xy = points[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + [3.0, -5.0]
    return np.column_stack([xy, points[:, 2] + 1.0])


@pytest.fixture(scope="module")
def plot() -> StemPlot:
    return stem_plot(seed=21, trees=25, spacing_m=0.02, sigma_m=0.002, slope=0.05, dbh_cm=(14.0, 40.0))


@pytest.fixture(scope="module")
def torn(plot: StemPlot, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TreesResult]:
    """The rest measured with its part beside it, in ``part-2``."""
    out = tmp_path_factory.mktemp("torn")
    folder = out / "part-2"
    folder.mkdir()
    points = plot.points
    cloud = PointCloud(xyz=turned(points[points[:, 0] > _PART_FROM_M]))
    write_cloud(folder / "cloud.ply", cloud)
    write_plot(folder, {"units": "m"})
    measure_plot(PlotCloudInput(cloud=cloud), folder)
    return out, measure_plot(given(plot, folder), out, settings=settings())


def given(plot: StemPlot, *parts: Path) -> PlotCloudInput:
    return PlotCloudInput(cloud=PointCloud(xyz=plot.points[plot.points[:, 0] < _REST_TO_M]), parts=parts)


def settings() -> TreeStageSettings:
    return TreeStageSettings(border=BorderRequest(radius_m=5.0, center=(5.5, 5.5)))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_all_stems_stand_in_the_table_once_and_where_they_are(plot: StemPlot, torn: tuple[Path, TreesResult]) -> None:
    out, result = torn
    trees = read_trees(out / "trees.csv")
    assert len(trees) == len(plot.xy) == result.trees == result.trees_with_dbh
    assert len({tree.tree_id for tree in trees}) == len(trees)
    places = np.array([[tree.x_m, tree.y_m] for tree in trees])
    apart = np.hypot(*(places[:, None] - plot.xy[None]).transpose(2, 0, 1))
    nearest = apart.argmin(axis=1)
    assert sorted(nearest) == list(range(len(plot.xy)))
    assert apart.min(axis=1).max() < 0.03
    found_cm = np.array([tree.dbh_cm for tree in trees], np.float64)
    np.testing.assert_allclose(found_cm, plot.dbh_cm[nearest], atol=0.6)
    np.testing.assert_allclose([tree.z_ground_m for tree in trees], plot.z_ground[nearest], atol=0.06)
    # What stands beyond the rest was measured in the part.
    beyond = plot.xy[nearest, 0] > _REST_TO_M + 0.3
    assert beyond.sum() >= 4
    assert all(tree.part == "part-2" for tree, far in zip(trees, beyond, strict=True) if far)


def test_a_tree_that_was_taken_out_by_hand_does_not_come_back_by_a_part_that_saw_it(
    plot: StemPlot, torn: tuple[Path, TreesResult], tmp_path: Path
) -> None:
    both = next(tree for tree in read_trees(torn[0] / "trees.csv") if _PART_FROM_M + 1.0 < tree.x_m < _REST_TO_M - 1.0)
    deleted = TreeEdit(action="delete", row=2, tree_id=both.tree_id)
    folder = torn[0] / "part-2"
    measure_plot(replace(given(plot, folder), edits=(deleted,)), tmp_path, settings=settings())
    left = read_trees(tmp_path / "trees.csv")
    assert len(left) == len(plot.xy) - 1
    assert min(np.hypot(tree.x_m - both.x_m, tree.y_m - both.y_m) for tree in left) > 0.5


def test_a_tree_of_a_part_alone_is_corrected_there(
    plot: StemPlot, torn: tuple[Path, TreesResult], tmp_path: Path
) -> None:
    trees = read_trees(torn[0] / "trees.csv")
    (last,) = (tree for tree in trees if tree.tree_id == max(other.tree_id for other in trees))
    assert last.part == "part-2"
    deleted = TreeEdit(action="delete", row=2, tree_id=last.tree_id)
    with pytest.raises(InputError, match=r"is corrected in part-2/edits\.csv, by the number it has there"):
        measure_plot(replace(given(plot, torn[0] / "part-2"), edits=(deleted,)), tmp_path, settings=settings())


def test_stand_plot_and_words_count_them(plot: StemPlot, torn: tuple[Path, TreesResult]) -> None:
    out, result = torn
    (part,) = result.joined
    assert (part.name, part.common + part.new) == ("part-2", len(read_trees(out / "part-2" / "trees.csv")))
    assert (part.common, part.new) >= (4, 4)
    assert part.apart_m < 0.03
    assert [told.code for told in result.warnings].count(StemCode.part_joined) == 1
    assert result.diagnosis.values == {"trees": 25, "measured": 25}
    # The whole ground is 13 m square; the rest alone saw 9.9 m of it.
    assert result.plot_area_m2 == pytest.approx(13.0**2, rel=0.02)
    assert result.plot is not None
    assert result.plot.seen_share > 0.99
    inside = np.hypot(*(plot.xy - 5.5).T) < 5.0
    assert result.plot.stems == int(inside.sum())
    # The ledger reads results back from JSON.
    assert as_json(of_json(TreesResult, json.loads(json.dumps(as_json(result))))) == as_json(result)


def copied_part(out: Path, target: Path) -> Path:
    """What the part of a torn plot tells of its stems and cloud, in another folder."""
    folder = target / "part-2"
    folder.mkdir()
    for name in ("trees.csv", "trees.json", "cloud.ply"):
        (folder / name).write_bytes((out / "part-2" / name).read_bytes())
    return folder


def test_ground_outside_of_the_walk_of_a_part_is_not_counted(
    plot: StemPlot, torn: tuple[Path, TreesResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda *_, **__: None)
    folder = copied_part(torn[0], tmp_path)
    scene, _ = make_plot(folder / "scene", {})
    for view in scene.views:
        write_camera(folder / "scene" / "cams" / f"{view.name}_cam.txt", view.camera)
    write_pairs(folder / "scene" / "pair.txt", {number: [] for number in range(len(scene.views))})
    # The photographs of the part were taken within half a metre of one place, and reach 3 m.
    middle = turned(np.array([[11.0, 6.0, 0.0]]))[0]
    place = np.diag([0.1 * UNIT, 0.1 * UNIT, 0.1 * UNIT, 1.0])
    place[:3, 3] = middle
    write_plot(folder, {"units": "m", "cloud_from_scene": place.tolist()})
    stage = replace(settings(), walk=WalkSettings(near_m=3.0))
    result = measure_plot(given(plot, folder), tmp_path, settings=stage)
    assert result.trees == torn[1].trees
    # The rest saw 9.9 m of 13; of the part's ground beyond it some 3 m are left along 6 to 7 m.
    assert result.plot_area_m2 is not None
    assert torn[1].plot_area_m2 is not None
    assert 9.9 * 13.0 + 17.0 < result.plot_area_m2 < 9.9 * 13.0 + 24.0 < torn[1].plot_area_m2 - 15.0
    # What is seen of a plot with a border is for the lines of sight to tell.
    assert result.plot is not None
    assert torn[1].plot is not None
    assert result.plot.seen_share == torn[1].plot.seen_share


def test_tables_maps_and_figures_hold_them(torn: tuple[Path, TreesResult]) -> None:
    out, result = torn
    table = rows(out / "trees.csv")
    joined = [row for row in table if row["part"]]
    assert joined
    sheet = next(sheet for sheet in read_sheets(out / "trees.xlsx") if sheet.name == "trees")
    assert [cells[0] for cells in sheet.rows()[1:]] == [int(row["tree_id"]) for row in table]
    reasons = json.loads((out / "trees.json").read_text(encoding="utf-8"))
    assert [entry["tree_id"] for entry in reasons] == [int(row["tree_id"]) for row in table]
    for row in table:
        assert (out / "figures" / f"tree_{int(row['tree_id']):03d}.png").is_file()
    # The figure of a joined stem is that of its part, whatever its number there, below a line with its number here.
    of_part = [read_image(path) for path in (out / "part-2" / "figures").glob("tree_*.png")]
    for row in joined:
        figure = read_image(out / "figures" / f"tree_{int(row['tree_id']):03d}.png")
        (same,) = [own for own in of_part if np.array_equal(own, figure[-len(own) :])]
        line = figure[: len(figure) - len(same)]
        assert len(line) > 20
        assert (line < 100).all(axis=-1).sum() > 300
    assert result.trees_with_silhouette == 0


@pytest.mark.parametrize("damage", ["no metres", "no table", "not told"])
def test_a_part_that_does_not_tell_its_place_stays_apart(
    plot: StemPlot, torn: tuple[Path, TreesResult], tmp_path: Path, damage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda *_, **__: None)
    folder = copied_part(torn[0], tmp_path)
    units: dict[str, Any] = {"units": "model units" if damage == "no metres" else "m"}
    write_plot(folder, units)
    if damage == "no table":
        (folder / "trees.csv").unlink()
    stage = settings()
    if damage == "not told":
        stage = replace(stage, pattern=replace(stage.pattern, by_chance=0.0))
    alone = measure_plot(given(plot), tmp_path / "alone", settings=stage)
    result = measure_plot(given(plot, folder), tmp_path, settings=stage)
    assert result == alone
    assert result.joined == ()


def test_other_stems_in_a_part_are_another_input(torn: tuple[Path, TreesResult], tmp_path: Path) -> None:
    """The stage is done again when a part was measured again."""
    before = digests_of([torn[0] / "part-2"])
    table = (torn[0] / "part-2" / "trees.csv").read_text(encoding="utf-8")
    (tmp_path / "trees.csv").write_text(table.replace("ok", "doubtful", 1), encoding="utf-8")
    assert digests_of([tmp_path]) != before
    assert digests_of([torn[0] / "part-2"]) == before
    assert digests_of([tmp_path / "gone"]) == []

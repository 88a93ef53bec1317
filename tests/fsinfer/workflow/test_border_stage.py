"""The border through the tree stage: tables, figures, plot.json and what is said where it cannot be placed."""

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
from fsinfer.io.cloud import write_cloud
from fsinfer.notices.plots import PlotCode
from fsinfer.output.json_values import as_json, of_json
from fsinfer.output.plot_json import read_plot
from fsinfer.plot_border.hectare import UPRIGHT
from fsinfer.plot_border.request import BorderRequest
from fsinfer.scale.request import ScaleRequest
from fsinfer.scene import read_scene
from fsinfer.silhouettes.join import StemPhotos
from fsinfer.workflow.measure_cloud import MeasureSettings, measure_cloud_file
from fsinfer.workflow.tree_stage import PlotCloudInput, TreeStageSettings, measure_plot
from fsinfer.workflow.trees_result import TreesResult
from tests.support.report_plot import CLOUD_FROM_SCENE, plot_cloud
from tests.support.synthetic_plot import STEMS, write_depth_folder, write_scene_folder
from tests.support.workbook import read_sheets

# The second stem of STEMS stands 1.35 m from the middle, the third 1.42 m: between them, and before the third's bark.
RADIUS_M = 1.38


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> PlotCloudInput:
    folder = tmp_path_factory.mktemp("walked")
    write_scene_folder(folder / "scene")
    scene = read_scene(folder / "scene")
    write_depth_folder(scene, folder)
    photos = StemPhotos(scene=scene, depth_folder=folder, cloud_from_scene=CLOUD_FROM_SCENE)
    return PlotCloudInput(cloud=plot_cloud(points_per_stem=12_000, ground=30_000), photos=photos)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The borders that figures were drawn with; drawing takes most of the time."""
    borders: list[Any] = []
    monkeypatch.setattr(
        "fsinfer.trees.outputs.figures.write_figures", lambda *_, border=None, **__: borders.append(border)
    )
    return borders


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "trees.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def with_border(**border: Any) -> TreeStageSettings:
    return TreeStageSettings(border=BorderRequest(**border))


def test_tables_figures_and_maps_know_the_border(
    given: PlotCloudInput, tmp_path: Path, drawn: list[NDArray[np.float64]]
) -> None:
    result = measure_plot(given, tmp_path, settings=with_border(radius_m=RADIUS_M))
    inside_m = {float(row["border_m"]): (row["in_plot"], row["at_border"]) for row in rows(tmp_path)}
    expected = RADIUS_M - np.hypot(*STEMS[:, :2].T)
    assert sorted(inside_m) == pytest.approx(sorted(expected), abs=0.01)
    assert [inside_m[key] for key in sorted(inside_m)] == [("0", "1"), ("1", "1"), ("1", "0")]
    assert result.plot is not None
    assert (result.plot.stems, result.plot.outside, result.plot.seen_share) == (2, 1, 1.0)
    assert result.plot.stems_per_ha is not None
    slope = np.tan(np.radians(result.plot.slope_deg))  # of noise
    up = 1.96 * np.radians(0.7) * slope * result.plot.stems_per_ha.value
    assert result.plot.stems_per_ha.parts[UPRIGHT] == pytest.approx(up, rel=1e-3)
    assert up > 0.0
    assert [told.code for told in result.warnings] == [PlotCode.border_cases]
    assert result.stand is not None
    assert result.stand.stems == 3  # of the seen ground, as without a border
    (outline,) = drawn
    np.testing.assert_allclose(np.hypot(*outline.T), RADIUS_M, atol=1e-6)
    assert [sheet.name for sheet in read_sheets(tmp_path / "trees.xlsx")][2] == "plot"
    # The ledger reads results back from JSON.
    assert of_json(TreesResult, json.loads(json.dumps(as_json(result)))) == result


def test_a_border_round_a_marker(given: PlotCloudInput, tmp_path: Path, drawn: list[object]) -> None:
    near_third = np.array([[9.0, 9.0, 1.0], [STEMS[2, 0], STEMS[2, 1] + 0.5, 1.6]])
    marked = replace(given, marker_xyz=near_third, marker_numbers=(3, 7))
    result = measure_plot(marked, tmp_path, settings=with_border(radius_m=1.0, marker=7))
    assert result.plot is not None
    assert result.plot.center == pytest.approx(tuple(near_third[1, :2]))
    assert [row["in_plot"] for row in rows(tmp_path)].count("1") == 1
    missing = measure_plot(marked, tmp_path, settings=with_border(radius_m=1.0, marker=8))
    assert missing.plot is None
    assert [told.code for told in missing.warnings] == [PlotCode.border_not_placed]
    assert {row["in_plot"] for row in rows(tmp_path)} == {""}
    assert len(rows(tmp_path)) == 3


def test_without_metres_there_is_no_border(given: PlotCloudInput, tmp_path: Path, drawn: list[object]) -> None:
    units = replace(given, metric=False, camera_height=1.5)
    result = measure_plot(units, tmp_path, settings=with_border(radius_m=RADIUS_M))
    assert result.plot is None
    assert PlotCode.border_not_placed in [told.code for told in result.warnings]
    assert drawn == [None]


def test_a_cloud_of_another_origin(given: PlotCloudInput, tmp_path: Path, drawn: list[object]) -> None:
    path = tmp_path / "scan.ply"
    write_cloud(path, given.cloud)
    out = tmp_path / "out"
    for border, words in ((BorderRequest(radius_m=2.0), "middle of the walk"), (
        BorderRequest(radius_m=2.0, marker=7), "marker 7")):  # fmt: skip
        settings = MeasureSettings(stage=TreeStageSettings(border=border))
        with pytest.raises(InputError, match=f"where the {words}|where {words}"):
            measure_cloud_file(path, out, request=ScaleRequest(), settings=settings)
    assert not out.exists()
    corners = ((-2.0, -2.0), (0.0, -2.0), (0.0, 2.0), (-2.0, 2.0))
    polygon = MeasureSettings(stage=TreeStageSettings(border=BorderRequest(polygon=corners)))
    first = measure_cloud_file(path, out, request=ScaleRequest(), settings=polygon)
    assert first.ran
    plot = read_plot(out)
    assert plot["per_hectare_of"] == "the plot within its border"
    assert (plot["plot_border"]["stems"], plot["plot_border"]["area_m2"]) == (1, 8.0)
    assert "photos" not in plot["plot_border"]["seen_method"]
    # Its z is what its owner says.
    assert plot["plot_border"]["stems_per_ha"]["parts"][UPRIGHT] == 0.0
    # The same again is done already; without the border it is another measurement.
    assert not measure_cloud_file(path, out, request=ScaleRequest(), settings=polygon).ran
    assert measure_cloud_file(path, out, request=ScaleRequest()).ran
    plot = read_plot(out)
    assert (plot["per_hectare_of"], plot["plot_border"]) == ("seen ground only", None)

"""Maps for a GIS, labelled points and the stand table: what other programs read of a plot."""

from __future__ import annotations

import json
import sqlite3
import struct
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.cloud import PointCloud, read_cloud
from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.output.layout import METRIC_TREE_FILES
from fsinfer.trees import PlotResult, analyse_plot, stand_table
from fsinfer.trees.outputs.labels import label_points
from fsinfer.trees.outputs.maps import write_maps
from fsinfer.trees.stand import AREA_METHOD, NO_AREA, SeenCells
from fsinfer.workflow.tree_stage import PlotCloudInput, measure_plot, no_trees
from tests.support.stem_clouds import StemPlot, stem_plot


@pytest.fixture(scope="module")
def plot() -> StemPlot:
    return stem_plot(seed=8, trees=4, spacing_m=0.02, sigma_m=0.004)


@pytest.fixture(scope="module")
def result(plot: StemPlot) -> PlotResult:
    return analyse_plot(plot.points)


def test_geopackage_holds_every_tree_in_a_local_frame(tmp_path: Path, result: PlotResult) -> None:
    why = (notice(StemCode.as_written, text="for the test, with a comma"),)
    unmeasured = replace(result.trees[0], tree_id=9, dbh_cm=None, reasons=why)
    paths = write_maps(tmp_path, [*result.trees, unmeasured])
    assert [path.name for path in paths] == ["trees.gpkg"]
    with closing(sqlite3.connect(paths[0])) as base:
        assert base.execute("PRAGMA application_id").fetchone() == (0x47504B47,)
        assert base.execute("PRAGMA foreign_key_check").fetchall() == []
        assert base.execute("SELECT srs_id, geometry_type_name FROM gpkg_geometry_columns").fetchone() == (-1, "POINT")
        rows = base.execute("SELECT tree_id, dbh_cm, reason, geom FROM trees ORDER BY fid").fetchall()
    assert len(rows) == 5
    assert rows[-1][:3] == (9, None, "for the test, with a comma")
    for tree, (tree_id, dbh_cm, _, blob) in zip(result.trees, rows, strict=False):
        assert (tree_id, dbh_cm) == (tree.tree_id, tree.dbh_cm)
        assert blob[:8] == b"GP\x00\x01" + struct.pack("<i", -1)
        assert struct.unpack("<BIdd", blob[8:]) == (1, 1, tree.x_m, tree.y_m)


def test_geojson_only_where_longitude_and_latitude_are_known(
    tmp_path: Path, result: PlotResult, caplog: pytest.LogCaptureFixture
) -> None:
    at_utm = [replace(tree, x_m=tree.x_m + 691_600.0, y_m=tree.y_m + 5_334_700.0) for tree in result.trees]
    write_maps(tmp_path, at_utm, epsg=32632)
    features = json.loads((tmp_path / "trees.geojson").read_text(encoding="utf-8"))["features"]
    assert len(features) == 4
    longitude, latitude = features[0]["geometry"]["coordinates"]
    assert (longitude, latitude) == (pytest.approx(11.577, abs=0.01), pytest.approx(48.137, abs=0.01))
    # A frame that nobody knows takes the old GeoJSON away instead of leaving a wrong one.
    with caplog.at_level("WARNING"):
        assert [p.name for p in write_maps(tmp_path, at_utm, epsg=99999)] == ["trees.gpkg"]
    assert not (tmp_path / "trees.geojson").exists()
    assert "EPSG:99999" in caplog.text


def test_etrs89_gets_a_geojson_where_pyproj_is(
    tmp_path: Path, result: PlotResult, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    at_utm = [replace(tree, x_m=tree.x_m + 691_600.0, y_m=tree.y_m + 5_334_700.0) for tree in result.trees]
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with caplog.at_level("WARNING"):
        assert [p.name for p in write_maps(tmp_path, at_utm, epsg=25832)] == ["trees.gpkg"]
    assert "pip install 'fsinfer[gis]'" in caplog.text
    monkeypatch.undo()
    pytest.importorskip("pyproj")
    assert [p.name for p in write_maps(tmp_path, at_utm, epsg=25832)] == ["trees.gpkg", "trees.geojson"]
    etrs89 = json.loads((tmp_path / "trees.geojson").read_text(encoding="utf-8"))["features"]
    write_maps(tmp_path, at_utm, epsg=32632)
    wgs84 = json.loads((tmp_path / "trees.geojson").read_text(encoding="utf-8"))["features"]
    # The two ellipsoids differ by a tenth of a millimetre.
    for one, other in zip(etrs89, wgs84, strict=True):
        assert one["geometry"]["coordinates"] == pytest.approx(other["geometry"]["coordinates"], abs=2e-8)
        assert one["properties"] == other["properties"]


def test_labels_follow_the_stems_and_nothing_else(plot: StemPlot, result: PlotResult) -> None:
    labels = label_points(plot.points, result)
    assert labels.dtype == np.int32
    assert set(np.unique(labels)) == {0, 1, 2, 3, 4}
    for tree in result.trees:
        own = plot.points[labels == tree.tree_id]
        assert tree.dbh_cm is not None
        away = np.hypot(own[:, 0] - tree.x_m, own[:, 1] - tree.y_m)
        assert away.max() < 0.5 * tree.dbh_cm / 100.0 + 0.25
        assert len(own) > 1000
    # The ground between the stems belongs to nobody.
    far = np.min([np.hypot(plot.points[:, 0] - t.x_m, plot.points[:, 1] - t.y_m) for t in result.trees], axis=0) > 0.6
    assert (labels[far] == 0).all()


def test_outputs_are_written_and_taken_away_again(tmp_path: Path, plot: StemPlot) -> None:
    values = measure_plot(PlotCloudInput(cloud=PointCloud(xyz=plot.points)), tmp_path)
    assert values.stand is not None
    assert values.stand.stems == 4
    assert values.plot_area_m2 is not None
    assert values.plot_area_m2 > 10.0
    labelled = read_cloud(tmp_path / "trees.laz")
    assert len(labelled) == len(plot.points)
    assert set(np.unique(labelled.extra["TreeID"])) == {0, 1, 2, 3, 4}
    no_trees(tmp_path, reason=notice(StemCode.nothing_measured, error="for the test"))
    assert not any((tmp_path / name).exists() for name in METRIC_TREE_FILES)


def test_without_a_scale_there_are_no_maps(tmp_path: Path, plot: StemPlot) -> None:
    values = measure_plot(PlotCloudInput(cloud=PointCloud(xyz=plot.points), metric=False), tmp_path)
    assert values.trees == 4
    assert values.plot_area_m2 is None
    assert not any((tmp_path / name).exists() for name in METRIC_TREE_FILES)


def test_stand_table(result: PlotResult) -> None:
    stand = stand_table([replace(result.trees[0], dbh_cm=30.0), replace(result.trees[1], dbh_cm=None)], 500.0)
    assert stand.stems_per_ha == pytest.approx(40.0)
    assert stand.basal_area_m2_per_ha is None  # one stem is no mean for the other
    three = stand_table([replace(result.trees[0], dbh_cm=d) for d in (30.0, 40.0, None)], 500.0)
    assert three.basal_area_m2_per_ha == pytest.approx(np.pi / 4 * (0.09 + 0.16) * 1.5 * 20.0)
    assert stand.quadratic_mean_dbh_cm == pytest.approx(30.0)
    assert (stand.stems, stand.measured, stand.area_method) == (2, 1, AREA_METHOD)
    nothing = stand_table(result.trees, 0.0)
    assert (nothing.stems_per_ha, nothing.basal_area_m2_per_ha, nothing.area_method) == (None, None, NO_AREA)
    assert (nothing.plot_area_m2, nothing.stems_on_area) == (None, None)


def test_stems_off_the_seen_ground_count_to_no_hectare(result: PlotResult) -> None:
    """33 stems on the area of 29 made a plot of 549 stems a hectare, where 515 stood."""
    trees = [replace(result.trees[0], x_m=0.5 + x, y_m=5.0, dbh_cm=30.0) for x in range(8)]
    trees += [replace(result.trees[0], x_m=x, y_m=5.0, dbh_cm=60.0) for x in (12.0, 14.0)]
    trees = [replace(tree, tree_id=number) for number, tree in enumerate(trees, 1)]
    seen = SeenCells(seen=np.ones((20, 20), dtype=bool), corner=np.zeros(2), cell_m=0.5)
    places = np.array([[tree.x_m, tree.y_m] for tree in trees])
    stand = replace(result, trees=tuple(trees), seen_ground=seen, plot_area_m2=seen.area(places)).stand
    assert (stand.stems, stand.stems_on_area, stand.plot_area_m2) == (10, 8, 100.0)
    assert stand.off_area == (9, 10)
    assert stand.stems_per_ha == pytest.approx(800.0)
    assert stand.basal_area_m2_per_ha == pytest.approx(np.pi / 4 * 0.09 * 800.0)
    # Where half of the stems stand elsewhere the area is not that of the plot.
    assert seen.area(np.concatenate([places[:3], places[:4] + 50.0])) == 0.0
    assert seen.area(np.concatenate([places[:3], places[:3] + 50.0])) == 100.0


def test_plot_area_is_the_ground_that_was_seen(result: PlotResult) -> None:
    # Ground of 6.4 m square; closing rounds its edges up to the half-metre cells.
    assert 6.4**2 <= result.plot_area_m2 <= 7.6**2

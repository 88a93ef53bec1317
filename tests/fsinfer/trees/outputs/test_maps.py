"""Maps for a GIS, labelled points and the stand table: what other programs read of a plot."""

from __future__ import annotations

import json
import sqlite3
import struct
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.io.las import read_epsg
from fsinfer.trees import PlotResult, TreeSettings, analyse_plot, stand_table
from fsinfer.trees.outputs.labels import label_points
from fsinfer.trees.outputs.maps import to_wgs84, write_maps
from fsinfer.trees.stand import AREA_METHOD, NO_AREA
from fsinfer.workflow.tree_stage import MAPS, write_no_trees, write_tree_outputs
from tests.support.stem_clouds import StemPlot, stem_plot


@pytest.fixture(scope="module")
def plot() -> StemPlot:
    return stem_plot(seed=8, trees=4, spacing_m=0.02, sigma_m=0.004)


@pytest.fixture(scope="module")
def result(plot: StemPlot) -> PlotResult:
    return analyse_plot(plot.points)


def test_geopackage_holds_every_tree_in_a_local_frame(tmp_path: Path, result: PlotResult) -> None:
    unmeasured = replace(result.trees[0], tree_id=9, dbh_cm=None, reason="for the test, with a comma")
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


def test_geojson_only_where_longitude_and_latitude_are_known(tmp_path: Path, result: PlotResult) -> None:
    at_utm = [replace(tree, x_m=tree.x_m + 691_600.0, y_m=tree.y_m + 5_334_700.0) for tree in result.trees]
    write_maps(tmp_path, at_utm, epsg=32632)
    features = json.loads((tmp_path / "trees.geojson").read_text(encoding="utf-8"))["features"]
    assert len(features) == 4
    longitude, latitude = features[0]["geometry"]["coordinates"]
    assert (longitude, latitude) == (pytest.approx(11.577, abs=0.01), pytest.approx(48.137, abs=0.01))
    # A frame that is not of WGS84 takes the old GeoJSON away instead of leaving a wrong one.
    assert [p.name for p in write_maps(tmp_path, at_utm, epsg=25832)] == ["trees.gpkg"]
    assert not (tmp_path / "trees.geojson").exists()


@pytest.mark.parametrize(
    ("epsg", "x_m", "y_m", "longitude", "latitude"),
    [
        # The central meridian and the equator are where the projection says; 84 and 0 degrees check the two ends.
        (32632, 500_000.0, 0.0, 9.0, 0.0),
        (32732, 500_000.0, 10_000_000.0, 9.0, 0.0),
        # One degree of the equator east of the meridian: 0.9996 a (lambda + lambda^3 (1 - e'^2...)/6): 611,280.8 m.
        (32632, 611_280.7, 0.0, 10.0, 0.0),
        # Meridian arc to 45 degrees on WGS84 is 4,984,944.38 m, times 0.9996.
        (32632, 500_000.0, 4_984_944.378 * 0.9996, 9.0, 45.0),
    ],
)
def test_utm_to_longitude_and_latitude(epsg: int, x_m: float, y_m: float, longitude: float, latitude: float) -> None:
    assert to_wgs84(x_m, y_m, epsg) == (pytest.approx(longitude, abs=2e-5), pytest.approx(latitude, abs=1e-7))


def test_labels_follow_the_stems_and_nothing_else(plot: StemPlot, result: PlotResult) -> None:
    labels = label_points(plot.points, result)
    assert labels.dtype == np.int32
    assert set(np.unique(labels)) == {0, 1, 2, 3, 4}
    for tree in result.trees:
        own = plot.points[labels == tree.tree_id]
        away = np.hypot(own[:, 0] - tree.x_m, own[:, 1] - tree.y_m)
        assert away.max() < 0.5 * tree.dbh_cm / 100.0 + 0.25
        assert len(own) > 1000
    # The ground between the stems belongs to nobody.
    far = np.min([np.hypot(plot.points[:, 0] - t.x_m, plot.points[:, 1] - t.y_m) for t in result.trees], axis=0) > 0.6
    assert (labels[far] == 0).all()


def test_outputs_are_written_and_taken_away_again(tmp_path: Path, plot: StemPlot) -> None:
    values = write_tree_outputs(PointCloud(xyz=plot.points), tmp_path, settings=TreeSettings())
    assert values["stand"]["stems"] == 4
    assert values["plot_area_m2"] > 10.0
    labelled = read_cloud(tmp_path / "trees.laz")
    assert len(labelled) == len(plot.points)
    assert set(np.unique(labelled.extra["TreeID"])) == {0, 1, 2, 3, 4}
    write_no_trees(tmp_path, reason="for the test")
    assert not any((tmp_path / name).exists() for name in MAPS)


def test_without_a_scale_there_are_no_maps(tmp_path: Path, plot: StemPlot) -> None:
    values = write_tree_outputs(PointCloud(xyz=plot.points), tmp_path, settings=TreeSettings(), metric=False)
    assert values["trees"] == 4
    assert values["plot_area_m2"] is None
    assert not any((tmp_path / name).exists() for name in MAPS)


def test_stand_table(result: PlotResult) -> None:
    stand = stand_table([replace(result.trees[0], dbh_cm=30.0), replace(result.trees[1], dbh_cm=None)], 500.0)
    assert stand.stems_per_ha == pytest.approx(40.0)
    assert stand.basal_area_m2_per_ha == pytest.approx(np.pi / 4 * 0.09 * 20.0)
    assert stand.quadratic_mean_dbh_cm == pytest.approx(30.0)
    assert (stand.stems, stand.measured, stand.area_method) == (2, 1, AREA_METHOD)
    nothing = stand_table(result.trees, 0.0)
    assert (nothing.stems_per_ha, nothing.basal_area_m2_per_ha, nothing.area_method) == (None, None, NO_AREA)


def test_plot_area_is_the_ground_that_was_seen(result: PlotResult) -> None:
    # Ground of 6.4 m square; closing rounds its edges up to the half-metre cells.
    assert 6.4**2 <= result.plot_area_m2 <= 7.6**2


def test_a_las_without_a_frame_has_no_epsg(tmp_path: Path) -> None:
    write_cloud(tmp_path / "cloud.laz", PointCloud(xyz=np.random.default_rng(0).uniform(0, 1, (10, 3))))
    assert read_epsg(tmp_path / "cloud.laz") is None


def test_epsg_from_geotiff_keys(tmp_path: Path) -> None:
    import laspy

    path = tmp_path / "utm.las"
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.vlrs.append(laspy.vlrs.known.GeoKeyDirectoryVlr())
    directory = header.vlrs[-1]
    directory.parse_record_data(struct.pack("<12H", 1, 1, 0, 2, 1024, 0, 1, 1, 3072, 0, 1, 32632))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = np.zeros((3, 4))
    cloud.write(path)
    assert read_epsg(path) == 32632

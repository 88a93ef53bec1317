"""A cloud whose header says that it is not in metres is not measured as if it were."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest

from fsinfer.errors import CloudError
from fsinfer.io.las import read_epsg
from fsinfer.io.linear_units import US_FOOT_M
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.scale.request import ScaleRequest
from fsinfer.trees import analyse_plot
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.thinning import ThinningSettings
from fsinfer.workflow.measurable import refuse_other_units
from fsinfer.workflow.measure_cloud import MeasureSettings, measure_cloud_file
from tests.support.stem_clouds import StemPlot, stem_plot

FEET = f'PROJCS["ftUS",GEOGCS["g",UNIT["degree",0.0174532925199433]],UNIT["US survey foot",{US_FOOT_M!r}]]'
HEIGHTS_IN_METRES = 'VERT_CS["h",VERT_DATUM["d",2005],UNIT["metre",1]]'


def write_in_feet(path: Path, plot: StemPlot, wkt: str) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    header.global_encoding.wkt = True
    header.scales = np.full(3, 1e-4)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = plot.points.T / US_FOOT_M
    cloud.write(path)
    return path


def test_feet_are_refused_with_the_scale_that_helps(tmp_path: Path) -> None:
    plot = stem_plot(seed=1, trees=4, spacing_m=0.02, top_m=3.5)
    path, out = write_in_feet(tmp_path / "cloud.las", plot, FEET), tmp_path / "out"
    with pytest.raises(
        CloudError, match=r"cloud.las is not in metres, by its header; give --scale 0\.304800609"
    ) as told:
        measure_cloud_file(path, out, request=ScaleRequest())
    assert not out.exists()
    scale = float(str(told.value).split("--scale ")[1].split(",")[0])
    measure_cloud_file(path, out, request=ScaleRequest(factor=scale))
    assert sorted(t.dbh_cm or 0.0 for t in read_trees(out / "trees.csv")) == pytest.approx(sorted(plot.dbh_cm), abs=0.5)


def test_two_units_are_no_matter_of_scale(tmp_path: Path) -> None:
    plot = stem_plot(seed=1, trees=1, spacing_m=0.05, top_m=3.0)
    path = write_in_feet(tmp_path / "cloud.laz", plot, f'COMPD_CS["both",{FEET},{HEIGHTS_IN_METRES}]')
    with pytest.raises(CloudError, match=r"differ \(0\.304801 and 1 m\): convert it"):
        measure_cloud_file(path, tmp_path / "out", request=ScaleRequest())


@pytest.mark.parametrize("code", [3857, 4978])
def test_metres_that_are_none_on_the_ground_are_refused(code: int, tmp_path: Path) -> None:
    plot = stem_plot(seed=1, trees=1, spacing_m=0.05, top_m=3.0)
    frame = f'PROJCS["far",UNIT["metre",1],AUTHORITY["EPSG","{code}"]]'
    path = write_in_feet(tmp_path / "cloud.laz", plot, frame)
    with pytest.raises(CloudError, match=rf"is in EPSG:{code} by its header, .*; convert it to UTM"):
        measure_cloud_file(path, tmp_path / "out", request=ScaleRequest())
    assert not (tmp_path / "out").exists()


def test_degrees_are_refused_unless_they_can_be_none(tmp_path: Path) -> None:
    plot = stem_plot(seed=1, trees=1, spacing_m=0.05, top_m=3.0)
    frame = 'GEOGCS["WGS 84",UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]'
    in_degrees = plot.points * np.array([1e-5, 1e-5, 1.0]) + np.array([11.5, 48.0, 0.0])
    path = write_in_feet(tmp_path / "cloud.laz", replace(plot, points=in_degrees), frame)
    with pytest.raises(CloudError, match=r"is in degrees by its header \(EPSG:4326\); convert it to UTM"):
        measure_cloud_file(path, tmp_path / "out", request=ScaleRequest())
    # A header that is wrong: no degree is beyond 360, and no plot as wide as some.
    for shift in (10_000.0, 0.0):
        far = replace(plot, points=plot.points + np.array([shift, 0.0, 0.0]))
        refuse_other_units(write_in_feet(path, far, frame))


ELLIPSOIDAL = 'CS[ellipsoidal,2],AXIS["lat",north],AXIS["lon",east],ANGLEUNIT["degree",0.0174532925199433]'
UTM_1 = 'PROJCS["UTM",GEOGCS["g",UNIT["degree",0.0174532925199433]],UNIT["metre",1]]'
UTM_2 = f'PROJCRS["UTM",BASEGEOGCRS["g",{ELLIPSOIDAL}],CS[Cartesian,2],LENGTHUNIT["metre",1]]'


@pytest.mark.parametrize(
    ("frame", "told"),
    [
        # A frame of Austria and one of nobody: what is in degrees says so itself, whatever its code.
        ('GEOGCS["MGI",UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4312"]]', r" \(EPSG:4312\)"),
        (f'COMPD_CS["a",GEOGCS["b",UNIT["degree",0.0174532925199433]],{HEIGHTS_IN_METRES}]', ""),
        (f'GEOGCRS["MGI",{ELLIPSOIDAL},ID["EPSG",4312]]', r" \(EPSG:4312\)"),
        (f'GEODCRS["MGI",{ELLIPSOIDAL},ID["EPSG",4312]]', r" \(EPSG:4312\)"),
        ({1024: 2, 2048: 4312}, r" \(EPSG:4312\)"),
        ({2048: 4312}, r" \(EPSG:4312\)"),
        (UTM_1, None),
        (UTM_2, None),
        ({1024: 1, 2048: 4326, 3072: 32767}, None),  # a projection of one's own
        ({2048: 4326, 3072: 32633}, None),
    ],
)
def test_headers_tell_degrees_themselves(frame: str | dict[int, int], told: str | None, tmp_path: Path) -> None:
    path = tmp_path / "cloud.las"
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 1e-8), np.array([14.0, 47.0, 0.0])
    if isinstance(frame, str):
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(frame))
        header.global_encoding.wkt = True
    else:
        keys = [part for key, value in frame.items() for part in (key, 0, 1, value)]
        header.vlrs.append(laspy.vlrs.known.GeoKeyDirectoryVlr())
        header.vlrs[-1].parse_record_data(struct.pack(f"<{4 + len(keys)}H", 1, 1, 0, len(frame), *keys))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = np.array([[14.2, 47.1, 1.0], [14.2003, 47.1002, 2.0]]).T
    cloud.write(path)
    if told is None:
        refuse_other_units(path)
        # That of the base of a projection is not the frame of what was projected.
        assert read_epsg(path) in (None, 32633)
        return
    with pytest.raises(CloudError, match=rf"is in degrees by its header{told}; convert it to UTM"):
        refuse_other_units(path)


@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize(("shift", "request_"), [(10_000.0, ScaleRequest()), (0.0, ScaleRequest(factor=1.0))])
def test_metres_are_in_no_frame_of_degrees(tmp_path: Path, shift: float, request_: ScaleRequest, large: bool) -> None:
    plot = stem_plot(seed=1, trees=2, spacing_m=0.02, top_m=3.5)
    moved = replace(plot, points=(plot.points + np.array([shift, 0.0, 0.0])) * US_FOOT_M)
    frame = 'GEOGCS["WGS 84",UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]'
    path, out = write_in_feet(tmp_path / "cloud.laz", moved, frame), tmp_path / "out"
    thinning = ThinningSettings(max_points=30_000 if large else 30_000_000)
    record = measure_cloud_file(path, out, request=request_, settings=MeasureSettings(thinning=thinning))
    assert sorted(t.dbh_cm or 0.0 for t in read_trees(out / "trees.csv")) == pytest.approx(sorted(plot.dbh_cm), abs=1)
    said = [sentence(item) for item in record.result.trees.warnings if item.code == StemCode.frame_in_degrees]
    assert said == [
        "the header says degrees (EPSG:4326), and the coordinates were taken as metres: maps and points get no frame"
    ]
    assert read_epsg(out / "trees.laz") is None
    assert not (out / "trees.geojson").exists()
    with closing(sqlite3.connect(out / "trees.gpkg")) as base:
        assert base.execute("SELECT srs_id FROM gpkg_contents").fetchall() == [(-1,)]


def test_the_labelled_points_keep_the_frame_of_the_cloud(tmp_path: Path) -> None:
    plot = stem_plot(seed=1, trees=1, spacing_m=0.03, top_m=3.0)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.vlrs.append(
        laspy.vlrs.known.WktCoordinateSystemVlr('PROJCS["utm",UNIT["metre",1],AUTHORITY["EPSG","32632"]]')
    )
    header.global_encoding.wkt = True
    header.scales, header.offsets = np.full(3, 1e-4), np.array([600_000.0, 5_300_000.0, 0.0])
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = plot.points.T + np.array([[600_000.0], [5_300_000.0], [0.0]])
    path, out = tmp_path / "cloud.laz", tmp_path / "out"
    cloud.write(path)
    measure_cloud_file(path, out, request=ScaleRequest())
    assert read_epsg(out / "trees.laz") == 32632


@pytest.mark.parametrize(("unit_m", "metric", "told"), [(1.0, True, 0), (0.3048, True, 1), (0.3048, False, 0)])
def test_stems_measured_in_feet_by_a_file_that_says_nothing_are_too_thick(
    unit_m: float, metric: bool, told: int
) -> None:
    plot = stem_plot(trees=9, seed=5, dbh_cm=(25.0, 45.0))
    result = analyse_plot(plot.points / unit_m, metric=metric)
    warnings = [sentence(warning) for warning in result.warnings if warning.code == StemCode.all_thick]
    assert len(result.trees) == 9
    assert len(warnings) == told
    assert all("--scale 0.3048" in text for text in warnings)

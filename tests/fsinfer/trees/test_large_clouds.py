"""Clouds read in pieces: the same points as read whole, thinned without bias, labelled without loss."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.errors import CloudError
from fsinfer.io.chunks import ChunkSettings, open_chunks
from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.io.ply import write_ply
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentences
from fsinfer.notices.stems import StemCode
from fsinfer.output.plot_json import read_plot
from fsinfer.plot_border.request import BorderRequest
from fsinfer.report.cloud.data import read_some
from fsinfer.scale.request import ScaleRequest
from fsinfer.trees import analyse_plot
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.thinning import ThinningSettings, thin_while_reading
from fsinfer.workflow.measure_cloud import MeasureSettings, measure_cloud_file
from fsinfer.workflow.tree_stage import TreeStageSettings
from tests.support.stem_clouds import StemPlot, stem_plot

SMALL = ChunkSettings(chunk_points=7_001, sample_slices=16, slice_points=500)
THIN = ThinningSettings(max_points=30_000)


@pytest.fixture(scope="module")
def plot() -> StemPlot:
    return stem_plot(trees=4, seed=5, spacing_m=0.007, slope=0.1)


@pytest.fixture(scope="module")
def cloud(plot: StemPlot) -> PointCloud:
    rng = np.random.default_rng(0)
    count = len(plot.points)
    rgb = rng.integers(0, 255, (count, 3)).astype(np.uint8)
    return PointCloud(xyz=plot.points, rgb=rgb, extra={"views": rng.integers(0, 9, count).astype(np.int32)})


@pytest.fixture(scope="module", params=["a.ply", "a.las", "a.laz"])
def path(request: pytest.FixtureRequest, cloud: PointCloud, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("clouds") / request.param
    write_cloud(path, cloud)
    return path


def test_pieces_are_the_whole_file(path: Path) -> None:
    chunked = open_chunks(path, factor=2.0, settings=SMALL)
    assert chunked is not None
    pieces = list(chunked.chunks())
    assert len(pieces) > 5
    whole = read_cloud(path).xyz
    assert chunked.points == len(whole)
    np.testing.assert_allclose(np.concatenate(pieces), 2.0 * whole, atol=1e-9)
    sample = chunked.sample()
    assert 500 < len(sample) < len(whole)
    np.testing.assert_allclose(np.ptp(sample, axis=0), 2.0 * np.ptp(whole, axis=0), rtol=0.2)


def test_thinning_keeps_the_budget_and_breast_height(path: Path) -> None:
    chunked = open_chunks(path, settings=SMALL)
    assert chunked is not None
    thinned = thin_while_reading(chunked, settings=THIN)
    assert 0.9 * THIN.max_points < len(thinned.xyz) < 1.05 * THIN.max_points
    told = thinned.warnings[0]
    assert (told.code, told.values["total"], told.values["kept"]) == (
        StemCode.thinned,
        chunked.points,
        len(thinned.xyz),
    )
    whole = read_cloud(path).xyz
    # Crowded cells give up most; still a larger share of breast height is kept than of the tops.
    after, before = thinned.xyz[:, 2], whole[:, 2]
    bands = ((0.8, 2.2), (3.6, np.inf))
    share = [np.sum((after > low) & (after < high)) / np.sum((before > low) & (before < high)) for low, high in bands]
    assert share[0] > 1.5 * share[1]
    # Nothing is moved: what is kept is in the file.
    kept = {tuple(row) for row in np.round(thinned.xyz[:500], 5)}
    assert kept <= {tuple(row) for row in np.round(whole, 5)}


def test_thinning_does_not_move_the_diameters(plot: StemPlot, tmp_path: Path) -> None:
    noisy = stem_plot(trees=4, seed=5, spacing_m=0.007, sigma_m=0.012, outliers=0.1)
    write_cloud(tmp_path / "a.las", PointCloud(xyz=noisy.points))
    chunked = open_chunks(tmp_path / "a.las", settings=SMALL)
    assert chunked is not None
    thinned = thin_while_reading(chunked, settings=ThinningSettings(max_points=60_000))
    few, all_ = analyse_plot(thinned.xyz), analyse_plot(noisy.points)
    assert len(few.trees) == len(all_.trees) == 4
    for a, b in zip(few.trees, all_.trees, strict=True):
        assert a.dbh_cm == pytest.approx(b.dbh_cm, abs=0.35)


def test_a_large_file_is_measured_thinned_and_labelled_whole(path: Path, cloud: PointCloud, tmp_path: Path) -> None:
    result = measure_cloud_file(
        path, tmp_path, request=ScaleRequest(), settings=MeasureSettings(thinning=replace(THIN, max_points=50_000))
    )
    assert StemCode.thinned in [item.code for item in result.result.trees.warnings]
    plot = read_plot(tmp_path)
    assert plot["points"] == len(cloud)
    assert plot["warnings"] == list(sentences(result.result.trees.warnings))
    labelled = read_cloud(tmp_path / "trees.laz")
    np.testing.assert_allclose(labelled.xyz, cloud.xyz, atol=2e-3)
    np.testing.assert_array_equal(labelled.rgb, cloud.rgb)
    np.testing.assert_array_equal(labelled.extra["views"], cloud.extra["views"])
    trees = read_trees(tmp_path / "trees.csv")
    assert len(trees) == 4
    for tree in trees:
        own = labelled.xyz[labelled.extra["TreeID"] == tree.tree_id]
        assert len(own) > 1000
        assert np.hypot(*(own[:, :2] - [tree.x_m, tree.y_m]).T).max() < 0.5
    # The density is that of the file, not of what was kept.
    assert plot["density_per_m2"] > 1.5 * 50_000 / plot["stand"]["plot_area_m2"]


def test_scaled_large_files_lose_their_frame_and_keep_their_points(cloud: PointCloud, tmp_path: Path) -> None:
    write_cloud(tmp_path / "a.las", PointCloud(xyz=10.0 * cloud.xyz))
    request = ScaleRequest(factor=0.1)
    measure_cloud_file(tmp_path / "a.las", tmp_path / "out", request=request, settings=MeasureSettings(thinning=THIN))
    labelled = read_cloud(tmp_path / "out" / "trees.laz")
    np.testing.assert_allclose(labelled.xyz, cloud.xyz, atol=2e-3)


@pytest.mark.parametrize("max_points", [THIN.max_points, 10_000_000])
def test_what_a_file_marks_as_noise_is_not_measured(
    plot: StemPlot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, max_points: int
) -> None:
    monkeypatch.setattr("fsinfer.report.cloud.data.MAX_IN_MEMORY", max_points)
    rng = np.random.default_rng(3)
    noise = rng.uniform(plot.points.min(axis=0) - [0, 0, 2.0], plot.points.max(axis=0), (len(plot.points) // 5, 3))
    kinds = np.repeat([1, 7], [len(plot.points), len(noise)]).astype(np.uint8)
    cloud = PointCloud(xyz=np.concatenate([plot.points, noise]), extra={"classification": kinds})
    write_cloud(tmp_path / "a.laz", cloud)
    settings = MeasureSettings(thinning=replace(THIN, max_points=max_points))
    record = measure_cloud_file(tmp_path / "a.laz", tmp_path / "out", request=ScaleRequest(), settings=settings)
    assert notice(StemCode.flagged, points=len(noise)) in record.result.trees.warnings
    assert StemCode.not_finite not in {told.code for told in record.result.trees.warnings}
    assert record.result.trees.trees_with_dbh == len(plot.dbh_cm)
    assert record.result.points == len(plot.points)
    shown, _ = read_some(tmp_path / "a.laz")
    assert shown.xyz[:, 2].min() > plot.points[:, 2].min() - 0.01


def test_a_large_file_in_which_all_is_noise_says_so(plot: StemPlot, tmp_path: Path) -> None:
    kinds = np.full(len(plot.points), 7, np.uint8)
    write_cloud(tmp_path / "a.laz", PointCloud(xyz=plot.points, extra={"classification": kinds}))
    with pytest.raises(CloudError, match=f"{len(kinds)} are marked as withheld or as noise"):
        measure_cloud_file(
            tmp_path / "a.laz", tmp_path / "out", request=ScaleRequest(), settings=MeasureSettings(thinning=THIN)
        )


def test_points_far_away_and_without_a_place_are_left_out(plot: StemPlot, tmp_path: Path) -> None:
    dirty = np.concatenate([plot.points, [[5000.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    write_cloud(tmp_path / "a.ply", PointCloud(xyz=dirty))
    data = bytearray((tmp_path / "a.ply").read_bytes())
    nan = np.array([np.nan], dtype=np.float64 if b"double" in data[:400] else np.float32).tobytes()
    data[-len(nan) :] = nan
    (tmp_path / "a.ply").write_bytes(bytes(data))
    chunked = open_chunks(tmp_path / "a.ply", settings=SMALL)
    assert chunked is not None
    thinned = thin_while_reading(chunked, settings=THIN)
    assert thinned.warnings[1:] == (notice(StemCode.not_finite, points=1), notice(StemCode.far_outside, points=1))
    assert np.abs(thinned.xyz).max() < 100.0


@pytest.mark.parametrize("max_points", [THIN.max_points, 10_000_000])
def test_a_point_at_zero_of_a_cloud_in_national_coordinates_stops_nothing(
    plot: StemPlot, tmp_path: Path, max_points: int
) -> None:
    place = np.array([452_000.0, 5_412_000.0, 400.0])
    xyz = np.insert(plot.points + place, 200_000, 0.0, axis=0)
    write_ply(tmp_path / "a.ply", dict(zip("xyz", xyz.T, strict=True)))
    border = BorderRequest(radius_m=3.0, center=(place[0], place[1]))
    settings = MeasureSettings(thinning=replace(THIN, max_points=max_points), stage=TreeStageSettings(border=border))
    trees = measure_cloud_file(tmp_path / "a.ply", tmp_path / "out", request=ScaleRequest(), settings=settings)
    assert StemCode.far_outside in [told.code for told in trees.result.trees.warnings]
    assert trees.result.trees.trees_with_dbh == 4
    assert (tmp_path / "out" / "stem_curve.csv").stat().st_size > 300
    labelled = read_cloud(tmp_path / "out" / "trees.laz")
    assert len(xyz) - 1 <= len(labelled) <= len(xyz)
    assert len(set(labelled.extra["TreeID"].tolist())) == 5


@pytest.mark.parametrize("suffix", [".las", ".laz", ".ply"])
def test_a_cut_file_is_one_message(cloud: PointCloud, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_cloud(path, cloud)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(CloudError, match="cut short"):
        measure_cloud_file(path, tmp_path, request=ScaleRequest(), settings=MeasureSettings(thinning=THIN))


def test_kinds_that_are_read_whole(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("0 0 0\n1 1 1\n", encoding="utf-8")
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        "0 0 0\n",
        encoding="ascii",
    )
    assert open_chunks(tmp_path / "a.xyz") is None
    assert open_chunks(tmp_path / "a.ply") is None
    with pytest.raises(CloudError, match="gone"):
        open_chunks(tmp_path / "gone.laz")


def test_las_without_a_frame_stays_local(cloud: PointCloud, tmp_path: Path) -> None:
    write_cloud(tmp_path / "a.las", PointCloud(xyz=cloud.xyz))
    measure_cloud_file(tmp_path / "a.las", tmp_path / "out", request=ScaleRequest())
    assert not (tmp_path / "out" / "trees.geojson").exists()
    with closing(sqlite3.connect(tmp_path / "out" / "trees.gpkg")) as base:
        assert base.execute("SELECT srs_id FROM gpkg_contents").fetchall() == [(-1,)]

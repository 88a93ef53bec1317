"""What is known of the scale, of the cameras and of the boards reaches the trees that are measured by it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.notices.stems import StemCode
from fsinfer.output.json_values import as_json
from fsinfer.output.plot_json import read_plot
from fsinfer.plot_border.hectare import DIAMETERS, SCALE
from fsinfer.plot_border.request import BorderRequest
from fsinfer.scale.request import ScaleRequest
from fsinfer.scene import read_scene
from fsinfer.silhouettes.walk import WalkSettings
from fsinfer.trees.outputs.table import read_trees
from fsinfer.workflow.measure_cloud import MeasureSettings, measure_cloud_file
from fsinfer.workflow.run_photos import photos_of_run
from fsinfer.workflow.tree_stage import PlotCloudInput, TreeStageSettings, measure_plot
from tests.support.boards import board, scale_of_boards
from tests.support.rendered_stem import BREAST, LEAN, M_PER_UNIT, PHOTOS, RADIUS, TAPER, write_photographs
from tests.support.stem_clouds import forked_stem
from tests.support.synthetic_plot import STEMS

#: Half the width of an interval over the standard deviation.
TO_95 = 1.96
#: Measures the cloud of a run with this in its ``plot.json`` and the ``poses.json`` of its scene; the new ``plot.json``
#: and the rows of the stems, that of the rendered one first.
Measure = Callable[..., tuple[dict[str, Any], list[dict[str, str]]]]


def cloud() -> PointCloud:
    """Flat ground, the rendered stem and two upright ones beside it, which no photograph shows."""
    rng = np.random.default_rng(0)
    pieces = [np.column_stack([rng.uniform(-3.5, 3.5, (20_000, 2)), rng.normal(0, 0.01, 20_000)])]
    stems = [(*BREAST[:2], RADIUS, LEAN, TAPER), *((x, y, r, 0 * LEAN, 0.0) for x, y, r in STEMS[1:] * [2, 2, 1])]
    for x, y, radius, lean, taper in stems:
        turn, height = rng.uniform(0, 2 * np.pi, 8000), rng.uniform(0, 3.5, 8000) - BREAST[2]
        at_height = radius + taper * height + rng.normal(0, 0.003, 8000)
        out = at_height[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        pieces.append(np.column_stack([out + [x, y] + height[:, None] * lean, height + BREAST[2]]))
    return PointCloud(xyz=np.concatenate(pieces))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_photographs(folder / "scene", folder)
    write_cloud(folder / "cloud.ply", cloud())
    return folder


@pytest.fixture
def measure(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Measure:
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda *_, **__: None)
    similarity = np.diag([*[M_PER_UNIT] * 3, 1.0]).tolist()
    plot = {"source": "photos", "units": "m", "scale_m_per_unit": M_PER_UNIT, "cloud_from_scene": similarity}

    def measured(
        *, border: BorderRequest | None = None, camera_std: dict[str, Any] | None = None, **known: Any
    ) -> tuple[dict[str, Any], list[dict[str, str]]]:
        (run / "plot.json").write_text(json.dumps(plot | known), encoding="utf-8")
        (run / "scene" / "poses.json").write_text(json.dumps({"camera_std": camera_std or {}}), encoding="utf-8")
        out = tmp_path / f"out-{len(list(tmp_path.glob('out-*')))}"
        settings = MeasureSettings(stage=TreeStageSettings(border=border or BorderRequest()))
        measure_cloud_file(run / "cloud.ply", out, request=ScaleRequest(), settings=settings)
        with (out / "trees.csv").open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
        with (out / "dbh_sources.csv").open(encoding="utf-8", newline="") as stream:
            (edges,) = csv.DictReader(stream)
        return read_plot(out), sorted(rows, key=lambda row: row["tree_id"] != edges["tree_id"])

    return measured


def half_cm(row: dict[str, str]) -> float:
    return (float(row["dbh_hi95_cm"]) - float(row["dbh_lo95_cm"])) / 2


def test_the_error_of_the_scale_is_in_every_interval(measure: Measure) -> None:
    (_, exact), (_, unsure) = measure(scale_rel_std=0.0), measure(scale_rel_std=0.03)
    assert len(exact) == 3
    for before, after in zip(exact, unsure, strict=True):
        assert after["dbh_cm"] == before["dbh_cm"]
        of_scale = TO_95 * 0.03 * float(before["dbh_cm"])
        assert half_cm(after) == pytest.approx(np.hypot(half_cm(before), of_scale), rel=0.1)
        assert half_cm(before) < 0.8 * of_scale


def test_the_error_of_the_cameras_is_in_the_interval_of_a_stem_whose_edges_are_seen(measure: Measure) -> None:
    _, known = measure()
    # Both sides of the stem are seen, which balances nearly all of it.
    std = {f"p{number}": {"center": 0.5 / M_PER_UNIT, "direction_rad": 0.0} for number in range(PHOTOS)}
    _, unsure = measure(camera_std=std)
    assert half_cm(unsure[0]) > half_cm(known[0]) + 0.1
    assert half_cm(unsure[1]) == half_cm(known[1])


def test_the_border_and_its_figures_know_boards_scale_and_what_stems_share(measure: Measure) -> None:
    boards = [board(number, (2 * x, 2 * y, 3.0), "abc") for number, x, y in ((7, 0.5, 0.0), (9, 9.0, 0.0))]
    given = {"scale_details": as_json(scale_of_boards(boards).details), "scale_rel_std": 0.03}
    plot, _ = measure(border=BorderRequest(radius_m=3.0, marker=7), **given)
    border = plot["plot_border"]
    assert (border["origin"], border["center"]) == ("marker 7", pytest.approx([0.5, 0.0]))
    assert border["stems"] == 3
    figure = border["stems_per_ha"]
    assert figure["parts"][SCALE] == pytest.approx(TO_95 * 2 * 0.03 * figure["value"], rel=1e-3)
    assert "photos" in border["seen_method"]
    plot, rows = measure(border=BorderRequest(radius_m=3.0, center=(0.5, 0.0)))
    border = plot["plot_border"]
    # Square metres, as if each stem erred for itself.
    own_m2 = [np.pi / 2 * float(row["dbh_cm"]) * half_cm(row) / 1e4 for row in rows]
    alone = np.linalg.norm(own_m2) / border["seen_share"] * 1e4 / border["area_m2"]
    assert border["basal_area_m2_per_ha"]["parts"][DIAMETERS] > 1.1 * alone


def test_a_tree_that_forks_below_breast_height_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda *_, **__: None)
    plot = cloud().xyz
    stem = forked_stem(np.random.default_rng(3), at=(-2.0, 2.0), height_m=0.9)
    plot = plot[np.hypot(*(plot[:, :2] - [-2.0, 2.0]).T) > 0.22]  # no ground within the stem
    result = measure_plot(PlotCloudInput(cloud=PointCloud(xyz=np.concatenate([plot, stem]))), tmp_path)
    assert result.trees == 5
    (told,) = [told for told in result.warnings if told.code == StemCode.forked]
    assert told.values["height_m"] == pytest.approx(0.5, abs=0.2)


def test_a_stem_far_from_the_walk_is_measured_where_it_was_asked_for(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda *_, **__: None)
    rng = np.random.default_rng(4)
    away = np.array([0.3, -9.5])
    turn, height = rng.uniform(0, 2 * np.pi, 8000), rng.uniform(0, 3.5, 8000)
    stem = np.column_stack([away + 0.15 * np.column_stack([np.cos(turn), np.sin(turn)]), height])
    below = np.column_stack([rng.uniform(-3, 3, (8000, 2)) + away, np.zeros(8000)])
    below = below[np.hypot(*(below[:, :2] - away).T) > 0.15]
    plot = np.concatenate([cloud().xyz, stem + rng.normal(0, 0.003, stem.shape), below])
    photos = photos_of_run(run, read_scene(run / "scene"), np.diag([*[M_PER_UNIT] * 3, 1.0]))
    given = PlotCloudInput(cloud=PointCloud(xyz=plot), photos=photos)
    for far in (False, True):
        settings = TreeStageSettings(walk=WalkSettings(measure_far=far))
        result = measure_plot(given, tmp_path / str(far), settings=settings)
        (tree,) = [tree for tree in read_trees(tmp_path / str(far) / "trees.csv") if tree.y_m < -8.0]
        assert result.trees_outside == 1
        assert (tree.dbh_cm is not None) is far
        assert tree.dbh_cm is None or tree.dbh_cm == pytest.approx(30.0, abs=0.5)

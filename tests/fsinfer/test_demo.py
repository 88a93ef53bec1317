"""The demo: the whole job on the plot in the package, with the real stages."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fsinfer.cli.app import app
from fsinfer.cli.tables import demo_rows
from fsinfer.depth.manifest import models_folder, read_manifest
from fsinfer.depth.model import DepthModel
from fsinfer.depth.precision import choose_precision
from fsinfer.depth.view_group import ViewGroup
from fsinfer.evaluation.measured import read_measured
from fsinfer.evaluation.metrics import evaluate
from fsinfer.io.images import read_image
from fsinfer.scene import read_scene
from fsinfer.workflow.demo import DemoResult, run_demo

HAS_DEMO = (resources.files("fsinfer") / "demo_data" / "truth.csv").is_file()
HAS_MODEL = (models_folder() / "field.json").is_file()


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> DemoResult:
    if not (HAS_DEMO and HAS_MODEL):
        pytest.skip("the demo plot or the depth model is not in this source tree")
    return run_demo(tmp_path_factory.mktemp("demo") / "out")


def test_demo_finds_every_tree_as_well_as_the_documents_say(demo: DemoResult) -> None:
    assert demo.run.plot["scale_source"] == "aruco"
    e = demo.evaluation
    assert (e.n, e.matched, e.omitted, e.false) == (5, 5, 0, 0)
    assert e.rmse_cm is not None
    assert e.rmse_cm <= 0.4
    assert demo.run.plot["registered"] == demo.run.plot["photos"] == 36


def test_demo_writes_everything(demo: DemoResult) -> None:
    for name in ("cloud.ply", "cloud.laz", "trees.csv", "plot.json", "report.html", "truth.csv"):
        assert (demo.run.out / name).stat().st_size > 0


def test_second_demo_does_nothing(demo: DemoResult) -> None:
    again = run_demo(demo.run.out)
    assert not any(record.ran for record in again.run.stages)
    assert again.evaluation == demo.evaluation


def test_demo_plot_is_small() -> None:
    if not HAS_DEMO:
        pytest.skip("the demo plot is not in this source tree")
    folder = Path(str(resources.files("fsinfer") / "demo_data"))
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < 4_000_000


def test_table_names_every_tree_of_the_truth(tmp_path: Path) -> None:
    from fsinfer.notices.notice import notice
    from fsinfer.notices.stems import StemCode
    from fsinfer.trees import Tree

    truth = tmp_path / "truth.csv"
    truth.write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n2,5,0,40\n3,0,5,20\n", encoding="utf-8")
    rest: dict[str, Any] = {
        "z_ground_m": 0.0,
        "dbh_perimeter_cm": None,
        "dbh_min_cm": None,
        "dbh_max_cm": None,
        "bh_m": 1.3,
    }
    rest |= {"arc_coverage": 1.0, "points": 9, "residual_cm": 0.5, "lean_deg": 1.0, "height_m": None, "status": "ok"}
    found = Tree(tree_id=7, x_m=0, y_m=0, dbh_cm=31.2, dbh_lo95_cm=30.1, dbh_hi95_cm=32.3, reasons=(), **rest)
    why = (notice(StemCode.as_written, text="too narrow"),)
    bare = Tree(tree_id=8, x_m=5, y_m=0, dbh_cm=None, dbh_lo95_cm=None, dbh_hi95_cm=None, reasons=why, **rest)
    measured = tuple(read_measured(truth))
    result = DemoResult(
        run=None,  # type: ignore[arg-type]
        trees=(found, bare),
        truth=measured,
        evaluation=evaluate(measured, (found, bare), align="never"),
    )
    rows = demo_rows(result)
    assert rows[1].split() == ["1", "30.0", "cm", "31.2", "cm", "[30.1", "-", "32.3]", "+1.2", "cm", "tree", "7"]
    assert "too narrow" in rows[2]
    assert "not found" in rows[3]
    assert any(row.startswith("RMSE") and "1.20 cm" in row for row in rows)


def test_int8_gives_the_depth_of_float32(demo: DemoResult) -> None:
    if choose_precision("auto", read_manifest("field")) != "int8":
        pytest.skip("this processor has no dot products of 8-bit integers")
    scene = read_scene(demo.run.out / "scene")
    models = [DepthModel.load("field", precision=precision) for precision in ("float32", "int8")]
    planes, depths = [], []
    for view in scene.views[5:30:12]:
        group = [view, *(scene.views[i] for i in view.sources[:4])]
        images = [read_image(v.image_path) for v in group]
        features = [[model.features(image) for image in images] for model in models]
        cameras = np.stack([v.camera.intrinsic for v in group]), np.stack([v.camera.cam_from_world for v in group])
        depth_range = (view.camera.depth_min, view.camera.depth_max)
        both = [(model, ViewGroup.of(own, *cameras, depth_range)) for model, own in zip(models, features, strict=True)]
        exact_index, quick_index = (model.regularize(model.cost_volume(group)[0])[0] for model, group in both)
        planes.append(np.abs(quick_index - exact_index).ravel())
        exact, quick = (model.estimate(group) for model, group in both)
        depths.append(np.abs(quick.depth / exact.depth - 1)[exact.confidence > 0.5])
    index, depth = np.concatenate(planes), np.concatenate(depths)
    assert 0 < np.median(index) < 0.1
    assert (index > 1).mean() < 0.05
    assert np.median(depth) < 0.001
    assert (depth > 0.01).mean() < 0.02


def test_the_demo_takes_a_model(tmp_path: Path) -> None:
    ended = CliRunner().invoke(app, ["demo", str(tmp_path / "out"), "--model", "nothere"])
    assert ended.exit_code == 2
    assert "no depth model nothere" in ended.output

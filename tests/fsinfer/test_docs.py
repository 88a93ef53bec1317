"""The code in the documentation runs, on small data, and does what the text says."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import io
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fsinfer.batch.run import BatchResult
from fsinfer.depth.manifest import models_folder
from fsinfer.depth.model import DepthModel
from fsinfer.io.cloud import write_cloud
from fsinfer.io.images import read_image
from fsinfer.scene import read_scene
from fsinfer.workflow.pipeline import RunResult
from tests.support.places import ROOT
from tests.support.plane_scene import write_plane_scene
from tests.support.report_plot import plot_cloud, tree_rows, write_report_folder


def python_blocks(name: str) -> list[str]:
    return re.findall(
        r"^```python\n(.*?)^```", (ROOT / name).read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )


@pytest.mark.parametrize("name", ["cascade", "field"])
def test_the_example_without_fsinfer_computes_the_same_depth(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (block,) = python_blocks("docs/onnx.md")
    assert '"cascade.json"' in block
    block = block.replace('"cascade.json"', f'"{name}.json"')
    assert "fsinfer" not in block
    (tmp_path / "models").symlink_to(models_folder())
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(block, "docs/onnx.md", "exec"), names)
    views = read_scene(write_plane_scene(tmp_path / "scene", height=75, width=90)).views
    images = [read_image(view.image_path) for view in views]
    intrinsics = np.stack([view.camera.intrinsic for view in views])
    poses = np.stack([view.camera.cam_from_world for view in views])
    depth, confidence = names["depth_of"](images, intrinsics, poses, 1.5, 12.0)  # type: ignore[operator]
    model = DepthModel.load(name, threads=1, precision="float32")
    expected = model.predict(images, intrinsics, poses, (1.5, 12.0))
    assert depth.shape == expected.depth.shape == (38, 45)
    # Where two hypotheses are equally good, rounding decides between them.
    close = np.abs(depth - expected.depth) < 1e-3 * expected.depth
    assert close.mean() > 0.995
    assert np.abs(confidence - expected.confidence)[close].max() < 5e-3


def test_the_walk_through_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Drawing takes most of the time, and is tested elsewhere.
    monkeypatch.setattr(
        "fsinfer.trees.outputs.figures.write_figures", lambda folder, *_, **__: folder.mkdir(exist_ok=True)
    )
    out = write_report_folder(tmp_path / "plot")
    write_cloud(out / "cloud.ply", plot_cloud(points_per_stem=12_000, ground=30_000))
    # The numbers of its table are those that the cloud's trees get when they are measured.
    head, first, second, third = (out / "trees.csv").read_text(encoding="utf-8").splitlines()
    renumbered = [head, first, f"2{third.removeprefix('3')}", f"3{second.removeprefix('2')}"]
    (out / "trees.csv").write_text("\n".join(renumbered) + "\n", encoding="utf-8")
    rows = ["tree_id,x_m,y_m,dbh_cm", *(f"{r['tree_id']},{r['x_m']},{r['y_m']},{r['dbh_cm'] + 1}" for r in tree_rows())]
    (out / "truth.csv").write_text("\n".join(rows), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    printed = io.StringIO()
    names: dict[str, object] = {}
    blocks = python_blocks("docs/example.md")
    assert len(blocks) == 8
    with contextlib.redirect_stdout(printed):
        for number, block in enumerate(blocks, start=1):
            exec(compile(block, f"docs/example.md, block {number}", "exec"), names)
    text = printed.getvalue()
    assert "12 of 12 photos, 3 trees, lengths in m" in text
    assert "3 of 3 found, RMSE 1.00 cm, bias -1.00 cm" in text
    assert "is in front of 12 photos" in text
    assert "tree 1: 30.0 cm at 1.30 m" in text
    assert "[1, 2, 4] report.html" in text
    assert (out / "report.html").stat().st_size > 100_000


def test_the_lines_of_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (block,) = python_blocks("README.md")
    monkeypatch.chdir(tmp_path)
    write_cloud(Path("plot.laz"), plot_cloud(points_per_stem=6_000, ground=15_000))
    views = read_scene(write_plane_scene(tmp_path / "scene")).views
    angle = np.linspace(0.0, 6.0, 200)
    names: dict[str, Any] = {
        "images": [read_image(view.image_path) for view in views],
        "intrinsics": np.stack([view.camera.intrinsic for view in views]),
        "cam_from_world": np.stack([view.camera.cam_from_world for view in views]),
        "depth_min": 1.5, "depth_max": 12.0, "slice_xy": 0.2 * np.column_stack([np.cos(angle), np.sin(angle)]),
    }  # fmt: skip
    exec(compile(block, "README.md", "exec"), names)
    assert names["estimate"].depth.shape == (54, 70)
    assert sorted(tree.dbh_cm for tree in names["trees"]) == pytest.approx([22.0, 30.0, 40.0], abs=0.5)
    assert names["circle"].radius == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("document", "work", "said"),
    [
        ("docs/quickstart.md", "fsinfer.workflow.pipeline.run", "16 ['all well']"),
        ("docs/batch.md", "fsinfer.batch.run.run_batch", "3 of 3 plots"),
    ],
)
def test_the_same_from_python(
    document: str,
    work: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (block,) = python_blocks(document)
    module, _, name = work.rpartition(".")
    real = inspect.signature(getattr(importlib.import_module(module), name))
    monkeypatch.chdir(tmp_path)
    result = SimpleNamespace(plot={"trees": 16, "warnings": ["all well"]}, counts="3 of 3 plots")
    assert {"plot", "counts"} <= {*RunResult.__dataclass_fields__, *BatchResult.__dataclass_fields__}

    def done(*args: Any, **options: Any) -> SimpleNamespace:
        real.bind(*args, **options)
        return result

    monkeypatch.setattr(work, done)
    exec(compile(block, document, "exec"), {})
    assert capsys.readouterr().out == f"{said}\n"

"""What a measurement may remove from an output folder: its own files, and never those of the user."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from fsinfer.errors import CloudError, InputError
from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.io.files import make_folder
from fsinfer.io.pfm import write_pfm
from fsinfer.scale.request import ScaleRequest
from fsinfer.scene import read_scene
from fsinfer.workflow.measure_cloud import measure_cloud_file
from fsinfer.workflow.pipeline import run
from fsinfer.workflow.single_stages import fuse_scene
from tests.support.plane_scene import write_plane_scene
from tests.support.stem_clouds import stem_plot


@pytest.fixture
def scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("fsinfer.trees.outputs.figures.write_figures", lambda folder, *_, **__: make_folder(folder))
    path = tmp_path / "scan.laz"
    write_cloud(path, PointCloud(xyz=stem_plot(trees=1, seed=2).points))
    return path


def put(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("precious", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "name", ["trees.xlsx", "trees.csv", "trees.laz", "dbh_sources.csv", "figures/tree_001.png", "figures/stem_map.png"]
)
def test_a_table_or_figure_of_others_is_never_replaced(scan: Path, tmp_path: Path, name: str) -> None:
    out = tmp_path / "out"
    mine = put(out / name)
    for _ in range(2):
        with pytest.raises(InputError, match="choose another output folder") as told:
            measure_cloud_file(scan, out, request=ScaleRequest())
        assert str(mine) in str(told.value)
    assert mine.read_text(encoding="utf-8") == "precious"


def test_a_run_looks_before_it_begins(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    put(photos / "a.jpg")
    mine = put(tmp_path / "out" / "trees.xlsx")
    with pytest.raises(InputError, match=r"trees\.xlsx would be replaced"):
        run(photos, tmp_path / "out")
    assert mine.read_text(encoding="utf-8") == "precious"


@pytest.mark.parametrize("name", ["cloud.ply", "cloud.laz"])
def test_a_cloud_of_others_is_never_replaced(scan: Path, tmp_path: Path, name: str) -> None:
    """A scan that lies beside the photographs; that its trees were measured there makes it none of ours."""
    photos, out = tmp_path / "photos", tmp_path / "out"
    put(photos / "a.jpg")
    make_folder(out)
    mine = out / name
    write_cloud(mine, PointCloud(xyz=stem_plot(trees=1, seed=2).points))
    content = mine.read_bytes()
    for _ in range(2):
        with pytest.raises(InputError, match="would be replaced, and no run of fsinfer made it"):
            run(photos, out)
        with pytest.raises(InputError, match="would be replaced, and no run of fsinfer made it"):
            fuse_scene(tmp_path / "scene", out)
        measure_cloud_file(mine, out, request=ScaleRequest())
    assert mine.read_bytes() == content


def test_a_cloud_of_ours_is_replaced_also_in_a_copy_of_the_folder(scan: Path, tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path / "scene", height=240, width=320))
    out = tmp_path / "out"
    for view in scene.views:
        write_pfm(out / "depth" / f"{view.name}.pfm", np.full((240, 320), 3.0, np.float32))
        write_pfm(out / "confidence" / f"{view.name}.pfm", np.full((240, 320), 0.9, np.float32))
    (out / "depth" / "depth.json").write_text(json.dumps({"pixel_step": 1.0}))
    assert fuse_scene(scene.folder, out).ran
    assert not fuse_scene(scene.folder, out).ran
    shutil.rmtree(out / ".fsinfer")
    assert fuse_scene(scene.folder, out).ran
    # Its trees are those of another cloud, which has no place in the scene.
    measure_cloud_file(scan, out, request=ScaleRequest())
    shutil.rmtree(out / ".fsinfer")
    assert fuse_scene(scene.folder, out).ran


def test_a_folder_that_was_copied_without_its_records_is_ours_by_its_plot(scan: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    measure_cloud_file(scan, out, request=ScaleRequest())
    shutil.rmtree(out / ".fsinfer")
    assert measure_cloud_file(scan, out, request=ScaleRequest()).result.points > 0
    shutil.rmtree(out / ".fsinfer")
    (out / "plot.json").write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match="choose another output folder"):
        measure_cloud_file(scan, out, request=ScaleRequest())


def test_old_figures_of_ours_go_and_other_pictures_stay(scan: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    own = [put(out / "figures" / name) for name in ("fig1_paper.png", "tree_1.png", "tree_001_mine.png")]
    measure_cloud_file(scan, out, request=ScaleRequest())
    old = [put(out / "figures" / name) for name in ("stem_map.png", "tree_009.png", "tree_1009_edges.png")]
    measure_cloud_file(scan, out, request=ScaleRequest(factor=0.99))
    assert all(path.read_text(encoding="utf-8") == "precious" for path in own)
    assert not any(path.exists() for path in old)


def test_the_cloud_is_never_one_of_the_outputs(scan: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    measure_cloud_file(scan, out, request=ScaleRequest())
    cloud = out / "trees.laz"
    before = cloud.read_bytes()
    link = tmp_path / "link.laz"
    link.symlink_to(cloud)
    for path in (cloud, link, out / ".." / "out" / "trees.laz"):
        with pytest.raises(CloudError, match=r"would be replaced by the trees\.laz"):
            measure_cloud_file(path, out, request=ScaleRequest())
    assert cloud.read_bytes() == before
    assert measure_cloud_file(cloud, tmp_path / "other", request=ScaleRequest()).ran

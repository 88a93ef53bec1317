"""Export: every preset passes the checker, agrees with PyTorch, and its manifest guards the files."""

from __future__ import annotations

import json
import shutil
import warnings
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from export.onnx_export import export_model
from export.parity import whole_parity
from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.model import DepthModel
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.view_maps import search_range
from fsinfer.errors import InputError, ModelError
from fsinfer.scene import read_scene
from tests.support.plane_scene import write_plane_scene
from training.checkpoint import load_checkpoint
from training.model import PRESETS, FSMVSNet


@pytest.fixture(scope="module", params=["mvsnet", "paper", "field", "cascade"])
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[FSMVSNet, Path]:
    torch.manual_seed(0)
    model = FSMVSNet(PRESETS[request.param])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own deprecations are not ours to mend
        folder = tmp_path_factory.mktemp(request.param)
        return model.eval(), export_model(model, folder, provenance={"seed": 0})


def test_graphs_hold_192_planes_and_no_batch_norm(exported: tuple[FSMVSNet, Path]) -> None:
    _, manifest = exported
    data = json.loads(manifest.read_text())
    assert data["volume"]["planes"] == 192
    assert data["opset"] >= 18
    assert all(graph["difference_p999_over_largest"] < 1e-4 for graph in data["graphs"].values())
    for graph in data["graphs"].values():
        loaded = onnx.load(manifest.parent / graph["file"])
        assert not any(node.op_type == "BatchNormalization" for node in loaded.graph.node)
    packed = data["volume"]["packed_planes"]
    shape = data["graphs"]["regularizer"]["inputs"]["volume"]
    assert shape[0] * packed == 192 if packed else shape[2] == 192


def test_the_graph_for_tiles_is_given_the_means_over_the_whole(exported: tuple[FSMVSNet, Path]) -> None:
    model, manifest = exported
    data = json.loads(manifest.read_text())
    tiles = data["tiles"]
    assert tiles["difference_p999_over_largest"] < 1e-4
    graph = onnx.load(manifest.parent / tiles["regularizer"]).graph
    means, levels = {
        "field": (["mean0", "mean1", "mean2"], ["level0", "level1", "level2"]),
        "cascade": (["mean0", "mean1", "mean2"], ["level0", "level1", "level2"]),
        "paper": (["volume_mean"], []),
        "mvsnet": ([], []),  # nothing in it is a mean: the regularizer itself serves for tiles
    }[model.config.name]
    assert [item.name for item in graph.input] == ["volume", *means]
    assert [item.name for item in graph.output] == ["index", "confidence", *levels]
    loaded = DepthModel.load(manifest, precision="float32").manifest.tiles
    assert loaded is not None
    assert (len(loaded.level_halos), loaded.volume_mean) == (len(levels), "volume_mean" in means)


def test_the_manifest_says_what_the_volume_holds(exported: tuple[FSMVSNet, Path]) -> None:
    model, path = exported
    data = json.loads(path.read_text())
    manifest = read_manifest(path)
    shape = data["graphs"]["regularizer"]["inputs"]["volume"]
    channels = shape[1] // data["volume"]["packed_planes"] if data["volume"]["packed_planes"] else shape[1]
    assert data["volume"]["channels"] == manifest.groups == channels
    assert "groups" not in data["volume"]
    assert data["parity_confidence_threshold"] == manifest.parity_confidence_threshold == 0.3
    assert manifest.level_channels == (0 if model.config.regularizer == "packed" else 8)
    assert manifest.wide_stride == data["volume"]["stride"] == model.config.wide_stride
    assert (manifest.candidates is None) == (model.config.name != "cascade")
    assert [*manifest.graphs_of(int8=False)] == [*data["graphs"]]
    assert data["tolerances"] == {"depth_rel_p999": 1e-3, "confidence_mask_agreement": 0.999}


def test_a_manifest_of_the_first_version_is_read(exported: tuple[FSMVSNet, Path], tmp_path: Path) -> None:
    _, path = exported
    for file in path.parent.iterdir():
        shutil.copy(file, tmp_path)
    data = json.loads(path.read_text())
    del data["volume"]["channels"], data["weights_sha256"], data["tiles"]
    data["volume"]["groups"] = 4  # whatever the kind of the volume
    data["confidence_threshold"] = data.pop("parity_confidence_threshold")
    old = tmp_path / path.name
    old.write_text(json.dumps(data))
    now, before = read_manifest(path), read_manifest(old)
    assert (before.groups, before.level_channels) == (now.groups, now.level_channels)
    assert before.parity_confidence_threshold == 0.3


def test_whole_depth_map_agrees_with_pytorch(exported: tuple[FSMVSNet, Path], tmp_path: Path) -> None:
    model, manifest = exported
    parity = whole_parity(
        model, DepthModel.load(manifest, precision="float32"), read_scene(write_plane_scene(tmp_path)), views=1
    )
    assert parity.depth_rel_p50 < 1e-5
    if model.config.loss != "plane":
        # Untrained scores have no peak; only the expectation over all planes is stable then.
        assert parity.depth_rel_p999 < 1e-3


def test_a_changed_file_is_refused(exported: tuple[FSMVSNet, Path], tmp_path: Path) -> None:
    _, manifest = exported
    for file in manifest.parent.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    copy = tmp_path / manifest.name
    data = json.loads(copy.read_text())
    tiles = [data["tiles"]["regularizer"]] if "tiles" in data else []
    for name in (data["graphs"]["features"]["file"], *tiles):
        graph = tmp_path / name
        whole = graph.read_bytes()
        graph.write_bytes(whole + b"x")
        with pytest.raises(ModelError, match="damaged or was changed"):
            DepthModel.load(copy)
        graph.write_bytes(whole[:100])
        with pytest.raises(ModelError, match="damaged"):
            DepthModel.load(copy)
        graph.unlink()
        with pytest.raises(ModelError, match="missing"):
            DepthModel.load(copy)
        graph.write_bytes(whole)


def test_a_file_that_is_no_onnx_is_refused_even_with_its_hash(exported: tuple[FSMVSNet, Path], tmp_path: Path) -> None:
    from fsinfer.depth.manifest import hash_files

    _, manifest = exported
    data = json.loads(manifest.read_text())
    data.pop("tiles", None)
    files = []
    for graph in data["graphs"].values():
        (tmp_path / graph["file"]).write_bytes(b"not onnx")
        files.append(tmp_path / graph["file"])
    data["sha256"] = hash_files(files)
    (tmp_path / "m.json").write_text(json.dumps(data))
    with pytest.raises(ModelError, match="onnxruntime"):
        DepthModel.load(tmp_path / "m.json")


def test_unknown_model_names_the_known_ones() -> None:
    with pytest.raises(ModelError, match="no depth model nothing"):
        DepthModel.load("nothing")


def test_a_broken_manifest_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text("{}")
    with pytest.raises(ModelError, match="not a model manifest"):
        DepthModel.load(tmp_path / "m.json")


def test_predict_checks_its_input(exported: tuple[FSMVSNet, Path]) -> None:
    model = DepthModel.load(exported[1])
    image = np.zeros((64, 64, 3), np.uint8)
    k, p = np.eye(3)[None].repeat(2, 0), np.eye(4)[None].repeat(2, 0)
    with pytest.raises(InputError, match="at least one source"):
        model.predict([image], k[:1], p[:1], (1, 2))
    with pytest.raises(InputError, match="near < far"):
        model.predict([image, image], k, p, (2, 1))
    with pytest.raises(InputError, match="uint8"):
        model.predict([image.astype(np.float32), image], k, p, (1, 2))
    with pytest.raises(InputError, match="N,3,3"):
        model.predict([image, image], k[:1], p, (1, 2))


def test_a_checkpoint_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "checkpoint.pt").write_bytes(b"nothing")
    with pytest.raises(ModelError, match=r"training\.train"):
        load_checkpoint(tmp_path / "checkpoint.pt")


def test_depth_ranges_are_opened_to_the_background_and_closed_before_the_lens() -> None:
    settings = DepthSettings(min_far_over_near=7.0, max_far_over_near=30.0)
    assert search_range(1.0, 2.0, settings, inverse_depth=True) == (1.0, 7.0)
    assert search_range(1.0, 2.0, settings, inverse_depth=False) == (1.0, 2.0)
    assert search_range(1.0, 20.0, settings, inverse_depth=True) == (1.0, 20.0)
    assert search_range(0.1, 30.0, settings, inverse_depth=True) == (1.0, 30.0)
    assert search_range(0.1, 30.0, settings, inverse_depth=False) == (0.1, 30.0)

"""Whether a depth is of the surface that its pixel shows: the inputs, the parts of a map, and what ships."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.model import DepthEstimate, DepthModel
from fsinfer.depth.session import Graph
from fsinfer.depth.settings import DepthSettings, SubpixelSettings
from fsinfer.depth.surface import doubted, in_parts, of_parts, surface_inputs
from fsinfer.depth.view_maps import finish_depth
from fsinfer.errors import ModelError
from fsinfer.io.images import read_image
from fsinfer.scene import read_scene
from tests.bench.speed import make_views
from tests.support.plane_scene import write_plane_scene
from training.model import surface as trained

Float32 = NDArray[np.float32]
SIZES = st.tuples(st.integers(1, 9), st.integers(1, 9))


@given(shape=SIZES)
def test_parts_are_the_map_again(shape: tuple[int, int]) -> None:
    values = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    parts = in_parts(values)
    assert parts.shape == (4, -(-shape[0] // 2), -(-shape[1] // 2))
    assert parts[0].tolist() == values[::2, ::2].tolist()
    assert of_parts(parts, shape).tolist() == values.tolist()


@given(shape=SIZES, seed=st.integers(0, 99))
def test_the_inputs_are_those_of_the_training(shape: tuple[int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    height, width = shape
    features = rng.normal(size=(8, height, width)).astype(np.float32)
    index, confidence = (rng.uniform(0, scale, shape).astype(np.float32) for scale in (20, 1))
    found = surface_inputs(features, index, confidence)

    def even(values: Float32) -> torch.Tensor:
        border = [(0, 0)] * (values.ndim - 2) + [(0, height % 2), (0, width % 2)]
        return torch.from_numpy(np.pad(values, border, mode="edge"))[None]

    expected = trained.surface_inputs(even(features), even(index), even(confidence))[0].numpy()
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert found.dtype == np.float32


@pytest.fixture(scope="module")
def model() -> DepthModel:
    return DepthModel.load("cascade", threads=2)


def bark_before(image: NDArray[np.uint8], seed: int) -> NDArray[np.uint8]:
    """A wood that is light and smooth, and a dark furrowed stem before it in columns 200 to 279."""
    rng = np.random.default_rng(seed)
    image[:] = cv2.resize(rng.integers(140, 220, (30, 40, 3), dtype=np.uint8), image.shape[1::-1])
    bark = cv2.resize(rng.integers(20, 90, (60, 40, 3), dtype=np.uint8), (80, image.shape[0]))
    image[:, 200:280] = bark
    return image


@pytest.mark.parametrize("seed", range(3))
def test_a_stem_that_is_carried_on_beyond_its_edge_is_not_believed_there(model: DepthModel, seed: int) -> None:
    image = bark_before(np.zeros((320, 480, 3), np.uint8), seed)
    half = model.features(image).half
    assert half is not None
    index = np.full((160, 240), 30.0, np.float32)
    index[:, 97:143] = 90.0  # in the picture it ends at 100 and 140
    sure = np.full_like(index, 0.8)
    parts = model._sessions["surface"].run_parts(surface_inputs(half.to_chw(), index, sure))
    rows = of_parts(parts, index.shape)[40:120]
    fringe = np.r_[rows[:, 97:99].ravel(), rows[:, 141:143].ravel()]
    assert np.median(rows[:, 108:132]) > 0.9
    assert np.median(fringe) < 0.5 * np.median(rows[:, 102:138])


def test_what_is_likely_of_its_surface_is_as_sure_as_before() -> None:
    surface = np.array([[1.0, 0.5, 0.25, 0.0]], np.float32)
    found = doubted(np.full((1, 4), 0.8, np.float32), surface)
    assert found[0] == pytest.approx([0.8, 0.8, 0.4, 0.0])
    assert found.dtype == np.float32


def test_the_depth_stage_doubts_what_is_not_of_the_surface() -> None:
    depth, confidence = np.full((24, 32), 3.0, np.float32), np.full((24, 32), 0.8, np.float32)
    surface = np.ones((24, 32), np.float32)
    surface[:, 16:] = 0.1
    grey = [np.zeros((48, 64), np.float16)] * 2
    poses = np.stack([np.eye(4)] * 2)
    poses[1, 0, 3] = 0.3
    intrinsics = np.stack([np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])] * 2)

    def sure(told: Float32 | None) -> Float32:
        estimate = DepthEstimate(depth=depth, confidence=confidence, stride=2, surface=told)
        return finish_depth(estimate, grey, intrinsics, poses, curves=None, settings=DepthSettings())[1]

    assert sure(None) == pytest.approx(confidence)
    assert sure(surface)[:, :16] == pytest.approx(confidence[:, :16])
    assert sure(surface)[:, 16:] == pytest.approx(0.2 * confidence[:, 16:])


def test_what_is_found_unsure_after_the_sub_pixel_step_follows_its_surroundings() -> None:
    """The network is sure of all pixels; what it says of their surfaces comes after the first settling."""
    depth, confidence = np.full((24, 32), 3.0, np.float32), np.full((24, 32), 0.9, np.float32)
    depth[:, 14:17] = 5.0
    surface = np.ones((24, 32), np.float32)
    surface[:, 14:16] = 0.05
    grey = [np.zeros((48, 64), np.float16)] * 2
    poses = np.stack([np.eye(4)] * 2)
    poses[1, 0, 3] = 0.3
    intrinsics = np.stack([np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])] * 2)
    estimate = DepthEstimate(depth=depth, confidence=confidence, stride=2, surface=surface)
    settings = DepthSettings(subpixel=SubpixelSettings(rounds=0))
    found, sure = finish_depth(estimate, grey, intrinsics, poses, curves=None, settings=settings)
    assert found[:, 14:16] == pytest.approx(3.0)
    assert found[:, 16] == pytest.approx(5.0)
    assert found[:, 17:] == pytest.approx(3.0)
    assert sure[:, 14:16] == pytest.approx(0.09)


def test_only_a_model_that_has_the_graph_tells() -> None:
    views = make_views(3, 96, 128)
    told = DepthModel.load("cascade", threads=1, precision="float32").predict(*views)
    assert told.surface is not None
    assert told.surface.shape == told.depth.shape
    assert 0 <= told.surface.min() <= told.surface.max() <= 1
    assert read_manifest("field").surface is None
    assert DepthModel.load("field", threads=1, precision="float32").predict(*views).surface is None


def test_the_model_asks_it_of_its_own_map(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path, height=120, width=162))
    cameras = [view.camera for view in scene.views]
    network = DepthModel.load("cascade", threads=1, precision="float32", calibrate=False)
    features = [network.features(read_image(view.image_path)) for view in scene.views]
    near, far = cameras[0].depth_min, cameras[0].depth_max
    intrinsics, poses = np.stack([c.intrinsic for c in cameras]), np.stack([c.cam_from_world for c in cameras])
    told = network.predict_from_features(features, intrinsics, poses, (near, far))
    index = np.asarray(191 * (1 / told.depth - 1 / far) / (1 / near - 1 / far), np.float32)
    assert np.ptp(index) > 3  # the sources do not show all of it
    assert features[0].half is not None
    assert told.surface is not None
    parts = network._sessions["surface"].run_parts(surface_inputs(features[0].half.to_chw(), index, told.confidence))
    np.testing.assert_allclose(told.surface, of_parts(parts, index.shape), atol=0.01)


@pytest.mark.parametrize("given", [[np.zeros((4, 5, 7))], [np.zeros((3, 5, 6))], [np.zeros((4, 5, 6))] * 2])
def test_a_graph_that_gives_something_else_is_one_message(given: list[NDArray[np.float64]]) -> None:
    graph = Graph(Path("x_surface.onnx"), SimpleNamespace(run=lambda *_: given))
    with pytest.raises(ModelError, match=r"x_surface\.onnx gives .*re-export"):
        graph.run_parts(np.zeros((48, 5, 6), np.float32))

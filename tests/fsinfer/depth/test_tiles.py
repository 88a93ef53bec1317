"""Depth in tiles against depth as a whole."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fsinfer.depth.job as depth_job
from fsinfer.depth.manifest import models_folder, read_manifest
from fsinfer.depth.maps import read_depth_index
from fsinfer.depth.memory import DepthPlan
from fsinfer.depth.model import DepthEstimate, DepthModel
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.stage import estimate_depth
from fsinfer.depth.tiles import TiledDepth, cut
from fsinfer.errors import ModelError
from fsinfer.io.images import read_image
from fsinfer.io.pfm import read_pfm
from fsinfer.scene import read_scene
from tests.bench.speed import make_views
from tests.support.plane_scene import write_plane_scene

pytestmark = pytest.mark.skipif(
    not (models_folder() / "field.json").is_file(), reason="the depth model is not in this source tree"
)


@given(
    length=st.integers(1, 700),
    size=st.integers(1, 20).map(lambda n: 8 * n),
    halo=st.integers(0, 8).map(lambda n: 8 * n),
)
def test_spans_share_out_the_whole_and_see_their_surroundings(length: int, size: int, halo: int) -> None:
    spans = cut(length, size=size, halo=halo, align=8)
    assert [index for span in spans for index in range(span.inner_start, span.inner_stop)] == [*range(length)]
    for span in spans:
        assert span.outer_start % 8 == 0
        assert span.inner_start % 8 == 0
        assert span.inner_stop - span.inner_start <= size
        assert span.outer_start == max(span.inner_start - halo, 0)
        assert span.outer_stop >= min(span.inner_stop + halo, length)
        for stride in (2, 4, 8):
            # The levels' own parts share out the level, too.
            own = span.own(stride)
            assert own.stop - own.start == -(-span.inner_stop // stride) - span.inner_start // stride


def test_spans_are_aligned_or_refused() -> None:
    for size, halo in ((12, 8), (16, 4), (0, 8)):
        with pytest.raises(ValueError, match="multiples of 8"):
            cut(100, size=size, halo=halo, align=8)


@pytest.fixture(scope="module")
def whole() -> DepthEstimate:
    return DepthModel.load("field", threads=2, precision="float32").predict(*make_views(3, 534, 618))


def in_tiles(*, keeps_volume: bool = True, halo: int | None = None) -> DepthEstimate:
    model = DepthModel.load("field", threads=2, precision="float32")
    if halo is not None:
        assert model.manifest.tiles is not None
        model.manifest = replace(model.manifest, tiles=replace(model.manifest.tiles, halo=halo))
    images, intrinsics, poses, depth_range = make_views(3, 534, 618)
    tiled = TiledDepth(model, 64, keeps_volume=keeps_volume)
    return tiled.predict_from_features([model.features(image) for image in images], intrinsics, poses, depth_range)


def differing(a: DepthEstimate, b: DepthEstimate) -> float:
    """Share of the pixels whose depth differs by more than the order of sums explains."""
    assert a.depth.shape == b.depth.shape == a.confidence.shape == b.confidence.shape
    assert a.stride == b.stride
    return float((np.abs(a.depth / b.depth - 1) > 1e-4).mean())


@pytest.mark.parametrize("keeps_volume", [True, False])
def test_tiles_give_the_depth_of_the_whole(whole: DepthEstimate, keeps_volume: bool) -> None:
    tiled = in_tiles(keeps_volume=keeps_volume)
    # Where two planes are as good as each other, rounding decides.
    assert differing(tiled, whole) < 1e-4
    assert np.quantile(np.abs(tiled.confidence - whole.confidence), 0.999) < 1e-4


@pytest.mark.parametrize("keeps_volume", [True, False])
def test_tiles_of_a_volume_at_an_eighth_give_the_depth_of_the_whole(tmp_path: Path, keeps_volume: bool) -> None:
    # Not noise, in which two planes are as good as each other: one cell that rounding decides is seen all round it.
    # Odd sizes: the last pixel of the volume stands for one at a quarter alone.
    scene = read_scene(write_plane_scene(tmp_path, height=534, width=618))
    group = [scene.views[0], *(scene.views[i] for i in scene.views[0].sources)]
    model = DepthModel.load("cascade", threads=2, precision="float32")
    features = [model.features(read_image(view.image_path)) for view in group]
    cameras = [view.camera for view in group]
    given = (
        np.stack([camera.intrinsic for camera in cameras]),
        np.stack([camera.cam_from_world for camera in cameras]),
        (cameras[0].depth_min, cameras[0].depth_max),
    )
    whole = model.predict_from_features(features, *given)
    tiled = TiledDepth(model, 24, keeps_volume=keeps_volume).predict_from_features(features, *given)
    assert differing(tiled, whole) < 1e-4
    assert np.quantile(np.abs(tiled.confidence - whole.confidence), 0.999) < 1e-4
    assert tiled.surface is not None
    assert whole.surface is not None
    assert np.quantile(np.abs(tiled.surface - whole.surface), 0.999) < 1e-4
    assert model.manifest.tiles is not None
    model.manifest = replace(model.manifest, tiles=replace(model.manifest.tiles, halo=8))
    narrow = TiledDepth(model, 24, keeps_volume=keeps_volume).predict_from_features(features, *given)
    assert differing(narrow, whole) > 1e-4


def test_a_halo_narrower_than_what_the_network_sees_shows(whole: DepthEstimate) -> None:
    assert differing(in_tiles(halo=8), whole) > 1e-3


def test_int8_has_no_tiles() -> None:
    if read_manifest("field").int8_regularizer is None:
        pytest.skip("the shipped model has no int8 regularizer")
    with pytest.raises(ModelError, match="int8"):
        TiledDepth(DepthModel.load(threads=1, precision="int8"), 64)


def test_the_depth_stage_cuts_what_does_not_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    scene = read_scene(write_plane_scene(tmp_path / "scene"))
    settings = DepthSettings(source_views=2, threads=2, precision="float32")
    estimate_depth(scene, tmp_path / "whole", settings=settings)
    assert "tiles" not in caplog.text
    plan = DepthPlan(cached_views=3, peak_bytes=0, tile_size=16)
    monkeypatch.setattr(depth_job, "plan_depth", lambda *_, **__: plan)
    for precision in ("float32", "auto"):
        # Tiles are float32, whatever this processor would do otherwise, and the result says so.
        result = estimate_depth(scene, tmp_path / precision, settings=replace(settings, precision=precision))
        assert result.precision == "float32"
        assert read_depth_index(tmp_path / precision)["model_sha256"] == read_manifest(settings.model).sha256
        assert "computed in tiles" in caplog.text
        for view in scene.views:
            tiled, whole = (
                read_pfm(tmp_path / folder / "depth" / f"{view.name}.pfm") for folder in (precision, "whole")
            )
            assert (np.abs(tiled / whole - 1) > 1e-4).mean() < 1e-3

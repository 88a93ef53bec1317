"""What depth and fusion take, and how they adapt to a limit."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import Any

import pytest

from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.memory import DepthPlan, plan_depth
from fsinfer.errors import InputError
from fsinfer.fusion.memory import FusionPlan, plan_fusion

#: What the shipped model says of itself.
FIELD: dict[str, Any] = {"planes": 192, "groups": 4, "feature_channels": 16, "refine_channels": 8}


def _depth(memory_gb: float, width: int = 1280, height: int = 720) -> DepthPlan:
    return plan_depth(memory_gb, width=width, height=height, **FIELD, views=5, most_cached=24)


def _fusion(memory_gb: float) -> FusionPlan:
    return plan_fusion(memory_gb, map_pixels=640 * 360, cache_maps=40, max_points=4_000_000, batch_points=1_500_000)


def test_a_common_photo_has_everything_kept_in_three_gigabytes() -> None:
    plan = _depth(3.0)
    assert plan.cached_views == 24
    assert 1.5e9 < plan.peak_bytes < 2.5e9


def test_the_feature_maps_are_as_large_as_the_model_says() -> None:
    manifest = read_manifest("field")
    told = {name: getattr(manifest, name) for name in FIELD}
    assert told == FIELD
    wide = plan_depth(
        3.0, width=640, height=480, views=5, most_cached=24, **FIELD | {"feature_channels": 32, "refine_channels": 0}
    )
    assert wide.cached_views == 24
    known = plan_depth(3.0, width=640, height=480, views=5, most_cached=24, **FIELD)
    # float32 at a quarter and at half resolution.
    assert known.peak_bytes - wide.peak_bytes == 24 * 4 * 160 * 120 * (16 + 4 * 8 - 32)


def test_int8_takes_less() -> None:
    whole = plan_depth(3.0, width=1920, height=1080, **FIELD, views=5, most_cached=24, int8=True)
    assert whole.tile_size == 0
    with pytest.raises(InputError):
        _depth(3.0, 1920, 1080)


def test_less_memory_keeps_fewer_maps_and_stays_within() -> None:
    generous, tight = _depth(3.0), _depth(1.7)
    assert 5 <= tight.cached_views < generous.cached_views
    assert tight.peak_bytes <= 1.7e9


def test_photos_that_do_not_fit_are_told_the_size_that_does() -> None:
    with pytest.raises(InputError, match="--max-size") as error:
        _depth(3.0, 4000, 3000)
    found = re.search(r"--max-size (\d+)", str(error.value))
    assert found is not None
    size = int(found[1])
    assert size > 1000
    assert _depth(3.0, size, size * 3 // 4).peak_bytes <= 3e9
    with pytest.raises(InputError, match=r"larger --memory-gb$"):
        _depth(0.1)


def test_photos_that_do_not_fit_are_cut_into_the_largest_tiles_that_do() -> None:
    def tiled(memory_gb: float, width: int = 1600, height: int = 1200) -> DepthPlan:
        return plan_depth(memory_gb, width=width, height=height, **FIELD, views=5, most_cached=24, tile_halo=56)

    assert tiled(4.0).tile_size == 0
    sizes = []
    for memory_gb in (3.0, 2.5, 2.0):
        plan = tiled(memory_gb)
        sizes.append(plan.tile_size)
        assert plan.peak_bytes <= memory_gb * 1e9
        assert plan.keeps_volume
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == len(sizes)
    assert sizes[-1] >= 64
    # A volume too large to be kept.
    assert not tiled(4.0, 4000, 3000).keeps_volume
    with pytest.raises(InputError, match="--memory-gb"):
        tiled(1.0)


def test_fusion_shrinks_its_batches_before_it_drops_points() -> None:
    assert _fusion(3.0) == FusionPlan(
        cache_maps=40, batch_points=1_500_000, max_points=4_000_000, peak_bytes=_fusion(3.0).peak_bytes
    )
    smaller = _fusion(1.7)
    assert smaller.batch_points < 1_500_000
    assert smaller.max_points == 4_000_000
    least = _fusion(0.8)
    assert least.max_points < 4_000_000
    for limit in (3.0, 1.7, 0.8):
        assert _fusion(limit).peak_bytes <= limit * 1e9
    with pytest.raises(InputError, match="too few"):
        _fusion(0.25)


_WHOLE = f"""
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 256, 512)
model = DepthModel.load(threads=2, precision="float32")
for _ in range(2):
    model.predict(images, intrinsics, poses, depth_range)
plan = plan_depth(3.0, width=512, height=256, **{FIELD}, views=3, most_cached=3)
"""
_PEAK = """
# Not ru_maxrss, which begins at what the program that started this one had at that time.
import pathlib
status = pathlib.Path("/proc/self/status").read_text()
peak_kib = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
print(plan.peak_bytes, peak_kib * 1024)
"""
_INT8 = f"""
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 512, 960)
model = DepthModel.load(threads=2, precision="int8")
model.predict(images, intrinsics, poses, depth_range)
plan = plan_depth(3.0, width=960, height=512, **{FIELD}, views=3, most_cached=3, int8=True)
"""
_TILED = f"""
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 800, 1280)
model = DepthModel.load(threads=2, precision="float32")
plan = plan_depth(1.4, width=1280, height=800, **{FIELD}, views=3, most_cached=3, tile_halo=56)
from fsinfer.depth.tiles import TiledDepth
assert plan.tile_size and plan.keeps_volume
tiled = TiledDepth(model, plan.tile_size)
tiled.predict_from_features([model.features(image) for image in images], intrinsics, poses, depth_range)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("program", [_WHOLE, _INT8, _TILED])
def test_the_estimate_is_that_of_a_real_run(program: str) -> None:
    done = subprocess.run([sys.executable, "-c", program + _PEAK], capture_output=True, text=True, check=True)
    expected, found = (int(word) for word in done.stdout.split())
    assert 0.7 * expected < found < 1.15 * expected

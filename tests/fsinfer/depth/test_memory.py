"""What depth and fusion take, and how they adapt to a limit."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fsinfer.depth import stage
from fsinfer.depth.job import plan_job
from fsinfer.depth.manifest import read_manifest
from fsinfer.depth.maps import DepthMaps
from fsinfer.depth.memory import DepthPlan, plan_depth
from fsinfer.depth.settings import DepthSettings
from fsinfer.errors import InputError, SceneError
from fsinfer.fusion.fuse import FusionSettings, most_points
from fsinfer.fusion.memory import FusionPlan, plan_fusion
from fsinfer.io.pfm import write_pfm
from fsinfer.scene import Camera, View, read_scene
from tests.support.plane_scene import write_plane_scene

#: What the shipped model says of itself.
FIELD: dict[str, Any] = {"planes": 192, "groups": 4, "feature_channels": 16, "refine_channels": 8}
#: What fusion would like.
WANTED: dict[str, Any] = {"cache_maps": 40, "max_points": 4_000_000, "batch_points": 1_500_000, "at_once": 4}


def _depth(memory_gb: float, width: int = 1280, height: int = 720) -> DepthPlan:
    return plan_depth(memory_gb, width=width, height=height, **FIELD, views=5, most_cached=24)


def _fusion(memory_gb: float) -> FusionPlan:
    return plan_fusion(memory_gb, map_pixels=640 * 360, photo_pixels=1280 * 720, **WANTED)


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


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_the_largest_photo_of_a_mixed_capture_is_planned_for(tmp_path: Path, order: tuple[int, ...]) -> None:
    camera = Camera(intrinsic=np.eye(3), cam_from_world=np.eye(4), depth_min=1.0, depth_max=9.0)
    views = []
    for number, size in enumerate(((640, 480), (720, 1280), (1600, 600))):
        path = tmp_path / f"{number}.png"
        Image.new("L", size).save(path)
        views.append(View(name=path.stem, image_path=path, camera=camera, sources=(0,)))
    settings = DepthSettings(precision="float32", memory_gb=3.0, max_size_px=1280)
    job = plan_job([views[number] for number in order], settings)
    # The widest one is reduced, to fewer pixels than the one that is held upright.
    assert (job.width, job.height) == (720, 1280)
    assert job.plan == plan_job([views[1]], settings).plan
    assert job.plan.peak_bytes > plan_job([views[0]], settings).plan.peak_bytes


def test_photos_that_are_compared_only_are_planned_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = read_scene(write_plane_scene(tmp_path / "scene"))
    Image.new("L", (280, 216)).save(scene.views[2].image_path)
    alone = replace(scene.views[2], sources=())
    scene = replace(scene, views=(replace(scene.views[0], sources=(2,)), replace(scene.views[1], sources=(0,)), alone))

    class PlannedError(Exception):
        pass

    def planned(views: Sequence[View], _settings: DepthSettings) -> None:
        raise PlannedError([view.name for view in views])

    monkeypatch.setattr(stage, "plan_job", planned)
    with pytest.raises(PlannedError, match=r"'0', '2', '1'"):
        stage.estimate_depth(scene, tmp_path)


def test_the_largest_depth_map_is_planned_for(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path / "scene"))
    for view, shape in zip(scene.views, ((10, 20), (300, 200), (200, 200)), strict=True):
        write_pfm(tmp_path / "depth" / f"{view.name}.pfm", np.ones(shape, np.float32))
    (tmp_path / "depth" / "depth.json").write_text('{"pixel_step": 1}')
    maps = DepthMaps(scene, tmp_path)
    assert maps.most_pixels() == 60_000
    tight = FusionSettings(memory_gb=1.0)
    known = plan_fusion(1.0, map_pixels=60_000, photo_pixels=60_000, **WANTED)
    assert most_points(scene, tmp_path, settings=tight) == known.max_points < 4_000_000
    (tmp_path / "depth" / "1.pfm").write_bytes(b"Pf\n300 200\n-1.0\n")
    with pytest.raises(SceneError, match=r"1\.pfm is not a complete"):
        maps.most_pixels()


def test_the_photographs_of_other_programs_are_planned_for_at_their_size(tmp_path: Path) -> None:
    """They are fused as they are, of a mirrorless camera with 39 megapixels."""
    scene = read_scene(write_plane_scene(tmp_path / "scene"))
    for view in scene.views:
        write_pfm(tmp_path / "depth" / f"{view.name}.pfm", np.ones((480, 640), np.float32))
    index = tmp_path / "depth" / "depth.json"
    tight, points = FusionSettings(memory_gb=1.0), {}
    for megapixels, step in ((1.2, 2.0), (39.0, 11.25)):
        index.write_text(f'{{"pixel_step": {step}}}')
        maps = DepthMaps(scene, tmp_path)
        assert maps.most_photo_pixels() == pytest.approx(megapixels * 1e6, rel=0.03)
        points[megapixels] = most_points(scene, tmp_path, settings=tight)
    assert points[39.0] < points[1.2] - 600_000
    plan = plan_fusion(1.0, map_pixels=640 * 480, photo_pixels=39_000_000, **WANTED)
    assert plan.at_once == 1
    assert plan.peak_bytes <= 1e9
    # As a run has them.
    assert plan_fusion(3.0, map_pixels=640 * 480, photo_pixels=2016 * 1512, **WANTED).at_once == 4


@pytest.mark.parametrize("megapixels", [24, 50, 100, 200])
def test_who_gives_too_little_for_large_photographs_is_told_what_is_enough(megapixels: int) -> None:
    """One gigabyte is not, of a hundred megapixels."""
    sizes: dict[str, Any] = {"map_pixels": 640 * 480, "photo_pixels": megapixels * 1_000_000, **WANTED}
    with pytest.raises(InputError, match="too few") as caught:
        plan_fusion(0.4, **sizes)
    enough = float(str(caught.value).split("give ")[1].split()[0])
    assert plan_fusion(enough, **sizes).max_points >= 250_000


def test_int8_takes_less() -> None:
    whole = plan_depth(3.0, width=2400, height=1350, **FIELD, views=5, most_cached=24, int8=True)
    assert whole.tile_size == 0
    with pytest.raises(InputError):
        _depth(3.0, 2400, 1350)


def test_a_volume_at_an_eighth_takes_less() -> None:
    def plan(wide_stride: int, *, int8: bool, most: int = 8) -> DepthPlan:
        sizes: dict[str, Any] = {"width": 1280, "height": 720, **FIELD, "views": 5, "most_cached": 10}
        return plan_depth(3.0, **sizes, wide_stride=wide_stride, int8=int8, most_at_once=most)

    # In int8 what is asked of the surface, in 32 bits, weighs as much as a fourteenth of it.
    for int8, share in ((False, 0.7), (True, 0.75)):
        of_one = [plan(stride, int8=int8, most=1).peak_bytes for stride in (8, 4)]
        assert of_one[0] < share * of_one[1]
    # What follows the regularizer takes as much: no map waits for another's.
    many = plan(8, int8=True)
    assert many.regularizers == many.at_once >= plan(4, int8=True).at_once > 1


def test_as_many_maps_are_computed_at_a_time_as_memory_allows() -> None:
    def plan(memory_gb: float, most: int, **options: Any) -> DepthPlan:
        sizes: dict[str, Any] = {"width": 1280, "height": 720, **FIELD, "views": 5, "most_cached": 24, "int8": True}
        return plan_depth(memory_gb, **sizes | options, most_at_once=most)

    assert plan(3.0, 1).at_once == 1
    two, many = plan(3.0, 2), plan(3.0, 8)
    assert (two.at_once, two.regularizers) == (2, 1)
    assert (many.at_once, many.regularizers) == (6, 2)
    assert two.peak_bytes < many.peak_bytes <= 3e9
    # Each has all the feature maps that it needs.
    assert many.cached_views >= 6 * 5
    assert plan(0.9, 2).at_once == 1
    exact = plan(3.0, 2, int8=False)
    assert (exact.at_once, exact.regularizers) == (2, 1)
    assert plan(3.0, 4, int8=False).at_once == 3
    assert plan(3.0, 8, width=640, height=360).at_once == 8
    # A regularizer of 3D convolutions is nearly all of the work.
    assert plan(8.0, 8, groups=32, level_channels=8, int8=False).at_once == 1
    tiled = plan(1.4, 8, width=1280, height=800, int8=False, tile_halo=56)
    assert tiled.tile_size
    assert tiled.at_once == 1


def test_processes_where_there_is_memory_for_two() -> None:
    def plan(memory_gb: float, most: int, *, apart: bool = True) -> DepthPlan:
        sizes: dict[str, Any] = {"width": 1280, "height": 720, **FIELD, "wide_stride": 8, "views": 5, "most_cached": 20}
        return plan_depth(memory_gb, **sizes, int8=True, most_at_once=most, apart=apart)

    assert plan(3.0, 2, apart=False).processes == 1
    two = plan(3.0, 2)
    assert (two.processes, two.at_once, two.regularizers, two.cached_views) == (2, 2, 2, 13)
    # The run itself holds little, each of them what one alone does, with fewer feature maps.
    one = plan(3.0, 1)
    assert one.processes == 1
    assert 2 * 0.8 * one.peak_bytes < two.peak_bytes < 2 * one.peak_bytes + 150e6
    many = plan(3.0, 16)
    assert 2 < many.processes == many.at_once < 16
    assert many.peak_bytes <= 3e9 < many.peak_bytes * (many.processes + 1) / many.processes
    little = plan(0.9 * two.peak_bytes / 1e9, 2)
    assert little.processes == 1
    assert little.at_once == 2


def test_less_memory_keeps_fewer_maps_and_stays_within() -> None:
    generous, tight = _depth(3.0), _depth(1.4)
    assert 5 <= tight.cached_views < generous.cached_views
    assert tight.peak_bytes <= 1.4e9


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
    for memory_gb in (2.5, 2.2, 1.9):
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
        cache_maps=40,
        at_once=4,
        ahead=8,
        batch_points=1_500_000,
        max_points=4_000_000,
        peak_bytes=_fusion(3.0).peak_bytes,
    )
    smaller = _fusion(1.7)
    assert smaller.batch_points < 1_500_000
    # Views wait to be merged in what nothing else asks for.
    assert smaller.ahead == 0
    assert smaller.max_points == 4_000_000
    least = _fusion(0.8)
    assert least.max_points < 4_000_000
    assert least.cache_maps < 40
    large = plan_fusion(2.0, map_pixels=3_000_000, photo_pixels=12_000_000, **WANTED)
    assert (large.at_once, large.cache_maps) == (1, 4)
    for limit in (3.0, 1.7, 0.8):
        assert _fusion(limit).peak_bytes <= limit * 1e9
    with pytest.raises(InputError, match="too few"):
        _fusion(0.25)


_WHOLE = f"""
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 256, 512)
model = DepthModel.load("field", threads=2, precision="float32")
for _ in range(2):
    model.predict_from_features([model.features(image) for image in images], intrinsics, poses, depth_range)
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
model = DepthModel.load("field", threads=2, precision="int8")
model.predict_from_features([model.features(image) for image in images], intrinsics, poses, depth_range)
plan = plan_depth(3.0, width=960, height=512, **{FIELD}, views=3, most_cached=3, int8=True)
"""
_TWO = f"""
import threading
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 512, 960)
model = DepthModel.load("field", threads=1, precision="int8")
work = [threading.Thread(target=model.predict, args=(images, intrinsics, poses, depth_range)) for _ in range(2)]
[one.start() for one in work]
[one.join() for one in work]
plan = plan_depth(3.0, width=960, height=512, **{FIELD}, views=3, most_cached=3, int8=True, most_at_once=2)
assert plan.at_once == 2
"""
_FOUR = f"""
import threading
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 352, 640)
plan = plan_depth(3.0, width=640, height=352, **{FIELD}, views=3, most_cached=3, int8=True, most_at_once=4)
assert (plan.at_once, plan.regularizers) == (4, 2)
model = DepthModel.load("field", threads=1, precision="int8", regularizers=plan.regularizers)
for _ in range(2):
    work = [threading.Thread(target=model.predict, args=(images, intrinsics, poses, depth_range)) for _ in range(4)]
    [one.start() for one in work]
    [one.join() for one in work]
"""
_TWO_FLOAT = f"""
import threading
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 352, 640)
model = DepthModel.load("field", threads=1, precision="float32")
for _ in range(2):
    work = [threading.Thread(target=model.predict, args=(images, intrinsics, poses, depth_range)) for _ in range(2)]
    [one.start() for one in work]
    [one.join() for one in work]
plan = plan_depth(3.0, width=640, height=352, **{FIELD}, views=3, most_cached=3, most_at_once=2)
assert (plan.at_once, plan.regularizers) == (2, 1)
"""
_TILED = f"""
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 800, 1280)
model = DepthModel.load("field", threads=2, precision="float32")
plan = plan_depth(1.4, width=1280, height=800, **{FIELD}, views=3, most_cached=3, tile_halo=56)
from fsinfer.depth.tiles import TiledDepth
assert plan.tile_size and plan.keeps_volume
tiled = TiledDepth(model, plan.tile_size)
tiled.predict_from_features([model.features(image) for image in images], intrinsics, poses, depth_range)
"""
# A volume at an eighth of the resolution: two maps at a time.
_EIGHTHS = f"""
import threading
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 512, 960)
model = DepthModel.load("cascade", threads=1, precision="int8", regularizers=2)
for _ in range(3):  # the two need not be at their peaks at the same time
    work = [threading.Thread(target=model.predict, args=(images, intrinsics, poses, depth_range)) for _ in range(2)]
    [one.start() for one in work]
    [one.join() for one in work]
sizes = dict(width=960, height=512, **{FIELD}, wide_stride=8, views=3, most_cached=3)
plan = plan_depth(3.0, **sizes, int8=True, most_at_once=2)
assert (plan.at_once, plan.regularizers) == (2, 2)
"""
_EIGHTHS_FLOAT = f"""
from fsinfer.depth.model import DepthModel
from fsinfer.depth.memory import plan_depth
from tests.bench.speed import make_views
images, intrinsics, poses, depth_range = make_views(3, 512, 960)
model = DepthModel.load("cascade", threads=1, precision="float32")
for _ in range(2):
    model.predict_from_features([model.features(image) for image in images], intrinsics, poses, depth_range)
plan = plan_depth(3.0, width=960, height=512, **{FIELD}, wide_stride=8, views=3, most_cached=3)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(
    "program",
    [_WHOLE, _INT8, _TWO, _FOUR, _TWO_FLOAT, _TILED, _EIGHTHS, _EIGHTHS_FLOAT],
)
def test_the_estimate_is_that_of_a_real_run(program: str) -> None:
    done = subprocess.run([sys.executable, "-c", program + _PEAK], capture_output=True, text=True, check=True)
    expected, found = (int(word) for word in done.stdout.split())
    assert 0.7 * expected < found < 1.15 * expected

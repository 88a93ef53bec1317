"""The DTU training release: splits, files, cameras and depths, on a rig of three views before a plane."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.io.images import write_image
from fsinfer.io.pfm import write_pfm
from training.data.dtu import SCANS, TEST_SCANS, TRAIN_SCANS, VALIDATION_SCANS, DtuScan, dtu_root, spread
from training.data.find import find_true_scenes
from training.data.samples import Sample, SamplingSettings, SceneSamples
from training.evaluate import evaluate_scene, main
from training.train import Trainer
from training.train_settings import TrainSettings

PLAIN = SamplingSettings(
    min_sources=2, max_sources=2, colour_jitter=0, range_jitter=0, near_pull=1, mirror=0, turn=0, pose_noise_px=0
)
FOCAL_PX = 1446.165  # of the 640x512 photographs
PLANE_MM = 600.0
SHIFT_PX = 8  # of the plane from one view to the next


def write_scan(root: Path, scan: int, lights: tuple[int, ...]) -> None:
    """Photographs 40 grey levels brighter from light to light, quarter-size depths, the left 8 columns masked."""
    rng = np.random.default_rng(scan)
    texture = rng.integers(0, 60, (64, 88, 3), dtype=np.uint8).repeat(8, axis=0).repeat(8, axis=1)
    for view in range(3):
        part = texture[:, SHIFT_PX * view : SHIFT_PX * view + 640]
        for light in lights:
            image = np.ascontiguousarray(part + np.uint8(40 * light))
            name = f"rect_{view + 1:03d}_{light}_r5000.png"
            write_image(root / "Rectified" / f"scan{scan}_train" / name, image)
        folder = root / "Depths" / f"scan{scan}_train"
        write_pfm(folder / f"depth_map_{view:04d}.pfm", np.full((128, 160), PLANE_MM, np.float32))
        mask = np.full((128, 160), 255, np.uint8)
        mask[:, :8] = 10
        mask[:, 8] = 11
        cv2.imwrite(str(folder / f"depth_visual_{view:04d}.png"), mask)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """scan2 (training) in lights 0 and 3, scan3 (validation) in light 3; text files as the release has them."""
    folder = tmp_path_factory.mktemp("mvs_training") / "dtu"
    write_scan(folder, 2, (0, 3))
    write_scan(folder, 3, (3,))
    (folder / "Cameras" / "train").mkdir(parents=True)
    for view in range(3):
        x = -PLANE_MM / FOCAL_PX * SHIFT_PX * view
        (folder / "Cameras" / "train" / f"{view:08d}_cam.txt").write_text(
            f"extrinsic\n1.0 0.0 0.0 {x} \n0.0 1.0 0.0 0.0 \n0.0 0.0 1.0 0.0 \n0.0 0.0 0.0 1.0 \n\n"
            "intrinsic\n361.54125 0.0 82.900625 \n0.0 360.3975 66.383875 \n0.0 0.0 1.0 \n\n425.0 2.5\n"
        )
    (folder / "Cameras" / "pair.txt").write_text("3\n0\n2 1 2036.5 2 1243.9 \n1\n2 0 2 2 1 \n2\n2 1 2 0 1 \n")
    return folder


@pytest.fixture
def copy(root: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(root, tmp_path / "dtu"))


def test_the_split_has_its_sizes_and_shares_no_scan() -> None:
    assert [len(SCANS[split]) for split in ("train", "validation", "test")] == [79, 18, 22]
    scans = {*TRAIN_SCANS, *VALIDATION_SCANS, *TEST_SCANS}
    assert len(scans) == 79 + 18 + 22
    assert scans <= set(range(1, 129))


def test_scans_are_listed_by_split_and_light(root: Path) -> None:
    assert dtu_root(root) == dtu_root(root.parent) == root
    assert dtu_root(root / "Cameras") is None
    assert [s.name for s in find_true_scenes([root])] == ["scan2 light 0", "scan2 light 3"]
    assert [s.name for s in find_true_scenes([root.parent], "validation")] == ["scan3 light 3"]
    with pytest.raises(SceneError, match="no scan of the test split"):
        find_true_scenes([root], "test")


def test_cameras_are_those_of_the_photographs(root: Path) -> None:
    scene = DtuScan(root=root, scan=2, light=3).read()
    camera = scene.views[2].camera
    expected = np.array([[1446.165, 0, 331.6025], [0, 1441.59, 265.5355], [0, 0, 1]])
    np.testing.assert_allclose(camera.intrinsic, expected)
    assert camera.cam_from_world[0, 3] == pytest.approx(-16 * PLANE_MM / FOCAL_PX)
    assert camera.depth_min == 425
    assert camera.depth_max == pytest.approx(425 + 191 * 2.65)
    assert scene.views[2].image_path.name == "rect_003_3_r5000.png"
    assert [view.sources for view in scene.views] == [(1, 2), (0, 2), (1, 0)]


def test_only_what_the_mask_shows_has_a_depth(root: Path) -> None:
    scan = DtuScan(root=root, scan=2, light=0)
    depth = scan.true_depth(scan.read().views[0])
    assert depth.shape == (512, 640)
    assert not depth[:, :32].any()  # mask 10
    assert (depth[:508, 32:636] == PLANE_MM).all()  # mask 11 and more
    assert (depth[508, 32::4] == PLANE_MM).all()  # the last row of the small map
    assert not depth[509:].any()  # beyond it nothing is known


def test_depths_out_of_the_range_are_unknown(copy: Path) -> None:
    depth = np.full((128, 160), 931.0, np.float32)  # 425 + 191 * 2.65 = 931.15
    depth[:, 80:] = 932
    depth[0] = np.nan
    write_pfm(copy / "Depths" / "scan2_train" / "depth_map_0000.pfm", depth)
    scan = DtuScan(root=copy, scan=2, light=0)
    found = scan.true_depth(scan.read().views[0])
    assert found[100, 200] == 931
    assert not found[:, 320:].any()
    assert not found[:4].any()


def tilted(step: float, height: int, width: int) -> NDArray[np.float64]:
    """z depth of the plane 0.6 X + 0.3 Y + Z = 600 at every ``step``-th pixel of the photograph."""
    u, v = np.meshgrid(np.arange(width) * step, np.arange(height) * step)
    depth: NDArray[np.float64] = 600 / (1 + 0.6 * (u - 331.6) / FOCAL_PX + 0.3 * (v - 265.5) / FOCAL_PX)
    return depth


def test_between_the_small_maps_pixels_runs_their_plane() -> None:
    small = tilted(4, 16, 20).astype(np.float32)
    full = spread(small)
    np.testing.assert_allclose(full[:60, :76], tilted(1, 60, 76), rtol=1e-6)
    assert not full[61:].any()
    small[:, 10:] += 50  # a step: the pixels between the two surfaces belong to neither
    full = spread(small)
    assert not full[1:4, 37:40].any()
    assert full[0, 36] == small[0, 9]
    assert full[0, 40] == small[0, 10]


def test_full_size_depths_are_preferred_halved_and_cut(copy: Path) -> None:
    x, y = np.meshgrid(np.arange(1600), np.arange(1200))
    folder = copy / "Depths_raw" / "scan2"
    write_pfm(folder / "depth_map_0001.pfm", (500 + x / 8 + y / 16).astype(np.float32))
    mask = np.full((1200, 1600), 255, np.uint8)
    mask[88, 162] = 0
    cv2.imwrite(str(folder / "depth_visual_0001.png"), mask)
    scan = DtuScan(root=copy, scan=2, light=0)
    depth = scan.true_depth(scan.read().views[1])
    assert depth.shape == (512, 640)
    assert depth[0, 0] == 500 + 160 / 8 + 88 / 16  # photograph pixel (0, 0) is (160, 88) of the full size
    assert depth[0, 1] == 0
    assert depth[511, 639] == 500 + (160 + 2 * 639) / 8 + (88 + 2 * 511) / 16


def test_missing_parts_are_errors_that_name_them(copy: Path) -> None:
    scan = DtuScan(root=copy, scan=2, light=0)
    view = scan.read().views[0]
    (copy / "Depths" / "scan2_train" / "depth_visual_0000.png").unlink()
    with pytest.raises(SceneError, match="depth_visual_0000"):
        scan.true_depth(view)
    write_pfm(copy / "Depths" / "scan2_train" / "depth_map_0000.pfm", np.ones((100, 100), np.float32))
    cv2.imwrite(str(copy / "Depths" / "scan2_train" / "depth_visual_0000.png"), np.full((100, 100), 255, np.uint8))
    with pytest.raises(SceneError, match="not 100x100"):
        scan.true_depth(view)
    (copy / "Depths" / "scan2_train" / "depth_map_0000.pfm").unlink()
    with pytest.raises(SceneError, match="depth_map_0000"):
        scan.true_depth(view)
    (copy / "Cameras" / "train" / "00000001_cam.txt").unlink()
    fresh = Path(shutil.move(copy, copy.with_name("other")))  # cameras are read once for each root
    with pytest.raises(SceneError, match="00000001_cam"):
        DtuScan(root=fresh, scan=2, light=0).read()


def photometric_error(sample: Sample) -> float:
    """Mean grey difference where the source is sampled at the reference's pixels through depth and cameras."""
    images, depth = sample.images.numpy(), sample.depth.numpy()
    k, pose = sample.intrinsics.numpy(), sample.cam_from_world.numpy()
    v, u = np.nonzero(depth)
    points = np.linalg.inv(k[0]) @ np.stack([u, v, np.ones_like(u)]) * depth[v, u]
    relative = pose[1] @ np.linalg.inv(pose[0])
    seen = k[1] @ (relative[:3, :3] @ points + relative[:3, 3:])
    x, y = np.rint(seen[:2] / seen[2]).astype(int)
    inside = (x >= 0) & (x < 640) & (y >= 0) & (y < 512)
    assert inside.mean() > 0.9
    return float(np.abs(images[0][:, v[inside], u[inside]] - images[1][:, y[inside], x[inside]]).mean())


def test_samples_fit_depth_and_cameras_in_one_light(root: Path) -> None:
    stream = iter(SceneSamples([root], seed=0, settings=PLAIN))
    samples = [next(stream) for _ in range(12)]  # both lights are drawn
    assert {sample.name.split("/")[0] for sample in samples} == {"scan2_train"}
    assert {int(sample.images.max()) // 60 for sample in samples} == {0, 2}  # light 0: up to 59; light 3: 120 to 179
    for sample in samples:
        assert (sample.images.amax((1, 2, 3)) - sample.images.amin((1, 2, 3)) < 60).all()
        assert photometric_error(sample) < 0.01
        assert sample.depth_range == pytest.approx((425, 425 + 191 * 2.65))


def test_training_takes_the_root(root: Path, tmp_path: Path) -> None:
    settings = TrainSettings(data=(root,), out=tmp_path, validation=(root,), steps=1, crop=(16, 12), max_sources=2)
    trainer = Trainer(settings)
    sample = next(iter(SceneSamples(settings.data, seed=0)))
    corner = replace(sample, images=sample.images[..., :128, :160], depth=sample.depth[:128, :160])  # faster
    parts = trainer.train_step([corner], np.random.default_rng(0))
    assert np.isfinite(list(parts.values())).all()
    assert trainer.step == 1


def test_the_depth_evaluation_takes_the_root(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (scan,) = find_true_scenes([root], "validation")
    exact = np.full((128, 160), PLANE_MM, np.float32)
    rows = evaluate_scene(lambda *_: (exact, exact, 4), scan.read(), true_depth=scan.true_depth)
    assert list(rows) == [f"scan3_train/{view:08d}" for view in range(3)]
    assert all(row.median_abs == 0 for row in rows.values())
    assert rows["scan3_train/00000000"].pixels == 127 * 4 * 151 * 4 + 127 + 151 + 1  # surface, and its far edges
    assert main([str(root), "--model", "field", "--every", "3", "--source-views", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mean"]["median_rel"] < 0.02
    assert main([str(root), "--split", "test"]) == 2

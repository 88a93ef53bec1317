"""BlendedMVS: lists, cameras with the release's known faults, depths and samples."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from fsinfer.errors import SceneError
from fsinfer.io.pfm import write_pfm
from training.data.blendedmvs import VALIDATION_SCENES, BlendedScene, blendedmvs_scenes, is_blendedmvs
from training.data.find import find_true_scenes
from training.data.samples import SamplingSettings, SceneSamples
from training.evaluate import evaluate_scene

PLAIN = SamplingSettings(
    min_sources=1, max_sources=2, colour_jitter=0, range_jitter=0, near_pull=1, mirror=0, turn=0, pose_noise_px=0
)
HEIGHT, WIDTH, FOCAL_PX, DEPTH, SHIFT_PX = 72, 96, 100.0, 2.0, 6
A, B, C = "5a3ca9cb270f0e3f14d0eddb", "5b7a3890fc8fcf6781e2593a", "59f87d0bfa6280566fb38c9a"


def write_scene(root: Path, name: str, views: int = 4) -> Path:
    """A plane at depth 2, six pixels of parallax a view; view 1 has a depth range that is not positive."""
    folder = root / name
    for part in ("blended_images", "cams", "rendered_depth_maps"):
        (folder / part).mkdir(parents=True)
    coarse = np.random.default_rng(0).integers(0, 255, (HEIGHT // 4, 40, 3), dtype=np.uint8)
    texture = cv2.resize(coarse, (160, HEIGHT), interpolation=cv2.INTER_CUBIC)
    for view in range(views):
        image = texture[:, SHIFT_PX * view : SHIFT_PX * view + WIDTH]
        cv2.imwrite(str(folder / "blended_images" / f"{view:08d}.jpg"), image, [cv2.IMWRITE_JPEG_QUALITY, 100])
        cv2.imwrite(str(folder / "blended_images" / f"{view:08d}_masked.jpg"), image * 0)
        depth = np.full((HEIGHT, WIDTH), DEPTH, np.float32)
        depth[:10] = 0
        depth[10:20] = 9  # beyond depth_max
        write_pfm(folder / "rendered_depth_maps" / f"{view:08d}.pfm", depth)
        x = -DEPTH / FOCAL_PX * SHIFT_PX * view
        line = "-0.5 0.01 128 0.77" if view == 1 else "1.0 0.015748 128 3.0"
        (folder / "cams" / f"{view:08d}_cam.txt").write_text(
            f"extrinsic\n1 0 0 {x} \n0 1 0 0 \n0 0 1 0 \n0 0 0 1 \n\n"
            f"intrinsic\n{FOCAL_PX} 0 48 \n0 {FOCAL_PX} 36 \n0 0 1 \n\n{line}\n"
        )
    others = {view: [s for s in range(views) if s != view] for view in range(views)}
    rows = [f"{view}\n{len(s)} {' '.join(f'{i} {100 - i}.5' for i in s)} " for view, s in others.items()]
    (folder / "cams" / "pair.txt").write_text("\n".join([str(views), *rows]) + "\n")
    return folder


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name in (A, B, C):
        write_scene(tmp_path / "low_res", name)
    return tmp_path / "low_res"


def names(root: Path, split: str) -> list[str]:
    return [scene.name for scene in blendedmvs_scenes(root, split)]  # type: ignore[arg-type]


def test_the_splits_are_those_of_the_lists(root: Path) -> None:
    assert is_blendedmvs(root)
    assert not is_blendedmvs(root / A)
    (root / "BlendedMVS_training.txt").write_text(f"{A}\n{B}\n5c34529873a8df509ae57b58\n")
    (root / "validation_list.txt").write_text(f"{C}\n")
    assert names(root, "train") == [A, B]
    assert names(root, "validation") == [C]
    (root / "BlendedMVS_training.txt").write_text(f"{A}\n{C}\n")  # a scene on both lists is for validation
    assert names(root, "train") == [A]
    with pytest.raises(SceneError, match="no test split"):
        blendedmvs_scenes(root, "test")
    (root / "BlendedMVS_training.txt").write_text("5c34529873a8df509ae57b58\n")
    with pytest.raises(SceneError, match="none of the 1 scenes of the train split"):
        blendedmvs_scenes(root, "train")


def test_lists_may_lie_in_project_lists_or_above(root: Path) -> None:
    (root / "project_lists").mkdir()
    (root / "project_lists" / "BlendedMVS_training.txt").write_text(f"{C}\n")
    (root.parent / "validation_list.txt").write_text(f"{A}\n")
    assert (names(root, "train"), names(root, "validation")) == ([C], [A])


def test_without_lists_the_releases_validation_scenes_are_kept_apart(root: Path) -> None:
    assert len(set(VALIDATION_SCENES)) == 7
    assert names(root, "train") == sorted([A, C])
    assert names(root, "validation") == [B]


def test_a_view_with_an_impossible_range_is_left_out(root: Path) -> None:
    scene = BlendedScene(folder=root / A).read()
    assert [view.name for view in scene.views] == ["00000000", "00000002", "00000003"]
    # Sources by rank, in the order of pair.txt: of view 2 they are 0, (1,) 3.
    assert [view.sources for view in scene.views] == [(1, 2), (0, 2), (0, 1)]
    assert (scene.views[1].camera.depth_min, scene.views[1].camera.depth_max) == (1.0, 3.0)
    assert scene.views[1].image_path.name == "00000002.jpg"


def test_depths_out_of_the_range_are_unknown(root: Path) -> None:
    scene = BlendedScene(folder=root / A)
    depth = scene.true_depth(scene.read().views[0])
    assert depth is not None
    assert not depth[:20].any()
    assert (depth[20:] == DEPTH).all()


def test_samples_fit_depth_and_cameras(root: Path) -> None:
    write_pfm(root / C / "rendered_depth_maps" / "00000000.pfm", np.zeros((HEIGHT, WIDTH), np.float32))
    stream = iter(SceneSamples([root], seed=0, settings=PLAIN))
    samples = [next(stream) for _ in range(12)]
    drawn = {sample.name for sample in samples}
    assert {name.split("/")[0] for name in drawn} == {A, C}
    assert f"{C}/00000000" not in drawn  # its depth map is empty
    for sample in samples:
        assert sample.depth_range == (1.0, 3.0)
        for i in range(1, len(sample.images)):
            baseline = float(sample.cam_from_world[0, 0, 3] - sample.cam_from_world[i, 0, 3])
            shift = round(baseline * FOCAL_PX / DEPTH)
            left, right = max(0, shift), min(WIDTH, WIDTH + shift)
            difference = sample.images[0, ..., left:right] - sample.images[i, ..., left - shift : right - shift]
            assert float(difference.abs().mean()) < 4  # what JPEG leaves; one pixel aside it is more than 10


def test_the_depth_evaluation_takes_the_root(root: Path) -> None:
    (scene,) = find_true_scenes([root], "validation")
    exact = np.full((HEIGHT // 4, WIDTH // 4), DEPTH, np.float32)
    rows = evaluate_scene(lambda *_: (exact, exact, 4), scene.read(), true_depth=scene.true_depth)
    assert {name: row.pixels for name, row in rows.items()} == {
        f"{B}/{view:08d}": (HEIGHT - 20) * WIDTH for view in (0, 2, 3)
    }
    assert all(row.within_1pct == 1 for row in rows.values())


def test_a_scene_without_a_usable_camera_is_an_error(root: Path) -> None:
    for path in (root / A / "cams").glob("*_cam.txt"):
        path.unlink()
    with pytest.raises(SceneError, match="no camera with a positive depth range"):
        BlendedScene(folder=root / A).read()

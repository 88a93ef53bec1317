"""Scene folders and PFM maps: what is written is read back; what is broken is said in one clear error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from fsinfer.errors import OutputError, SceneError
from fsinfer.io.files import atomic_path
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.scene import Camera, read_camera, read_pairs, read_scene, scene_digest, write_camera, write_pairs
from tests.support.plane_scene import write_plane_scene


@given(
    values=hnp.arrays(
        np.float32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=9), elements=st.floats(0, 1e6, width=32)
    )
)
def test_pfm_round_trip(values: NDArray[np.float32], tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.mktemp("pfm") / "map.pfm"
    write_pfm(path, values)
    np.testing.assert_array_equal(read_pfm(path), values)


def test_pfm_big_endian_bottom_row_first(tmp_path: Path) -> None:
    path = tmp_path / "map.pfm"
    path.write_bytes(b"Pf\n2 2\n1.0\n" + np.array([[3, 4], [1, 2]], ">f4").tobytes())
    np.testing.assert_array_equal(read_pfm(path), [[1, 2], [3, 4]])


@pytest.mark.parametrize("content", [b"", b"P6\n1 1\n255\nxxx", b"Pf\n4 4\n-1.0\n1234", b"Pf\nx y\n-1\n"])
def test_broken_pfm(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "map.pfm"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=r"map\.pfm"):
        read_pfm(path)


def _camera(x: float = 0.0) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = x
    intrinsic = np.array([[500.0, 0, 320], [0, 501, 240], [0, 0, 1]])
    return Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=0.8, depth_max=17.25)


def test_camera_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "a_cam.txt"
    write_camera(path, _camera(0.123456789))
    found = read_camera(path)
    np.testing.assert_allclose(found.cam_from_world, _camera(0.123456789).cam_from_world, atol=1e-11)
    np.testing.assert_allclose(found.intrinsic, _camera().intrinsic)
    assert (found.depth_min, found.depth_max) == (0.8, 17.25)
    np.testing.assert_allclose(found.center, [-0.123456789, 0, 0])


def test_camera_with_two_depth_numbers_has_192_planes(tmp_path: Path) -> None:
    path = tmp_path / "a_cam.txt"
    write_camera(path, _camera())
    text = path.read_text().rsplit("\n", 2)[0] + "\n425 2.5\n"
    path.write_text(text)
    assert read_camera(path).depth_max == pytest.approx(425 + 2.5 * 191)


@pytest.mark.parametrize("text", ["", "extrinsic\n1 2 3", "hello"])
def test_broken_camera(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a_cam.txt"
    path.write_text(text)
    with pytest.raises(SceneError, match="a_cam"):
        read_camera(path)


def _scene(folder: Path) -> Path:
    for i, name in enumerate(("a", "b", "c")):
        write_camera(folder / "cams" / f"{name}_cam.txt", _camera(float(i)))
        (folder / "images").mkdir(exist_ok=True)
        (folder / "images" / f"{name}.jpg").write_bytes(b"")
    write_pairs(folder / "pair.txt", {0: [(1, 9.5), (2, 1)], 1: [(0, 1)], 2: []})
    return folder


def test_read_scene(tmp_path: Path) -> None:
    scene = read_scene(_scene(tmp_path))
    assert [view.name for view in scene.views] == ["a", "b", "c"]
    assert [view.sources for view in scene.views] == [(1, 2), (0,), ()]


def test_scene_without_its_parts(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="not a folder"):
        read_scene(tmp_path / "nothing")
    with pytest.raises(SceneError, match="fsinfer poses"):
        read_scene(tmp_path)
    folder = _scene(tmp_path)
    (folder / "images" / "b.jpg").unlink()
    with pytest.raises(SceneError, match="no image for b_cam"):
        read_scene(folder)


def test_pairs_that_name_a_view_that_is_not_there(tmp_path: Path) -> None:
    folder = _scene(tmp_path)
    write_pairs(folder / "pair.txt", {0: [(7, 1.0)]})
    with pytest.raises(SceneError, match=r"3 views, numbered from 0 in the order of the camera files' names$"):
        read_scene(folder)
    for name in "efghij":
        (folder / "images" / f"{name}.jpg").write_bytes(b"")
    with pytest.raises(SceneError, match=r"without a camera file: e\.jpg, f\.jpg, g\.jpg, h\.jpg, i\.jpg, \.\.\.$"):
        read_scene(folder)
    (folder / "pair.txt").write_text("1\n0\n3 1 2.0\n")
    with pytest.raises(SceneError, match="pair list"):
        read_pairs(folder / "pair.txt")


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("old")

    def write_half() -> None:
        with atomic_path(path) as temporary:
            temporary.write_text("ne")
            raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="disk is full"):
        write_half()
    assert path.read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["result.txt"]


def test_the_digest_of_a_scene_sees_all_that_depth_hangs_on(tmp_path: Path) -> None:
    """What the digest does not see, a resumed run would take old depth maps for."""
    scene = read_scene(write_plane_scene(tmp_path / "a"))
    told = scene_digest(scene)
    assert scene_digest(read_scene(copytree(tmp_path / "a", tmp_path / "b"))) == told
    view = scene.views[1]
    moved, turned, longer = (
        view.camera.cam_from_world.copy(),
        view.camera.cam_from_world.copy(),
        view.camera.intrinsic.copy(),
    )
    moved[0, 3] += 1e-6
    turned[:2, :2] = [[np.cos(1e-6), -np.sin(1e-6)], [np.sin(1e-6), np.cos(1e-6)]]
    longer[0, 0] += 1e-3
    others = [
        replace(view, camera=replace(view.camera, cam_from_world=moved)),
        replace(view, camera=replace(view.camera, cam_from_world=turned)),
        replace(view, camera=replace(view.camera, intrinsic=longer)),
        replace(view, camera=replace(view.camera, depth_min=view.camera.depth_min + 1e-6)),
        replace(view, camera=replace(view.camera, depth_max=view.camera.depth_max + 1e-6)),
        replace(view, sources=view.sources[::-1]),
        replace(view, name="another"),
        replace(view, image_path=scene.views[2].image_path),
    ]
    digests = {scene_digest(replace(scene, views=(scene.views[0], other, scene.views[2]))) for other in others}
    assert len(digests | {told}) == len(others) + 1

"""Photographs that other programs registered as the sensor saw them: their cloud stands upright all the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from fsinfer.importers.formats import reader_of
from fsinfer.importers.write import write_scene
from fsinfer.io.gravity import UPRIGHT, noted_gravity
from fsinfer.io.turned import sensor_exif, upright_from_picture
from fsinfer.placement.place import level_scene
from fsinfer.scene import read_scene
from tests.support.apple_note import phone_exif, phone_photo

#: By how many degrees the axes of the sensor are turned about the view against those of the upright photograph.
ROLL_DEG = {1: 0, 3: 180, 6: -90, 8: 90}
BROWN = "OPENCV 64 48 50 50 32 24 -0.1 0.02 0 0"
PINHOLE = "PINHOLE 64 48 50 50 32 24"


def walk(
    folder: Path, orientations: list[int], *, lens: str, note: bool = False, tagged: bool = True, seed: int = 0
) -> NDArray[np.float64]:
    """Write a COLMAP project of a walk round a plot, turned at random; returns the points and, last, what is up."""
    rng = np.random.default_rng(seed)
    parts = [np.column_stack([rng.uniform(-10, 10, (6000, 2)), rng.normal(0, 0.02, 6000)])]
    for _ in range(8):
        place, around = rng.uniform(-6, 6, 2), rng.uniform(0, 2 * np.pi, 800)
        ring = place + 0.15 * np.column_stack([np.cos(around), np.sin(around)])
        parts.append(np.column_stack([ring, rng.uniform(0, 5, 800)]))
    turn = Rotation.random(random_state=seed).as_matrix()
    (folder / "images").mkdir(parents=True)
    lines = []
    for number, orientation in enumerate(orientations):
        angle = 2 * np.pi * number / len(orientations)
        center = np.array([9 * np.cos(angle), 9 * np.sin(angle), 1.5])
        forward = np.array([-center[0], -center[1], -1.3]) / np.hypot(9, 1.3)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        upright = np.stack([right, np.cross(forward, right), forward])
        upright = Rotation.from_euler("z", rng.normal(0, 3), degrees=True).as_matrix() @ upright
        rotation = Rotation.from_euler("z", ROLL_DEG[orientation], degrees=True).as_matrix() @ upright @ turn.T
        # A phone held upright feels gravity in its own axes: right, top, out of the screen.
        felt = np.array([1.0, -1.0, -1.0]) * (upright @ [0.0, 0.0, -1.0])
        exif = phone_exif(list(felt) if note else None, orientation if tagged else 1)
        Image.new("RGB", (64, 48), (90, 120, 60)).save(folder / "images" / f"p{number:02d}.jpg", exif=exif.tobytes())
        x, y, z, w = Rotation.from_matrix(rotation).as_quat()
        t = -rotation @ (turn @ center)
        lines += [f"{number + 1} {w} {x} {y} {z} {t[0]} {t[1]} {t[2]} 1 p{number:02d}.jpg", ""]
    (folder / "cameras.txt").write_text(f"1 {lens}\n", encoding="utf-8")
    (folder / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return np.concatenate([np.concatenate(parts) @ turn.T, turn[:, 2:].T])


WALKS = {"upright": [6] * 24, "other way": [8] * 24, "head down": [3] * 24, "mixed": [6, 1, 6, 8, 1, 6, 6, 3] * 3}


@pytest.mark.parametrize("lens", [PINHOLE, BROWN], ids=["copied", "undistorted"])
@pytest.mark.parametrize("held", WALKS)
def test_the_cloud_stands_upright_however_the_phone_was_held(tmp_path: Path, held: str, lens: str) -> None:
    points = walk(tmp_path / "project", WALKS[held], lens=lens)
    reader = reader_of(tmp_path / "project")
    assert reader is not None
    write_scene(reader(), tmp_path / "scene")
    plot_from_scene, height, _ = level_scene(points[:-1], read_scene(tmp_path / "scene"))
    assert plot_from_scene[2, :3] @ points[-1] > np.cos(np.radians(2))
    assert height == pytest.approx(1.5, abs=0.1)


@pytest.mark.parametrize("held", ["upright", "other way"])
def test_photographs_that_lost_their_tag_are_righted_by_the_ground(tmp_path: Path, held: str) -> None:
    points = walk(tmp_path / "project", WALKS[held], lens=PINHOLE, tagged=False, seed=3)
    reader = reader_of(tmp_path / "project")
    assert reader is not None
    write_scene(reader(), tmp_path / "scene")
    plot_from_scene, _, _ = level_scene(points[:-1], read_scene(tmp_path / "scene"))
    assert plot_from_scene[2, :3] @ points[-1] > np.cos(np.radians(2))


@pytest.mark.parametrize("lens", [PINHOLE, BROWN], ids=["copied", "undistorted"])
def test_gravity_that_the_phone_noted_is_kept_in_the_axes_of_the_picture(tmp_path: Path, lens: str) -> None:
    points = walk(tmp_path / "project", [6] * 6, lens=lens, note=True)
    reader = reader_of(tmp_path / "project")
    assert reader is not None
    write_scene(reader(), tmp_path / "scene")
    for view in read_scene(tmp_path / "scene").views:
        gravity = noted_gravity(view.image_path)
        assert gravity is not None
        down = view.camera.cam_from_world[:3, :3].T @ gravity
        assert down @ -points[-1] > np.cos(np.radians(0.1))


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_scene_of_another_program_keeps_the_tag(tmp_path: Path, orientation: int) -> None:
    """Its cameras belong to the pixels that are stored, and the tag says how those lie."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.new("RGB", (64, 48)).save(tmp_path / "a.jpg", exif=exif)
    np.testing.assert_array_equal(upright_from_picture(tmp_path / "a.jpg"), UPRIGHT[orientation])


def test_upright_photographs_and_mirrored_ones_say_nothing(tmp_path: Path) -> None:
    for orientation in (1, 2, 5):
        photo = phone_photo(tmp_path / f"{orientation}.jpg", None, orientation)
        assert sensor_exif(photo) is None
        np.testing.assert_array_equal(upright_from_picture(photo), np.eye(3))


@pytest.mark.parametrize("said", ["fsinfer orientation ", "fsinfer orientation 9", "fsinfer orientation x", "a spruce"])
def test_descriptions_of_somebody_else_turn_nothing(tmp_path: Path, said: str) -> None:
    exif = Image.Exif()
    exif[0x010E] = said
    Image.new("RGB", (8, 8)).save(tmp_path / "a.jpg", exif=exif.tobytes())
    np.testing.assert_array_equal(upright_from_picture(tmp_path / "a.jpg"), np.eye(3))
    np.testing.assert_array_equal(upright_from_picture(tmp_path / "missing.jpg"), np.eye(3))

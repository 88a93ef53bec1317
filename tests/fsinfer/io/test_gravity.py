from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from fsinfer.io.exif import camera_exif, gravity_exif
from fsinfer.io.gravity import noted_gravity
from fsinfer.io.images import read_image, write_image
from tests.support.apple_note import apple_note, phone_exif, phone_photo
from tests.support.places import DATA

# What the phone feels in its own axes (right, top, out of the screen) where its photograph is upright: held upright, on
# its left edge, on its right edge, head down.
WAYS = [(6, (0.0, -1.0, 0.0)), (1, (-1.0, 0.0, 0.0)), (3, (1.0, 0.0, 0.0)), (8, (0.0, 1.0, 0.0))]


@pytest.mark.parametrize(("orientation", "felt"), WAYS)
def test_an_upright_photograph_has_gravity_along_its_side(
    tmp_path: Path, orientation: int, felt: tuple[float, ...]
) -> None:
    gravity = noted_gravity(phone_photo(tmp_path / "a.jpg", felt, orientation))
    assert gravity is not None
    np.testing.assert_allclose(gravity, [0, 1, 0], atol=1e-5)
    # Looking down by 30 degrees, the back of the phone is nearer to the ground.
    tilted = np.cos(np.radians(30)) * np.array(felt) - [0, 0, np.sin(np.radians(30))]
    gravity = noted_gravity(phone_photo(tmp_path / "a.jpg", list(tilted), orientation))
    assert gravity is not None
    np.testing.assert_allclose(gravity, [0, np.cos(np.radians(30)), np.sin(np.radians(30))], atol=1e-5)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_phone_that_looks_at_the_ground_has_gravity_ahead_however_it_is_turned(
    tmp_path: Path, orientation: int
) -> None:
    gravity = noted_gravity(phone_photo(tmp_path / "a.jpg", (0, 0, -1), orientation))
    assert gravity is not None
    np.testing.assert_allclose(gravity, [0, 0, 1], atol=1e-5)


def test_a_phone_with_its_right_side_low_has_gravity_to_the_right(tmp_path: Path) -> None:
    gravity = noted_gravity(phone_photo(tmp_path / "a.jpg", (np.sin(0.2), -np.cos(0.2), 0.0), 6))
    assert gravity is not None
    np.testing.assert_allclose(gravity, [np.sin(0.2), np.cos(0.2), 0], atol=1e-5)


@pytest.mark.parametrize(("orientation", "stored"), [(6, [1, 0, 0]), (1, [0, 1, 0]), (3, [0, -1, 0]), (8, [-1, 0, 0])])
def test_stored_pixels_have_axes_of_their_own(tmp_path: Path, orientation: int, stored: list[int]) -> None:
    photo = phone_photo(tmp_path / "a.jpg", dict(WAYS)[orientation], orientation)
    gravity = noted_gravity(photo, upright=False)
    assert gravity is not None
    np.testing.assert_allclose(gravity, stored, atol=1e-5)


def test_copies_keep_it(tmp_path: Path) -> None:
    photo = phone_photo(tmp_path / "a.jpg", (0.1, -0.95, -0.2), 6)
    first = noted_gravity(photo)
    assert first is not None
    write_image(tmp_path / "b.jpg", read_image(photo), exif=camera_exif(photo))
    write_image(tmp_path / "c.jpg", read_image(tmp_path / "b.jpg"), exif=gravity_exif(tmp_path / "b.jpg"))
    for name in ("b.jpg", "c.jpg"):
        copied = noted_gravity(tmp_path / name)
        assert copied is not None
        np.testing.assert_allclose(copied, first, atol=1e-4)


def test_heic_photographs_are_turned_by_their_reader(tmp_path: Path) -> None:
    heif = pytest.importorskip("pillow_heif", reason="reads HEIC photographs")
    heif.register_heif_opener()
    picture = Image.fromarray(np.full((48, 64, 3), 90, np.uint8))
    picture.save(tmp_path / "a.heic", exif=phone_exif((0.0, -1.0, 0.0), 6).tobytes())
    gravity = noted_gravity(tmp_path / "a.heic")
    assert gravity is not None
    assert read_image(tmp_path / "a.heic").shape == (64, 48, 3)
    np.testing.assert_allclose(gravity, [0, 1, 0], atol=1e-5)


def test_little_endian_notes_are_read(tmp_path: Path) -> None:
    exif = phone_exif(None, 6)
    exif.get_ifd(0x8769)[0x927C] = apple_note((0, -1, 0), order="<")
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tmp_path / "a.jpg", exif=exif.tobytes())
    gravity = noted_gravity(tmp_path / "a.jpg")
    assert gravity is not None
    np.testing.assert_allclose(gravity, [0, 1, 0], atol=1e-5)


@pytest.mark.parametrize("felt", [None, (0.0, -1.6, 0.0), (0.0, -0.3, 0.0)], ids=["no note", "shaken", "falling"])
def test_nothing_is_made_up(tmp_path: Path, felt: tuple[float, float, float] | None) -> None:
    photo = phone_photo(tmp_path / "a.jpg", felt)
    assert noted_gravity(photo) is None
    assert gravity_exif(photo) is None
    # Nor of a mirrored picture, whose phone nobody knows.
    assert noted_gravity(phone_photo(tmp_path / "b.jpg", (0.0, -1.0, 0.0), 2)) is None


@given(st.binary(max_size=120), st.integers(0, 90))
def test_a_broken_note_is_none(tmp_path_factory: pytest.TempPathFactory, garbage: bytes, cut: int) -> None:
    folder = tmp_path_factory.mktemp("notes")
    whole = apple_note((0.0, -1.0, 0.0))
    for note in (garbage, b"Apple iOS\0\0\1MM" + garbage, whole[:cut]):
        exif = phone_exif(None, 6)
        exif.get_ifd(0x8769)[0x927C] = note
        Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(folder / "a.jpg", exif=exif.tobytes())
        gravity = noted_gravity(folder / "a.jpg")
        assert gravity is None or np.linalg.norm(gravity) == pytest.approx(1)


def test_a_comment_of_somebody_else_is_none(tmp_path: Path) -> None:
    for comment in (b"ASCII\0\0\0fsinfer gravity 0 1", b"ASCII\0\0\0fsinfer gravity x y z", b"UNICODE\0a spruce"):
        exif = phone_exif(None, 1)
        exif.get_ifd(0x8769)[0x9286] = comment
        Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tmp_path / "a.jpg", exif=exif.tobytes())
        assert noted_gravity(tmp_path / "a.jpg") is None


@pytest.mark.skipif(not (DATA / "monstree").is_dir(), reason="photographs of a real phone are not at hand")
def test_a_real_phone_noted_gravity() -> None:
    noted = [noted_gravity(path) for path in sorted((DATA / "monstree").glob("*.JPG"))]
    assert len(noted) >= 20
    # Held upright or on its side, by hand, the trunk in the middle: down is down in all of them.
    assert all(gravity is not None and gravity[1] > 0.75 and abs(gravity[0]) < 0.25 for gravity in noted)

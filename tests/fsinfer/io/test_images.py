"""Photographs are read upright and complete, or not at all."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fsinfer.errors import ImageError
from fsinfer.io.exif import camera_exif, camera_key, taken_at
from fsinfer.io.images import image_size, is_upright_jpeg_or_png, read_image, read_reduced, reduce_image, write_image
from fsinfer.io.photo_folders import list_images


def picture(width: int = 60, height: int = 40) -> NDArray[np.uint8]:
    """A smooth picture whose corners differ: red grows to the right, green downwards."""
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 0] = np.linspace(0, 250, width)[None]
    image[..., 1] = np.linspace(0, 250, height)[:, None]
    image[..., 2] = 100
    return image


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "ä b.JPG"])
def test_round_trip_keeps_colours_and_their_order(tmp_path: Path, name: str) -> None:
    write_image(tmp_path / name, picture())
    difference = np.abs(read_image(tmp_path / name).astype(int) - picture())
    assert difference.max() <= (0 if name.endswith("png") else 6)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied(tmp_path: Path, orientation: int) -> None:
    upright = picture()
    # What the sensor stored, by Exif 2.32: undo what the tag tells the reader to do.
    stored = {
        1: upright,
        2: upright[:, ::-1],
        3: upright[::-1, ::-1],
        4: upright[::-1],
        5: upright.transpose(1, 0, 2),
        6: np.rot90(upright, 1),
        7: upright[::-1, ::-1].transpose(1, 0, 2),
        8: np.rot90(upright, -1),
    }[orientation]
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / "a.jpg"
    Image.fromarray(np.ascontiguousarray(stored)).save(path, quality=98, subsampling=0, exif=exif.tobytes())
    read = read_image(path)
    assert read.shape == upright.shape
    assert np.abs(read.astype(int) - upright).max() <= 6
    assert image_size(path) == (60, 40)


def waves(width: int, height: int) -> NDArray[np.uint8]:
    """A picture that is not even anywhere, of waves ten pixels long and longer, without an axis of symmetry."""
    x, y = np.arange(width)[None, :], np.arange(height)[:, None]
    channels = [np.sin(x / 1.7 + 0.01 * y), np.sin(y / 2.3 - 0.02 * x), np.cos((x + 2 * y) / 5)]
    return np.stack([(128 + 90 * channel).round().astype(np.uint8) for channel in channels], axis=-1)


def long_waves(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grey of waves 60 pixels long and longer at these places, pixels."""
    channels = [np.sin(x / 9.5 + 0.01 * y), np.sin(y / 11.3 - 0.02 * x), np.cos((x + 2 * y) / 31)]
    return np.stack([128 + 90 * channel for channel in channels], axis=-1)


def means(image: NDArray[np.uint8], step: int) -> NDArray[np.float64]:
    """Of squares of ``step`` pixels, from the upper left corner, whole ones alone."""
    height, width = (side // step * step for side in image.shape[:2])
    squares = image[:height, :width].reshape(height // step, step, width // step, step, 3)
    return np.asarray(squares.mean(axis=(1, 3)))


@pytest.mark.parametrize(("size", "at_least", "step"), [((160, 120), 40, 4), ((163, 126), 75, 2), ((160, 120), 81, 1)])
@pytest.mark.parametrize("orientation", [1, 6])
def test_a_jpeg_that_may_be_smaller_is_the_means_of_its_pixels(
    tmp_path: Path, size: tuple[int, int], at_least: int, step: int, orientation: int
) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(waves(*size)).save(tmp_path / "a.jpg", quality=98, subsampling=0, exif=exif.tobytes())
    small = read_image(tmp_path / "a.jpg", at_least_px=at_least)
    expected = means(waves(*size), step)
    if orientation == 6:
        expected = np.rot90(expected, -1)
    assert small.shape == expected.shape
    assert np.abs(small - expected).mean() < 2
    # Half a pixel off would be ten times as much.
    assert np.abs(small[1:] - expected[:-1]).mean() > 5


def test_a_jpeg_with_a_second_picture_may_be_smaller_too(tmp_path: Path) -> None:
    second = Image.fromarray(waves(80, 60))
    Image.fromarray(waves(160, 120)).save(
        tmp_path / "a.jpg", format="MPO", save_all=True, append_images=[second], quality=98
    )
    small = read_image(tmp_path / "a.jpg", at_least_px=40)
    assert small.shape == (30, 40, 3)
    assert np.abs(small - means(waves(160, 120), 4)).mean() < 3


def test_other_files_are_read_as_they_are(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", picture(160, 120))
    assert np.array_equal(read_image(tmp_path / "a.png", at_least_px=20), picture(160, 120))


@pytest.mark.parametrize("share", [0.3, 0.9])
def test_a_cut_jpeg_is_an_error_at_a_quarter_too(tmp_path: Path, share: float) -> None:
    Image.fromarray(waves(160, 120)).save(tmp_path / "whole.jpg")
    content = (tmp_path / "whole.jpg").read_bytes()
    (tmp_path / "cut.jpg").write_bytes(content[: int(share * len(content))])
    with pytest.raises(ImageError, match=r"cut\.jpg is damaged or cut short"):
        read_image(tmp_path / "cut.jpg", at_least_px=40)


@pytest.mark.parametrize(
    ("name", "size", "expected"),
    [
        ("half.jpg", (336, 252), (168, 126)),
        ("half.png", (337, 253), (168, 126)),
        ("little-more.jpg", (300, 200), (198, 132)),
        ("upright.jpg", (200, 300), (132, 198)),
        ("third.png", (505, 334), (168, 111)),
        # 200 to 132.9 would be reduced by other factors, 191 to 126.91 is nearer.
        ("odd.png", (301, 200), (191, 127)),
        ("small.jpg", (160, 120), (160, 120)),
        ("enough.jpg", (200, 150), (200, 150)),
    ],
)
def test_large_photos_are_reduced_by_one_factor(
    tmp_path: Path, name: str, size: tuple[int, int], expected: tuple[int, int]
) -> None:
    Image.fromarray(waves(*size)).save(tmp_path / name, quality=98)
    reduced = read_reduced(tmp_path / name, 200)
    assert reduced.shape[1::-1] == expected
    # What is left over of a whole part is cut off; at the farther end the rest is no more than a tenth of a pixel.
    part = round(max(size) / max(expected))
    if max(size) // part == max(expected) and size != expected:
        assert np.abs(reduced - means(waves(*size), part)).mean() < 2
    else:
        assert abs((expected[0] / size[0]) / (expected[1] / size[1]) - 1) < 0.001


@pytest.mark.parametrize(
    ("size", "expected"), [((300, 200), (198, 132)), ((200, 300), (132, 198)), ((301, 200), (191, 127))]
)
def test_reduced_photos_show_the_same_at_the_same_place(size: tuple[int, int], expected: tuple[int, int]) -> None:
    place_x, place_y = np.meshgrid(np.arange(float(size[0])), np.arange(float(size[1])))
    reduced = reduce_image(long_waves(place_x, place_y).round().astype(np.uint8), 200)
    u, v = np.meshgrid(np.arange(float(expected[0])), np.arange(float(expected[1])))
    same_x, same_y = ((u + 0.5) * size[0] / expected[0] - 0.5, (v + 0.5) * size[1] / expected[1] - 0.5)
    # Half a pixel beside it would be 4 grey levels.
    assert np.abs(reduced - long_waves(same_x, same_y)).mean() < 0.6


@pytest.mark.parametrize(
    "size", [(600, 400), (301, 200), (500, 375), (960, 540), (640, 480), (4032, 1), (12000, 4), (60, 7)]
)
def test_photos_of_one_size_stay_of_one_size_whatever_their_format(tmp_path: Path, size: tuple[int, int]) -> None:
    picture = Image.fromarray(waves(*size))
    picture.save(tmp_path / "a.jpg")
    picture.save(tmp_path / "a.png")
    picture.convert("L").save(tmp_path / "grey.jpg")
    found = {read_reduced(path, 240).shape for path in tmp_path.iterdir()}
    assert len(found) == 1
    assert max(found.pop()) <= 240
    assert max(read_image(tmp_path / "a.jpg", at_least_px=1).shape) >= 1


def test_camera_metadata_goes_into_upright_copies_without_place_and_orientation(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0112] = "Maker", "Phone 1", 6
    exif.get_ifd(0x8769)[0xA405] = 26
    exif.get_ifd(0x8769)[0x9003], exif.get_ifd(0x8769)[0x9291] = "2026:05:04 10:00:05", "12"
    exif.get_ifd(0x8825)[1] = "N"
    original = tmp_path / "a.jpg"
    Image.fromarray(picture()).save(original, exif=exif.tobytes())
    copy = tmp_path / "b.jpg"
    write_image(copy, read_image(original), exif=camera_exif(original))
    with Image.open(copy) as image:
        kept = image.getexif()
        assert kept[0x0110] == "Phone 1"
        assert kept.get_ifd(0x8769)[0xA405] == 26
        assert 0x0112 not in kept
        assert not kept.get_ifd(0x8825)
    assert camera_key(copy) == camera_key(original)
    assert taken_at(copy) == taken_at(original) == ("Maker Phone 1", "2026:05:04 10:00:05.12")


def test_digital_zoom_is_another_lens(tmp_path: Path) -> None:
    # Both say the same focal lengths; the second enlarged the middle of the picture.
    keys = []
    for name, zoom in (("plain", None), ("none", 0), ("one", 1.0), ("twice", 2.0)):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0xA405] = 26
        if zoom is not None:
            exif.get_ifd(0x8769)[0xA404] = zoom
        Image.fromarray(picture()).save(tmp_path / f"{name}.jpg", exif=exif.tobytes())
        copy = tmp_path / f"{name}_upright.jpg"
        write_image(copy, picture(), exif=camera_exif(tmp_path / f"{name}.jpg"))
        assert camera_key(copy) == camera_key(tmp_path / f"{name}.jpg")
        keys.append(camera_key(copy))
    assert keys[0] == keys[1] == keys[2] != keys[3]


def test_photos_without_metadata_share_a_camera_by_size(tmp_path: Path) -> None:
    for name, size in (("a.png", (60, 40)), ("b.png", (60, 40)), ("c.png", (40, 60))):
        write_image(tmp_path / name, picture(*size))
    assert camera_exif(tmp_path / "a.png") is None
    a, b, c = (camera_key(tmp_path / name) for name in ("a.png", "b.png", "c.png"))
    assert a == b != c


@pytest.mark.parametrize("share", [0.2, 0.6, 0.95])
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_cut_file_is_an_error(tmp_path: Path, suffix: str, share: float) -> None:
    path = tmp_path / f"a{suffix}"
    noise = np.random.default_rng(0).integers(0, 255, (80, 120, 3), dtype=np.uint8)
    write_image(path, noise)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ImageError, match=rf"a\{suffix}.*copy it again"):
        read_image(path)


@pytest.mark.parametrize("content", [b"", b"not an image", b"\xff\xd8\xff\xe0"])
def test_file_that_is_no_image(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(ImageError, match=r"a\.jpg"):
        read_image(tmp_path / "a.jpg")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="does not exist"):
        read_image(tmp_path / "gone.jpg")


def test_heic_without_its_reader_names_the_way_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.heic").write_bytes(b"anything")
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pillow_heif" else find(name))
    with pytest.raises(ImageError, match="pip install pillow-heif"):
        read_image(tmp_path / "a.heic")


@pytest.mark.parametrize("name", ["a.jpg", "a.JPEG", "a.png"])
def test_heic_by_another_name_is_read_whatever_was_read_before(tmp_path: Path, name: str) -> None:
    """Such photographs were called damaged, unless one named .heic had been read before them."""
    heif = pytest.importorskip("pillow_heif", reason="the reader of HEIC is not installed")
    heif.from_pillow(Image.fromarray(picture(64, 48))).save(tmp_path / "a.heic", quality=95)
    (tmp_path / name).write_bytes((tmp_path / "a.heic").read_bytes())
    code = "import sys; from fsinfer.io.images import image_size; print(image_size(sys.argv[1]))"
    done = subprocess.run([sys.executable, "-c", code, tmp_path / name], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "(64, 48)"), done.stderr
    assert not is_upright_jpeg_or_png(tmp_path / name)


def test_heic_is_read(tmp_path: Path) -> None:
    heif = pytest.importorskip("pillow_heif")
    heif.from_pillow(Image.fromarray(picture(64, 48))).save(tmp_path / "a.heic", quality=95)
    read = read_image(tmp_path / "a.heic")
    assert read.shape == (48, 64, 3)
    assert np.abs(read.astype(int) - picture(64, 48)).mean() < 4


def test_sixteen_bit_grey_is_scaled_not_clipped(tmp_path: Path) -> None:
    values = (np.linspace(0, 65535, 100).reshape(1, -1).repeat(10, axis=0)).astype(np.uint16)
    Image.fromarray(values).save(tmp_path / "a.png")
    read = read_image(tmp_path / "a.png")
    assert read.shape == (10, 100, 3)
    assert np.abs(read[0, :, 0].astype(int) - np.linspace(0, 255, 100)).max() <= 1


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
@pytest.mark.parametrize("part", [1.0, 0.6])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_sensors_of_fewer_bits_are_as_bright_as_those_of_sixteen(
    tmp_path: Path, bits: int, part: float, suffix: str
) -> None:
    """Nor does it matter whether white is reached: photographs of one camera are scaled alike."""
    values = (part * np.linspace(0, 2**bits - 1, 100).reshape(1, -1).repeat(10, axis=0)).astype(np.uint16)
    Image.fromarray(values).save(tmp_path / f"a{suffix}")
    read = read_image(tmp_path / f"a{suffix}")
    assert np.abs(read[0, :, 0].astype(int) - part * np.linspace(0, 255, 100)).max() <= 1


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (0.0, 255.0), (0.0, 65535.0), (288.0, 301.5), (-3.0, 2.0)])
def test_floats_have_their_own_range(tmp_path: Path, low: float, high: float) -> None:
    values = np.linspace(low, high, 100, dtype=np.float32).reshape(1, -1).repeat(10, axis=0)
    values[1, :3] = [np.nan, np.inf, -np.inf]
    Image.fromarray(values).save(tmp_path / "a.tif")
    read = read_image(tmp_path / "a.tif")
    assert np.abs(read[0, :, 0].astype(int) - np.linspace(0, 255, 100)).max() <= 1
    assert read[1, :3, 0].tolist() == [0, 255, 0]


@pytest.mark.parametrize("value", [0.5, np.nan])
def test_floats_without_a_range_are_told(tmp_path: Path, value: float) -> None:
    Image.fromarray(np.full((10, 100), value, np.float32)).save(tmp_path / "a.tif")
    with pytest.raises(ImageError, match=r"^\S*a\.tif holds floats that are all alike or not finite; save"):
        read_image(tmp_path / "a.tif")


def test_list_images(tmp_path: Path) -> None:
    for name in ("b.jpg", "a.PNG", "._c.jpg", "notes.txt"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "folder.jpg").mkdir()
    assert [path.name for path in list_images(tmp_path)] == ["a.PNG", "b.jpg"]
    (tmp_path / "empty").mkdir()
    with pytest.raises(ImageError, match="holds no photos"):
        list_images(tmp_path / "empty")
    with pytest.raises(ImageError, match="does not exist"):
        list_images(tmp_path / "gone")


def test_writing_something_that_is_no_image(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match=r"image\.shape"):
        write_image(tmp_path / "a.jpg", np.zeros((4, 4, 3)))  # type: ignore[arg-type]
    with pytest.raises(ImageError, match=r"\.jpg or \.png"):
        write_image(tmp_path / "a.gif", picture())
    assert not list(tmp_path.iterdir())

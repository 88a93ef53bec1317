"""TIFFs are read as JPEGs are: upright by their orientation, or else as they are stored; colours in 16 bits as grey."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fsinfer.errors import ImageError
from fsinfer.io.exif import camera_key
from fsinfer.io.images import image_size, is_turned, is_upright_jpeg_or_png, read_image, read_reduced

#: What Exif 2.32 says that each orientation does to stored pixels, in numpy's words.
TURNS: dict[int, Callable[[NDArray[np.uint8]], NDArray[np.uint8]]] = {
    1: lambda pixels: pixels,
    2: np.fliplr,
    3: lambda pixels: np.rot90(pixels, 2),
    4: np.flipud,
    5: lambda pixels: pixels.swapaxes(0, 1),
    6: lambda pixels: np.rot90(pixels, -1),
    7: lambda pixels: np.rot90(pixels, 2).swapaxes(0, 1),
    8: np.rot90,
}


def noise(width: int = 60, height: int = 40) -> NDArray[np.uint8]:
    """(height, width, 3) without any symmetry, with white in it."""
    image = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    image[3, 5] = 255
    return image


def oriented(orientation: int) -> Image.Exif:
    exif = Image.Exif()
    exif[0x0112] = orientation
    return exif


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("compression", [None, "tiff_deflate", "tiff_lzw"])
@pytest.mark.parametrize("kind", ["grey8", "rgb8", "grey16"])
def test_a_tiff_is_turned_as_its_orientation_says(
    tmp_path: Path, kind: str, compression: str | None, orientation: int
) -> None:
    colours = noise()
    grey = colours[:, :, :1].repeat(3, axis=2)
    stored = colours if kind == "rgb8" else grey
    written = {
        "rgb8": Image.fromarray(colours),
        "grey8": Image.fromarray(grey[..., 0]),
        "grey16": Image.fromarray(grey[..., 0].astype(np.uint16) * 257),
    }
    path = tmp_path / "ä.tif"
    written[kind].save(path, compression=compression, exif=oriented(orientation))
    np.testing.assert_array_equal(read_image(path, upright=False), stored)
    np.testing.assert_array_equal(read_image(path), TURNS[orientation](stored))
    assert image_size(path, upright=False) == (60, 40)
    assert image_size(path) == TURNS[orientation](stored).shape[1::-1]
    assert is_turned(path) == (orientation != 1)


@pytest.mark.parametrize("suffix", [".jpg", ".tif"])
def test_the_same_camera_held_upright_is_another_one(tmp_path: Path, suffix: str) -> None:
    """Its pictures have another size, by which photographs share a calibration."""
    keys = []
    for orientation in (1, 6, 8):
        path = tmp_path / f"{orientation}{suffix}"
        Image.fromarray(noise()).save(path, exif=oriented(orientation))
        keys.append(camera_key(path)[:2])
    assert keys == [("60", "40"), ("40", "60"), ("40", "60")]


@pytest.mark.parametrize("upright", [True, False])
def test_a_tiff_is_reduced_as_a_jpeg_is(tmp_path: Path, upright: bool) -> None:
    smooth = np.kron(noise(6, 4), np.ones((20, 20, 1), np.uint8))
    options: dict[str, Any] = {".jpg": {"quality": 98, "subsampling": 0}, ".tif": {}}
    read = []
    for suffix in options:
        Image.fromarray(smooth).save(tmp_path / f"a{suffix}", exif=oriented(6), **options[suffix])
        read.append(read_reduced(tmp_path / f"a{suffix}", 60, upright=upright).astype(int))
    assert read[0].shape == read[1].shape == ((60, 40, 3) if upright else (40, 60, 3))
    assert np.abs(read[0] - read[1]).mean() < 3


def write_deep(path: Path, values: NDArray[np.uint16], compression: int = 1, *, orientation: int = 1) -> None:
    """Write red, green, blue and perhaps alpha in 16 bits, which Pillow cannot."""
    order = [2, 1, 0, 3][: values.shape[2]]
    options = [cv2.IMWRITE_TIFF_COMPRESSION, compression] if path.suffix == ".tif" else []
    content = cv2.imencode(path.suffix, np.ascontiguousarray(values[..., order]), options)[1].tobytes()
    exif = oriented(orientation).tobytes().removeprefix(b"Exif\0\0")
    if path.suffix == ".png":
        chunk = b"eXIf" + exif
        end = content.rindex(b"IEND") - 4
        content = (
            content[:end] + struct.pack(">I", len(exif)) + chunk + struct.pack(">I", zlib.crc32(chunk)) + content[end:]
        )
    else:
        # A new table of the entries behind what is there, with one more of them.
        (table,) = struct.unpack("<I", content[4:8])
        (count,) = struct.unpack("<H", content[table : table + 2])
        entries = [content[table + 2 + 12 * entry :][:12] for entry in range(count)]
        entries = sorted([*entries, struct.pack("<HHIHH", 0x0112, 3, 1, orientation, 0)], key=lambda e: e[1::-1])
        body = content[:4] + struct.pack("<I", len(content)) + content[8:]
        content = body + struct.pack("<H", count + 1) + b"".join(entries) + bytes(4)
    path.write_bytes(content)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("bits", [10, 12, 16])
@pytest.mark.parametrize(("suffix", "compression"), [(".png", 1), (".tif", 1), (".tif", 5), (".tif", 8)])
def test_deep_colours_are_as_bright_as_those_of_eight_bits(
    tmp_path: Path, suffix: str, compression: int, bits: int, orientation: int
) -> None:
    path = tmp_path / f"ä ö{suffix}"
    values = np.round(noise() / 255 * (2**bits - 1)).astype(np.uint16)
    write_deep(path, values, compression, orientation=orientation)
    np.testing.assert_array_equal(read_image(path, upright=False), noise())
    np.testing.assert_array_equal(read_image(path), TURNS[orientation](noise()))
    assert image_size(path) == TURNS[orientation](noise()).shape[1::-1]


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_the_alpha_of_deep_colours_is_left_out(tmp_path: Path, suffix: str) -> None:
    values = noise().astype(np.uint16) * 16
    alpha = np.full_like(values[..., :1], 65535)
    write_deep(tmp_path / f"a{suffix}", np.concatenate([values, alpha], axis=2))
    assert np.abs(read_image(tmp_path / f"a{suffix}").astype(int) - noise()).max() <= 1


def test_programs_that_read_eight_bits_get_a_copy_of_deep_colours(tmp_path: Path) -> None:
    write_deep(tmp_path / "deep.png", noise().astype(np.uint16) * 16)
    Image.fromarray(noise()).save(tmp_path / "plain.png")
    assert not is_upright_jpeg_or_png(tmp_path / "deep.png")
    assert is_upright_jpeg_or_png(tmp_path / "plain.png")


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_deep_colours_that_are_cut_short_are_an_error(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(cv2.imencode(suffix, noise().astype(np.uint16) * 16)[1].tobytes()[:9000])
    with pytest.raises(ImageError, match="copy it again from the camera or delete it"):
        read_image(path)


def test_other_deep_colours_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_deep(tmp_path / "a.tif", noise().astype(np.uint16) * 16)
    monkeypatch.setattr("fsinfer.io.pixels._COLOURS", frozenset())
    with pytest.raises(
        ImageError, match=r"a\.tif holds colours \(RGB\) in more than 8 bits .* save it as RGB in 8 bits"
    ):
        read_image(tmp_path / "a.tif")

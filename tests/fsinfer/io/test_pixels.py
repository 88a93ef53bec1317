"""TIFFs are read as JPEGs are: upright by their orientation, or else as they are stored."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fsinfer.io.exif import camera_key
from fsinfer.io.images import image_size, is_turned, read_image, read_reduced

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

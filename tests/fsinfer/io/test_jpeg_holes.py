"""A JPEG of which a part became zeros is told; zeros beside the coded pixels, or by chance in them, are no damage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fsinfer.errors import ImageError
from fsinfer.io.images import can_be_read, read_image
from fsinfer.io.jpeg_holes import has_hole


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    """With metadata that hold zeros, as those of phones do."""
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x927C] = bytes(8192)
    noise = np.random.default_rng(0).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    path = tmp_path / "a.jpg"
    Image.fromarray(noise).save(path, quality=95, exif=exif)
    return path


def with_hole(path: Path, start: int, size: int) -> None:
    data = bytearray(path.read_bytes())
    data[start : start + size] = bytes(len(data[start : start + size]))
    path.write_bytes(data)


@pytest.mark.parametrize(("start", "size"), [(20_480, 512), (24_576, 4096), (32_768, 1_000_000)])
@pytest.mark.parametrize("at_least_px", [None, 1])
def test_missing_sectors_are_told(photo: Path, start: int, size: int, at_least_px: int | None) -> None:
    read_image(photo, at_least_px=at_least_px)
    assert photo.stat().st_size > 40_960
    with_hole(photo, start, size)
    with pytest.raises(ImageError, match=r"a\.jpg is damaged: a part of it is missing, all zeros; copy it again"):
        read_image(photo, at_least_px=at_least_px)
    assert not can_be_read(photo)


def test_zeros_elsewhere_are_no_damage(photo: Path, tmp_path: Path) -> None:
    sound = photo.read_bytes()
    assert bytes(4096) in sound
    assert not has_hole(sound)
    # A film behind the picture, as of phones that take one with each photo.
    assert not has_hole(sound + b"f" * (-len(sound) % 512) + bytes(65_536))
    # Runs that are no whole sectors.
    with_hole(photo, 20_480 + 100, 1000)
    assert not has_hole(photo.read_bytes())
    # A white picture is next to nothing but zeros with code tables of its own.
    white = tmp_path / "white.jpg"
    Image.new("RGB", (4000, 3000), (255, 255, 255)).save(white, optimize=True)
    assert bytes(1024) in white.read_bytes()
    assert can_be_read(white)


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", b"\xff\xd8\xff\xda\xff\xff", b"\xff\xd8\xff", bytes(9000)])
def test_what_is_no_jpeg_has_no_hole(data: bytes) -> None:
    assert not has_hole(data)

"""Photos stand in the order of walking, also where the camera's counter began anew on the way."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest
from PIL import Image

from fsinfer.errors import ImageError
from fsinfer.io.walk_order import list_walk

WRAPPED = ["IMG_0001", "IMG_0002", "IMG_0003", "IMG_9998", "IMG_9999"]
BY_TIME = ["IMG_9998", "IMG_9999", "IMG_0001", "IMG_0002", "IMG_0003"]


def names(folder: Path, moments: Mapping[str, str | None], cameras: Mapping[str, str] | None = None) -> list[str]:
    """The names in the order of walking, of photos with such moments (minutes and seconds)."""
    for name, moment in moments.items():
        exif = Image.Exif()
        exif[0x0110] = (cameras or {}).get(name, "Phone")
        if moment is not None:
            exif.get_ifd(0x8769)[0x9003] = f"2026:05:04 10:{moment}"
        Image.new("RGB", (8, 6)).save(folder / f"{name}.jpg", exif=exif)
    return [path.stem for path in list_walk(folder)]


@pytest.mark.parametrize(
    ("moments", "walked"),
    [
        (["00:02", "00:03", "00:04", "00:00", "00:01"], BY_TIME),
        (["00:01", "00:01", "00:02", "00:00", "00:01"], BY_TIME),  # several within one second
        (["00:00", "00:01", "00:02", "00:03", "00:04"], WRAPPED),
        (["00:00", "00:00", "00:00", "00:00", "00:00"], WRAPPED),
        ([None, None, None, None, None], WRAPPED),
        (["00:02", "00:03", "00:04", "00:00", None], WRAPPED),
        (["00:02", "00:05", "00:04", "00:00", "00:01"], WRAPPED),  # two steps back
        (["00:02", "00:03", "00:04", "00:00", "00:05"], WRAPPED),  # the last was taken after the first
    ],
)
def test_one_step_back_is_where_the_walk_ends(tmp_path: Path, moments: list[str | None], walked: list[str]) -> None:
    assert names(tmp_path, dict(zip(WRAPPED, moments, strict=True))) == walked


def test_clocks_of_two_cameras_are_not_compared(tmp_path: Path) -> None:
    moments = dict(zip(WRAPPED, ["00:02", "00:03", "00:04", "00:00", "00:01"], strict=True))
    assert names(tmp_path, moments, {"IMG_9998": "Other", "IMG_9999": "Other"}) == WRAPPED


def test_a_folder_without_photos_is_told(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="no photos"):
        list_walk(tmp_path)

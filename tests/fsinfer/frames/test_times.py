"""Names of photos that do not follow the walk are told."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fsinfer.frames.select import select_frames
from fsinfer.frames.times import names_against_times
from fsinfer.io.exif import taken_at
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.sentences import sentence


def photo(path: Path, second: int | None, *, camera: str = "Phone", decimals: str | None = None) -> Path:
    exif = Image.Exif()
    exif[0x0110] = camera
    if second is not None:
        exif.get_ifd(0x8769)[0x9003] = f"2026:05:04 10:{second // 60:02d}:{second % 60:02d}"
    if decimals is not None:
        exif.get_ifd(0x8769)[0x9291] = decimals
    texture = np.random.default_rng(second).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    Image.fromarray(texture).resize((320, 240)).save(path, exif=exif)
    return path


def photos(folder: Path, seconds: list[int | None], *, camera: str = "Phone") -> list[Path]:
    folder.mkdir(exist_ok=True)
    return [photo(folder / f"{camera}_{i:03d}.jpg", second, camera=camera) for i, second in enumerate(seconds)]


SHUFFLED = [int(second) for second in np.random.default_rng(1).permutation(14)]


@pytest.mark.parametrize(
    ("seconds", "backwards"),
    [
        (list(range(14)), None),
        ([*range(7, 14), *range(7)], None),  # a counter that began anew in the middle of the walk
        (SHUFFLED, sum(b < a for a, b in pairwise(SHUFFLED))),
        ([0] * 14, None),  # a burst within one second
        (SHUFFLED[:9], None),  # so few are matched with each other anyway
        ([None] * 14, None),
        ([None, None, *SHUFFLED], sum(b < a for a, b in pairwise(SHUFFLED))),
    ],
)
def test_names_are_held_against_times(tmp_path: Path, seconds: list[int | None], backwards: int | None) -> None:
    told = names_against_times(photos(tmp_path, seconds))
    if backwards is None:
        assert told == ()
        return
    assert told[0].code == CaptureCode.names_not_by_time
    assert told[0].values == {"backwards": backwards, "photos": 14}
    assert f"by name {backwards} of 14 were taken before the one before them" in sentence(told[0])


def test_clocks_of_two_cameras_are_not_compared(tmp_path: Path) -> None:
    """Photos of two people that were named through each other: the second clock is an hour behind."""
    first, second = photos(tmp_path, list(range(3600, 3612)), camera="A"), photos(tmp_path, list(range(12)), camera="B")
    mixed = [path for pair in zip(first, second, strict=True) for path in pair]
    assert CaptureCode.names_not_by_time not in [told.code for told in names_against_times(mixed)]
    assert names_against_times([*first, *second]) == ()


def test_photos_of_two_people_that_are_named_through_each_other_are_told(tmp_path: Path) -> None:
    """Each walked a way of his own, and where the ways meet photos that follow each other stand far too near."""
    first, second = photos(tmp_path, list(range(12)), camera="A"), photos(tmp_path, list(range(12)), camera="B")
    (told,) = names_against_times([path for pair in zip(first, second, strict=True) for path in pair])
    assert told.code == CaptureCode.cameras_alternate
    assert sentence(told).startswith("photos of A and B alternate by name: 23 of 24 follow one of another camera")
    # A few of another phone, or one phone after the other, are no walk of two.
    assert names_against_times([*first, *second[:6]]) == ()
    assert names_against_times([*first[:6], *second[:3], *first[6:], *second[3:]]) == ()
    # Some apps do not write which phone it was.
    nameless = photos(tmp_path, list(range(12)), camera="")
    (told,) = names_against_times([path for pair in zip(first, nameless, strict=True) for path in pair])
    assert sentence(told).startswith("photos of A and a camera without a name alternate by name")


def test_a_moment_has_decimals_and_may_be_none(tmp_path: Path) -> None:
    assert taken_at(photo(tmp_path / "a.jpg", 5, decimals="12")) == (" Phone", "2026:05:04 10:00:05.12")
    assert taken_at(photo(tmp_path / "b.jpg", None)) is None
    empty = Image.Exif()
    empty.get_ifd(0x8769)[0x9003] = "0000:00:00 00:00:00"
    Image.new("RGB", (20, 20)).save(tmp_path / "c.jpg", exif=empty)
    assert taken_at(tmp_path / "c.jpg") is None
    (tmp_path / "d.jpg").write_text("no photo")
    assert taken_at(tmp_path / "d.jpg") is None


def test_the_choice_of_frames_says_so(tmp_path: Path) -> None:
    photos(tmp_path / "in", list(SHUFFLED))
    result = select_frames(tmp_path / "in", tmp_path / "out")
    assert CaptureCode.names_not_by_time in [warning.code for warning in result.warnings]

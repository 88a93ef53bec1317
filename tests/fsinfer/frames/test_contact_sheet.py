"""The sheet of frames that were not used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import ImageDraw

from fsinfer.frames.contact_sheet import TILE_PX, Tile, thumbnail, write_contact_sheet
from fsinfer.io.images import read_image

COLOURS = [(200, 30, 30), (30, 200, 30), (30, 30, 200), (200, 200, 30), (30, 200, 200), (200, 30, 200), (120, 90, 60)]


def tile(colour: tuple[int, int, int], name: str = "a.jpg", reason: str = "blurred") -> Tile:
    return Tile(image=np.full((300, 400, 3), colour, np.uint8), name=name, reason=reason)


def test_every_dropped_frame_has_its_place_in_rows_of_five(tmp_path: Path) -> None:
    path = tmp_path / "dropped.jpg"
    tiles = [tile(colour) for colour in COLOURS]
    tiles[3] = Tile(image=None, name="d.jpg", reason="cannot be read")
    write_contact_sheet(path, tiles, total=30)
    sheet = read_image(path).astype(int)
    for index, colour in enumerate(COLOURS):
        x, y = 8 + index % 5 * (TILE_PX + 8), 40 + index // 5 * (TILE_PX + 48)
        middle = sheet[y + 30 : y + 150, x + 30 : x + 210]
        expected = (205, 205, 205) if index == 3 else colour
        assert np.abs(middle - expected).max() < 12, index
        # Name in grey and reason in red below each picture.
        below = sheet[y + TILE_PX : y + TILE_PX + 36, x : x + 100]
        assert (below.max(axis=2) < 140).sum() > 20, index
        assert ((below[..., 0] - below[..., 2]) > 80).sum() > 20, index


def test_a_long_list_is_cut_and_says_so(tmp_path: Path) -> None:
    short, long = tmp_path / "short.jpg", tmp_path / "long.jpg"
    write_contact_sheet(short, [tile(COLOURS[0])] * 60, total=100)
    write_contact_sheet(long, [tile(COLOURS[0])] * 75, total=100)
    one, other = read_image(short), read_image(long)
    assert one.shape == other.shape
    ink = [(picture[:40].max(axis=2) < 128).sum() for picture in (one, other)]
    assert ink[1] > 1.3 * ink[0]


def test_one_frame_was_and_two_were(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[str] = []
    monkeypatch.setattr(ImageDraw.ImageDraw, "text", lambda _, place, text, **style: written.append(text))
    for count in (1, 2):
        write_contact_sheet(tmp_path / "dropped.jpg", [tile(COLOURS[0])] * count, total=9)
    assert "1 of 9 frames was not used" in written
    assert "2 of 9 frames were not used" in written


def test_nothing_dropped_leaves_no_sheet_of_an_earlier_run(tmp_path: Path) -> None:
    path = tmp_path / "dropped.jpg"
    write_contact_sheet(path, [tile(COLOURS[0], "x" * 80, "y" * 80)], total=2)
    assert path.exists()
    write_contact_sheet(path, [], total=2)
    assert not path.exists()
    write_contact_sheet(path, [], total=2)


def test_thumbnails_fit_and_small_pictures_stay_as_they_are() -> None:
    assert thumbnail(np.zeros((1200, 900, 3), np.uint8)).shape == (TILE_PX, 180, 3)
    small = np.random.default_rng(0).integers(0, 255, (100, 130, 3), dtype=np.uint8)
    np.testing.assert_array_equal(thumbnail(small), small)

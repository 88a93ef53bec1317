"""A picture of the frames that were not used, each with its reason, so that a person can object at a glance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.frames.small import small_copy
from fsinfer.io.images import write_image
from fsinfer.notices.numbers import noun

#: Longest side of a picture on the sheet, pixels. Source: layout.
TILE_PX = 240
#: Room for the text and between the tiles, tiles a row, and tiles at most. Source: layout.
_TEXT_PX, _MARGIN_PX, _COLUMNS, _MOST = 40, 8, 5, 60
#: Size of the letters, distance of two lines, pixels; letters of a line. Source: layout.
_FONT_PX, _LINE_PX, _LINE_LETTERS = 13, 17, 34
#: Paper, empty tile, name and reason, RGB. Source: layout.
_PAPER, _EMPTY, _NAME, _REASON = (245, 245, 245), (205, 205, 205), (60, 60, 60), (180, 40, 0)
#: JPEG quality of the sheet. Source: layout.
_QUALITY = 85


@dataclass(frozen=True, kw_only=True)
class Tile:
    """A small picture (H, W, 3) uint8 RGB, None where it could not be read, its name, and why it was dropped."""

    image: NDArray[np.uint8] | None
    name: str
    reason: str


def thumbnail(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The (H, W, 3) RGB picture made to fit a tile."""
    return small_copy(image, TILE_PX)


def write_contact_sheet(path: Path, tiles: Sequence[Tile], *, total: int) -> None:
    """Write the dropped frames as one JPEG; no file (and none of an earlier run) where nothing was dropped.

    Parameters
    ----------
    total: how many frames there were.
    """
    from PIL import Image, ImageDraw, ImageFont

    if not tiles:
        path.unlink(missing_ok=True)
        return
    shown = tiles[:_MOST]
    columns = min(_COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    cell_w, cell_h = TILE_PX + _MARGIN_PX, TILE_PX + _TEXT_PX + _MARGIN_PX
    width = max(columns * cell_w + _MARGIN_PX, 2 * TILE_PX)
    sheet = Image.new("RGB", (width, rows * cell_h + _TEXT_PX + _MARGIN_PX), _PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(_FONT_PX)
    were = noun(len(tiles), "was", "were")
    more = f"; the first {len(shown)} are shown" if len(shown) < len(tiles) else ""
    draw.text((_MARGIN_PX, 10), f"{len(tiles)} of {total} frames {were} not used{more}", fill=(0, 0, 0), font=font)
    for index, tile in enumerate(shown):
        x = _MARGIN_PX + index % columns * cell_w
        y = _TEXT_PX + index // columns * cell_h
        if tile.image is None:
            draw.rectangle((x, y, x + TILE_PX, y + TILE_PX * 3 // 4), fill=_EMPTY)
        else:
            small = Image.fromarray(np.ascontiguousarray(thumbnail(tile.image)))
            sheet.paste(small, (x, y))
        draw.text((x, y + TILE_PX), _fitting(tile.name), fill=_NAME, font=font)
        draw.text((x, y + TILE_PX + _LINE_PX), _fitting(tile.reason), fill=_REASON, font=font)
    write_image(path, np.asarray(sheet, dtype=np.uint8), quality=_QUALITY)


def _fitting(text: str) -> str:
    return text if len(text) <= _LINE_LETTERS else text[: _LINE_LETTERS - 3] + "..."

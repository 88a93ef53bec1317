"""Pieces of HTML. Every text goes through :func:`escape`; nothing refers to another file or to the network."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

_MIME = {".png": "image/png", ".jpg": "image/jpeg", ".webp": "image/webp"}


def escape(text: object) -> str:
    """Escape text for element content and quoted attributes."""
    return html.escape(str(text), quote=True)


def section(title: str, *parts: str, anchor: str) -> str:
    """Return a section with a heading; ``parts`` are HTML."""
    return f'<section id="{escape(anchor)}"><h2>{escape(title)}</h2>{"".join(parts)}</section>'


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph of plain text; ``kind`` is a CSS class."""
    return f'<p class="{escape(kind)}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def bullets(texts: Iterable[str], kind: str = "") -> str:
    """Return a list of plain texts; empty for none."""
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f'<ul class="{escape(kind)}">{items}</ul>' if items else ""


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """Return a two-column table of names and values."""
    body = "".join(f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>' for name, value in rows)
    return f'<table class="facts"><tbody>{body}</tbody></table>'


def sortable_table(
    head: Sequence[str],
    rows: Iterable[Sequence[tuple[str, str]]],
    kinds: Sequence[str],
    *,
    ids: Sequence[int | None],
    label: str,
) -> str:
    """Return a table that sorts by the buttons in its head.

    Parameters
    ----------
    rows: cells of (shown text, sort key); an empty key sorts last. The first cell becomes a button to the tree's card.
    kinds: CSS class of each row.
    ids: number of the tree of each row; None for a row without one.
    label: what the table holds, for those who hear it.
    """
    top = "".join(f'<th scope="col"><button type="button">{escape(text)}</button></th>' for text in head)
    body = []
    for row, kind, tree_id in zip(rows, kinds, ids, strict=True):
        cells = []
        for column, (text, key) in enumerate(row):
            shown = escape(text)
            if column == 0 and tree_id is not None:
                shown = f'<button type="button" data-card="{tree_id}" aria-label="Show tree {tree_id}">{shown}</button>'
            kind_of_cell = ' class="number"' if _is_number(key) and column > 0 else ""
            cells.append(f'<td{kind_of_cell} data-key="{escape(key)}">{shown}</td>')
        mark = "" if tree_id is None else f' data-tree="{tree_id}"'
        body.append(f'<tr class="{escape(kind)}"{mark}>{"".join(cells)}</tr>')
    return (
        f'<div class="wide" tabindex="0" role="region" aria-label="{escape(label)}"><table class="sortable">'
        f"<thead><tr>{top}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
    )


def embedded_image(image: NDArray[np.uint8], caption: str, *, suffix: str = ".jpg", alt: str | None = None) -> str:
    """Return a figure with an (H, W, 3) RGB image inside the page; ``alt`` is said in its place, else the caption."""
    options = {".jpg": [cv2.IMWRITE_JPEG_QUALITY, 82], ".webp": [cv2.IMWRITE_WEBP_QUALITY, 78]}.get(suffix, [])
    _, data = cv2.imencode(suffix, np.ascontiguousarray(image[..., ::-1]), options)
    return _figure(_MIME[suffix], data.tobytes(), caption, alt or caption)


def shrink(image: NDArray[np.uint8], width_px: int) -> NDArray[np.uint8]:
    """An (H, W, 3) image that is at most ``width_px`` wide."""
    height, width = image.shape[:2]
    if width <= width_px:
        return image
    size = (width_px, max(1, round(height * width_px / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _figure(mime: str, data: bytes, caption: str, alt: str) -> str:
    source = f"data:{mime};base64,{base64.b64encode(data).decode('ascii')}"
    return f'<figure><img alt="{escape(alt)}" src="{source}"><figcaption>{escape(caption)}</figcaption></figure>'

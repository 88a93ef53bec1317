"""Pieces of HTML. Every text goes through :func:`escape`; nothing refers to another file or to the network."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

_MIME = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}


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
    body = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    return f'<table class="facts"><tbody>{body}</tbody></table>'


def sortable_table(head: Sequence[str], rows: Iterable[Sequence[tuple[str, str]]], kinds: Sequence[str]) -> str:
    """Return a table that sorts at a click on its head.

    Parameters
    ----------
    rows: cells of (shown text, sort key); an empty key sorts last.
    kinds: CSS class of each row.
    """
    top = "".join(f'<th tabindex="0" role="button">{escape(text)}</th>' for text in head)
    body = "".join(
        f'<tr class="{escape(kind)}">'
        + "".join(f'<td data-key="{escape(key)}">{escape(text)}</td>' for text, key in row)
        + "</tr>"
        for row, kind in zip(rows, kinds, strict=True)
    )
    return f'<div class="wide"><table class="sortable"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def embedded_file(path: Path, caption: str) -> str:
    """Return a figure with the image file inside the page; a sentence where the file cannot be read."""
    try:
        data = path.read_bytes()
    except OSError as error:
        return paragraph(f"{path.name} could not be read ({error.strerror or error}).", "missing")
    return _figure(_MIME.get(path.suffix.lower(), "image/png"), data, caption)


def embedded_image(image: NDArray[np.uint8], caption: str, *, suffix: str = ".jpg") -> str:
    """Return a figure with an (H, W, 3) RGB image inside the page."""
    options = [cv2.IMWRITE_JPEG_QUALITY, 82] if suffix == ".jpg" else []
    _, data = cv2.imencode(suffix, np.ascontiguousarray(image[..., ::-1]), options)
    return _figure(_MIME[suffix], data.tobytes(), caption)


def _figure(mime: str, data: bytes, caption: str) -> str:
    source = f"data:{mime};base64,{base64.b64encode(data).decode('ascii')}"
    return f'<figure><img alt="{escape(caption)}" src="{source}"><figcaption>{escape(caption)}</figcaption></figure>'

"""A few depth maps in the report, beside their photos."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import FsinferError
from fsinfer.io.images import read_image
from fsinfer.io.pfm import read_pfm
from fsinfer.report.contents import Contents
from fsinfer.report.html import embedded_image, paragraph, section, shrink
from fsinfer.report.previews import depth_preview
from fsinfer.scene import IMAGE_SUFFIXES

DEPTH_SAMPLES = 3
SAMPLE_WIDTH_PX = 640


def depth_section(contents: Contents) -> str:
    """Return a few depth maps beside their photos."""
    paths = sorted((contents.out / "depth").glob("*.pfm"))
    if not paths:
        return section("Depth samples", paragraph("There are no depth maps in this folder.", "missing"), anchor="depth")
    middle = [paths[int((i + 0.5) * len(paths) / DEPTH_SAMPLES)] for i in range(min(DEPTH_SAMPLES, len(paths)))]
    parts = [paragraph(f"{len(middle)} of {len(paths)}. Red is near, blue is far, grey has no depth.", "note")]
    for path in dict.fromkeys(middle):
        try:
            picture = depth_preview(read_pfm(path))
            photo = _photo(contents.out, path.stem)
        except FsinferError as error:
            parts.append(paragraph(f"{path.name} could not be shown: {error}", "missing"))
            continue
        figures = [embedded_image(shrink(picture, SAMPLE_WIDTH_PX), f"Depth of {path.stem}", suffix=".webp")]
        if photo is not None:
            figures.insert(0, embedded_image(shrink(photo, SAMPLE_WIDTH_PX), f"Photo {path.stem}", suffix=".webp"))
        parts.append(f'<div class="pair">{"".join(figures)}</div>')
    return section("Depth samples", *parts, anchor="depth")


def _photo(out: Path, name: str) -> NDArray[np.uint8] | None:
    folders = (out / "scene" / "images", out / "images")
    path = next((p for f in folders for s in IMAGE_SUFFIXES if (p := f / f"{name}{s}").is_file()), None)
    return None if path is None else read_image(path)

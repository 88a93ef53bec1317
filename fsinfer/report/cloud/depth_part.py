"""A few depth maps in the report, beside their photos."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import FsinferError
from fsinfer.io.images import read_image
from fsinfer.io.pfm import read_pfm
from fsinfer.report.cloud.previews import depth_preview
from fsinfer.report.contents import Contents
from fsinfer.report.page import Part, missing_part
from fsinfer.report.picture import Picture, picture_of, shrink
from fsinfer.scene import IMAGE_SUFFIXES

#: Views whose depth is shown, and the width of their pictures. Source: layout.
DEPTH_SAMPLES, SAMPLE_WIDTH_PX = 3, 640
_ANCHOR, _TITLE = "depth", "Depth samples"


@dataclass(frozen=True, kw_only=True)
class DepthSample:
    """A photo and its depth map; without pictures, why there are none."""

    pictures: tuple[Picture, ...]
    missing: str = ""


@dataclass(frozen=True, kw_only=True)
class DepthView:
    """The samples, out of ``maps`` depth maps."""

    samples: tuple[DepthSample, ...]
    maps: int


def depth_part(contents: Contents) -> Part:
    """A few depth maps beside their photos."""
    paths = sorted((contents.out / "depth").glob("*.pfm"))
    if not paths:
        return missing_part(_ANCHOR, _TITLE, "There are no depth maps in this folder.")
    middle = [paths[int((i + 0.5) * len(paths) / DEPTH_SAMPLES)] for i in range(min(DEPTH_SAMPLES, len(paths)))]
    samples = tuple(_sample(contents.out, path) for path in dict.fromkeys(middle))
    return Part(anchor=_ANCHOR, title=_TITLE, view=DepthView(samples=samples, maps=len(paths)))


def _sample(out: Path, path: Path) -> DepthSample:
    try:
        depth = depth_preview(read_pfm(path))
        photo = _photo(out, path.stem)
    except FsinferError as error:
        return DepthSample(pictures=(), missing=f"{path.name} could not be shown: {error}")
    pictures = [] if photo is None else [picture_of(shrink(photo, SAMPLE_WIDTH_PX), f"Photo {path.stem}")]
    pictures.append(picture_of(shrink(depth, SAMPLE_WIDTH_PX), f"Depth of {path.stem}"))
    return DepthSample(pictures=tuple(pictures))


def _photo(out: Path, name: str) -> NDArray[np.uint8] | None:
    folders = (out / "scene" / "images", out / "images")
    path = next((p for f in folders for s in IMAGE_SUFFIXES if (p := f / f"{name}{s}").is_file()), None)
    return None if path is None else read_image(path)

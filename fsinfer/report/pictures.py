"""The cloud and the depth maps in the report."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.cloud import PointCloud, read_cloud
from fsinfer.errors import FsinferError
from fsinfer.images import read_image
from fsinfer.pfm import read_pfm
from fsinfer.previews import cloud_view, depth_preview
from fsinfer.report.contents import Contents
from fsinfer.report.html import embedded_image, paragraph, section
from fsinfer.report.scatter import scatter
from fsinfer.scene import IMAGE_SUFFIXES

DEPTH_SAMPLES = 3
SAMPLE_WIDTH_PX = 640


def cloud_section(contents: Contents) -> str:
    """Return views of the cloud from above and from the side, and the cloud to turn in 3-D."""
    out = contents.out
    path = next((p for p in (out / "cloud.ply", out / "cloud.laz", out / "fused" / "cloud.ply") if p.is_file()), None)
    title, anchor = "Point cloud", "cloud"
    if path is None:
        return section(title, paragraph("There is no point cloud in this folder.", "missing"), anchor=anchor)
    try:
        cloud = read_cloud(path)
    except FsinferError as error:
        return section(title, paragraph(f"The cloud could not be shown: {error}", "missing"), anchor=anchor)
    unit = "m" if contents.metric else "model units"
    size = np.ptp(np.percentile(cloud.xyz, [1, 99], axis=0), axis=0)
    text = f"{path.name}: {len(cloud):,} points; most lie within {size[0]:.1f} × {size[1]:.1f} × {size[2]:.1f} {unit}."
    if path.parent != out:
        text += " It is not levelled: 'above' may not be up."
    return section(
        title,
        paragraph(text, "note"),
        '<div class="pair">',
        embedded_image(cloud_view(cloud, "top"), "From above (x to the right, y up)"),
        embedded_image(cloud_view(cloud, "side"), "From the side (x to the right, z up)"),
        "</div>",
        _scatter(cloud, unit),
        anchor=anchor,
    )


def depth_section(contents: Contents) -> str:
    """Return a few depth maps beside their photos."""
    paths = sorted((contents.out / "depth").glob("*.pfm"))
    if not paths:
        return section("Depth maps", paragraph("There are no depth maps in this folder.", "missing"), anchor="depth")
    middle = [paths[int((i + 0.5) * len(paths) / DEPTH_SAMPLES)] for i in range(min(DEPTH_SAMPLES, len(paths)))]
    parts = [paragraph(f"{len(middle)} of {len(paths)}. Red is near, blue is far, grey has no depth.", "note")]
    for path in dict.fromkeys(middle):
        try:
            picture = depth_preview(read_pfm(path))
            photo = _photo(contents.out, path.stem)
        except FsinferError as error:
            parts.append(paragraph(f"{path.name} could not be shown: {error}", "missing"))
            continue
        figures = [embedded_image(_shrink(picture), f"Depth of {path.stem}")]
        if photo is not None:
            figures.insert(0, embedded_image(_shrink(photo), f"Photo {path.stem}"))
        parts.append(f'<div class="pair">{"".join(figures)}</div>')
    return section("Depth maps", *parts, anchor="depth")


def _scatter(cloud: PointCloud, unit: str) -> str:
    plot = scatter(cloud, unit)
    if plot is None:
        return paragraph(
            "To turn the cloud here, install plotly (pip install plotly) and make the report again.", "note"
        )
    return "<h3>Turn it yourself</h3>" + plot


def _photo(out: Path, name: str) -> NDArray[np.uint8] | None:
    folders = (out / "scene" / "images", out / "images")
    path = next((p for f in folders for s in IMAGE_SUFFIXES if (p := f / f"{name}{s}").is_file()), None)
    return None if path is None else read_image(path)


def _shrink(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = image.shape[:2]
    if width <= SAMPLE_WIDTH_PX:
        return image
    size = (SAMPLE_WIDTH_PX, max(1, round(height * SAMPLE_WIDTH_PX / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)

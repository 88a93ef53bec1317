"""The point cloud in the report: a viewer to turn it, and two still pictures for paper and old browsers."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from fsinfer.errors import FsinferError
from fsinfer.io.cloud import PointCloud
from fsinfer.report.cloud_data import MAX_POINTS, ViewerData, encode_cloud, read_some
from fsinfer.report.contents import Contents, number
from fsinfer.report.html import embedded_image, escape, paragraph, section
from fsinfer.report.previews import cloud_view

_MODES = (("rgb", "Photo colours"), ("height", "Height"), ("tree", "Tree"), ("confidence", "Confidence"))
# The labelled cloud comes first: it knows which point belongs to which tree.
_FILES = ("trees.laz", "cloud.ply", "cloud.laz", "fused/cloud.ply")
_TITLE, _ANCHOR = "Point cloud", "cloud"


def cloud_section(contents: Contents, *, max_points: int = MAX_POINTS) -> str:
    """Return the section with viewer and stills; a sentence where there is no cloud or it cannot be read."""
    path = next((p for name in _FILES if (p := contents.out / name).is_file()), None)
    if path is None:
        return section(_TITLE, paragraph("There is no point cloud in this folder.", "missing"), anchor=_ANCHOR)
    try:
        cloud, count = read_some(path)
    except FsinferError as error:
        return section(_TITLE, paragraph(f"The cloud could not be shown: {error}", "missing"), anchor=_ANCHOR)
    levelled = path.parent == contents.out
    unit = "m" if contents.metric else "model units"
    size = np.ptp(np.percentile(cloud.xyz, [1, 99], axis=0), axis=0)
    data = encode_cloud(cloud, max_points=max_points)
    text = f"{count:,} points; most lie within {size[0]:.1f} × {size[1]:.1f} × {size[2]:.1f} {unit}."
    if data.points < count:
        text += f" The viewer shows {data.points:,} of them, chosen evenly."
    if not levelled:
        text += " It is not levelled: 'above' may not be up."
    return section(
        _TITLE,
        paragraph(text, "note"),
        _viewer(contents, data, cloud, path, unit),
        '<div class="pair still">',
        embedded_image(cloud_view(cloud, "top", size_px=800), "From above (x to the right, y up)", suffix=".webp"),
        embedded_image(cloud_view(cloud, "side", size_px=800), "From the side (x to the right, z up)", suffix=".webp"),
        "</div>",
        anchor=_ANCHOR,
    )


def _viewer(contents: Contents, data: ViewerData, cloud: PointCloud, path: Path, unit: str) -> str:
    available = [(mode, name) for mode, name in _MODES if mode == "height" or mode in data.parts]
    modes = "".join(
        f'<button type="button" data-mode="{mode}" aria-pressed="false">{name}</button>' for mode, name in available
    )
    help_text = (
        "Drag or use the arrow keys to turn; drag with Shift, the right button or two fingers to move; wheel (after a "
        "click into the cloud), two fingers or + and − to zoom; Home to start over."
    )
    return (
        '<div class="viewer" id="viewer"><div class="bar"><div class="group" role="group" aria-label="Colour by">'
        f"<label>Colour by</label>{modes}</div>"
        '<div class="group" role="group" aria-label="Look from"><label>From</label>'
        '<button type="button" data-look="top">Above</button><button type="button" data-look="side">Side</button>'
        '<button type="button" data-look="home">Start</button></div>'
        '<div class="group"><label for="point-size">Point size</label>'
        '<input id="point-size" data-size type="range" min="-2" max="2" step="0.25" value="0"></div></div>'
        '<div class="stage"><canvas tabindex="0" role="img" aria-label="Point cloud of the plot. '
        f'{escape(help_text)}"></canvas><div class="names" aria-hidden="true"></div></div>'
        f'<p class="note key" aria-live="polite"></p><p class="note">{escape(help_text)}</p>'
        f'<script type="application/json" id="viewer-info">{_info(contents, data, cloud, path, unit)}</script>'
        f'<script type="text/plain" id="viewer-cloud">{data.base64}</script></div>'
    )


def _info(contents: Contents, data: ViewerData, cloud: PointCloud, path: Path, unit: str) -> str:
    low, high = np.percentile(cloud.xyz, [2, 98], axis=0)
    plan = float(max(high[0] - low[0], high[1] - low[1], 1e-9))
    per_cloud = 1.0 if path.name == "trees.laz" else 1.0 / contents.trees_per_cloud
    metre = contents.metre
    trees = []
    for tree in contents.trees or () if path.parent == contents.out else ():
        values = [number(tree.get(name)) for name in ("tree_id", "x_m", "y_m", "z_ground_m")]
        if any(value is None for value in values):
            continue
        tree_id, x, y, z = (value for value in values if value is not None)
        # The number stands a little above breast height, where the stem is surely seen.
        at = [per_cloud * x, per_cloud * y, per_cloud * z + 1.6 * metre]
        trees.append({"id": int(tree_id), "at": [round(value, 3) for value in at]})
    info = {
        "points": data.points,
        "low": data.low,
        "step": data.step,
        "parts": data.parts,
        "unit": unit,
        "middle": [(a + b) / 2 for a, b in zip(low.tolist(), high.tolist(), strict=True)],
        "ground": float(low[2]),
        "extent": max(plan, float(high[2] - low[2])),
        "metre": metre,
        # Side of a square for each point of a plot seen from above, a little more so that they touch.
        "spacing": 1.5 * plan / math.sqrt(max(data.points, 1)),
        "trees": trees,
    }
    return json.dumps(info).replace("<", "\\u003c")

"""The point cloud in the report: a viewer to turn it, and two still pictures for paper and old browsers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fsinfer.errors import FsinferError
from fsinfer.io.cloud import PointCloud
from fsinfer.report.cloud.data import MAX_POINTS, ViewerData, encode_cloud, read_some
from fsinfer.report.cloud.previews import cloud_view
from fsinfer.report.contents import Contents, number
from fsinfer.report.page import Part, missing_part
from fsinfer.report.picture import Picture, picture_of

_MODES = (("rgb", "Photo colours"), ("height", "Height"), ("tree", "Tree"), ("confidence", "Confidence"))
# The labelled cloud comes first: it knows which point belongs to which tree.
_FILES = ("trees.laz", "cloud.ply", "cloud.laz", "fused/cloud.ply")
_ANCHOR, _TITLE = "cloud", "Point cloud"


@dataclass(frozen=True, kw_only=True)
class TreeLabel:
    """A number that the viewer shows at ``at``, in the frame of the cloud."""

    id: int
    at: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class ViewerInfo:
    """What ``viewer.js`` reads beside the points; lengths in units of the cloud.

    Attributes
    ----------
    points, low, step, parts: as in :class:`fsinfer.report.cloud.data.ViewerData`.
    unit: name of the unit of length.
    middle: the viewer computes relative to it.
    ground: height of the ground.
    extent: side of what there is to see.
    metre: length of a metre.
    spacing: side of the square that a point stands for.
    """

    points: int
    low: tuple[float, float, float]
    step: float
    parts: tuple[str, ...]
    unit: str
    middle: tuple[float, float, float]
    ground: float
    extent: float
    metre: float
    spacing: float
    trees: tuple[TreeLabel, ...]


@dataclass(frozen=True, kw_only=True)
class CloudView:
    """What the section shows.

    Attributes
    ----------
    told: what is known of the cloud.
    modes: (name, shown text) of the colours that the viewer offers.
    points_base64: as the viewer reads them.
    stills: pictures for paper and for browsers without WebGL.
    """

    told: str
    modes: tuple[tuple[str, str], ...]
    info: ViewerInfo
    points_base64: str
    stills: tuple[Picture, ...]


@dataclass(frozen=True, kw_only=True)
class DrawnCloud:
    """The cloud in ``path``, of which ``count`` points are known and ``cloud`` are held, and its still pictures."""

    path: Path
    cloud: PointCloud
    count: int
    stills: tuple[Picture, ...]


def draw_cloud(contents: Contents) -> DrawnCloud | Part:
    """Read the cloud and draw the stills, or say why there is none: what does not hang on how much room there is."""
    path = next((p for name in _FILES if (p := contents.out / name).is_file()), None)
    if path is None:
        return missing_part(_ANCHOR, _TITLE, "There is no point cloud in this folder.")
    try:
        cloud, count = read_some(path)
    except FsinferError as error:
        return missing_part(_ANCHOR, _TITLE, f"The cloud could not be shown: {error}")
    stills = (
        picture_of(cloud_view(cloud, "top", size_px=800), "From above (x to the right, y up)"),
        picture_of(cloud_view(cloud, "side", size_px=800), "From the side (x to the right, z up)"),
    )
    return DrawnCloud(path=path, cloud=cloud, count=count, stills=stills)


def cloud_part(contents: Contents, drawn: DrawnCloud | Part | None = None, *, max_points: int = MAX_POINTS) -> Part:
    """The viewer and the stills; a sentence where there is no cloud or it cannot be read. ``drawn`` if it was."""
    drawn = drawn or draw_cloud(contents)
    if isinstance(drawn, Part):
        return drawn
    path, cloud, count = drawn.path, drawn.cloud, drawn.count
    unit = "m" if contents.metric else "model units"
    size = np.ptp(np.percentile(cloud.xyz, [1, 99], axis=0), axis=0)
    data = encode_cloud(cloud, max_points=max_points)
    told = f"{count:,} points; most lie within {size[0]:.1f} × {size[1]:.1f} × {size[2]:.1f} {unit}."
    if data.points < count:
        told += f" The viewer shows {data.points:,} of them, chosen evenly."
    if path.parent != contents.out:
        told += " It is not levelled: 'above' may not be up."
    view = CloudView(
        told=told,
        modes=tuple((mode, name) for mode, name in _MODES if mode == "height" or mode in data.parts),
        info=_info(contents, data, cloud, path, unit),
        points_base64=data.base64,
        stills=drawn.stills,
    )
    return Part(anchor=_ANCHOR, title=_TITLE, view=view)


def _info(contents: Contents, data: ViewerData, cloud: PointCloud, path: Path, unit: str) -> ViewerInfo:
    low, high = np.percentile(cloud.xyz, [2, 98], axis=0)
    plan = float(max(high[0] - low[0], high[1] - low[1], 1e-9))
    middle = (low + high) / 2
    return ViewerInfo(
        points=data.points,
        low=data.low,
        step=data.step,
        parts=data.parts,
        unit=unit,
        middle=(float(middle[0]), float(middle[1]), float(middle[2])),
        ground=float(low[2]),
        extent=max(plan, float(high[2] - low[2])),
        metre=contents.metre,
        # A little more than the side of the square, so that they touch.
        spacing=1.5 * plan / math.sqrt(max(data.points, 1)),
        trees=tuple(_labels(contents, path)) if path.parent == contents.out else (),
    )


def _labels(contents: Contents, path: Path) -> Iterator[TreeLabel]:
    per_cloud = 1.0 if path.name == "trees.laz" else 1.0 / contents.trees_per_cloud
    for tree in contents.trees or ():
        values = [number(tree.get(name)) for name in ("tree_id", "x_m", "y_m", "z_ground_m")]
        if any(value is None for value in values):
            continue
        tree_id, x, y, z = (value for value in values if value is not None)
        # The number stands a little above breast height, where the stem is surely seen.
        above = per_cloud * z + 1.6 * contents.metre
        yield TreeLabel(id=int(tree_id), at=(round(per_cloud * x, 3), round(per_cloud * y, 3), round(above, 3)))

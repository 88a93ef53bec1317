"""What the scale of a chunk of Metashape stands on, as far as its file tells: markers, scale bars, or camera positions.

Metashape takes the positions that phones and drones note in their photographs for references of the cameras, and puts
the chunk to metres by them without being asked. Over a plot such positions are hardly better than the plot is wide.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable

import numpy as np

from fsinfer.importers.foreign import Floats

#: Error of a noted position along each axis where the file tells none, metres. Source: van Diggelen and Enge (2015),
#: 4.9 m for phones under open sky; under trees it is more.
_GNSS_M = 5.0
#: Markers with coordinates that tell a scale. Source: geometry; a length has two ends.
_LEAST_MARKERS = 2
#: Positions of one walk err alike for minutes, so that no more of them count as independent. Source: judgement.
_INDEPENDENT = 4
#: From here on a per cent is told without decimals, and more than all of a length is not told. Source: layout.
_WHOLE_PERCENT, _ALL_PERCENT = 1.0, 100.0


def doubt_of_scale(chunk: ElementTree.Element, centers: Floats) -> str | None:
    """What to tell of a scale that stands on camera positions alone, with its error; None of any other one.

    ``centers`` (N, 3) are the cameras that are used, in metres. The error is that of the scale in a least squares fit
    of a similarity, with the standard deviation s along each axis and the distances r from the middle: s over the root
    of the sum of r² (Horn 1987).
    """
    markers = sum(1 for item in chunk.findall("./markers//marker/reference") if _has(item, "x", "y"))
    bars = [item for item in chunk.findall("./scalebars//scalebar/reference") if _has(item, "distance")]
    cameras = [item for item in chunk.findall("./cameras//camera/reference") if _has(item, "x", "y")]
    if markers >= _LEAST_MARKERS or bars or not cameras:
        return None
    error_m = _error_m(chunk, cameras)
    spread_m = float(np.sqrt(np.square(centers - centers.mean(axis=0)).sum(axis=1).mean()))
    count = min(_INDEPENDENT, len(cameras), len(centers))
    share = error_m / (math.sqrt(count) * spread_m) if spread_m > 0 else math.inf
    percent = min(100 * share, _ALL_PERCENT)
    told = f"{percent:.0f}" if percent >= _WHOLE_PERCENT else f"{percent:.1g}"
    return (
        "the file has neither markers with coordinates nor scale bars, so that its metres stand on the positions of "
        f"the cameras (GNSS), which are good to {error_m:g} m; over this walk lengths and all DBH may be wrong by "
        f"{told} %, and no interval has that in it; use a board (--aruco-length-m), a length in the photographs "
        "(fsinfer scale --click) or a measured one (--scale) with fsinfer trees"
    )


def _error_m(chunk: ElementTree.Element, cameras: Iterable[ElementTree.Element]) -> float:
    """Error of a position: the median of those that cameras have, else that of the chunk, else that of phones."""
    own = [_number(item.get("sxyz") or item.get("sx")) for item in cameras]
    told = [value for value in own if value is not None]
    if told:
        return float(np.median(told))
    for item in chunk.findall("./settings/property"):
        value = _number(item.get("value")) if item.get("name") == "accuracy_cameras" else None
        if value is not None:
            return value
    return _GNSS_M


def _has(reference: ElementTree.Element, *names: str) -> bool:
    return reference.get("enabled") not in ("false", "0") and all(reference.get(name) for name in names)


def _number(text: str | None) -> float | None:
    """A length above zero; None for anything else: a doubt is no reason to refuse a file."""
    try:
        value = float((text or "").split("/")[0])
    except ValueError:
        return None
    return value if math.isfinite(value) and value > 0 else None

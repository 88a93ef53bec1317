"""Where a scale can hardly be right, or its error is not known: said in warnings, each with the way out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import CAMERA_HEIGHT_M

if TYPE_CHECKING:
    from fsinfer.scale.scale import Scale

# Nobody holds a phone lower or higher than this, all through a plot: kneeling, or on a stick.
LIKELY_HEIGHTS_M = (0.4, 3.5)


def doubt_endpoints(request: ScaleRequest, plot: Mapping[str, Any]) -> tuple[str, ...]:
    """Warn where end points may have been read off a cloud that was in metres already.

    Parameters
    ----------
    plot: ``plot.json`` of the output folder as the run found it; {} where there is none.
    """
    m_per_unit = plot.get("scale_m_per_unit")
    if request.endpoints is None or request.length_m is None or not m_per_unit:
        return ()
    before = (plot.get("scale_details") or {}).get("endpoints")
    if before is not None and [tuple(map(float, point)) for point in before] == [*request.endpoints]:
        return ()
    stretch = request.length_m / math.dist(*request.endpoints)
    height_m = plot.get("camera_height")
    if height_m and height_m > 0:
        # Which of the two has the photos taken nearer to the height at which people hold a phone?
        metric, units = height_m * stretch, height_m / m_per_unit * stretch
        if not _likely(metric) or _oddness(units) < _oddness(metric):
            return ()
    factor = m_per_unit * stretch
    return (
        "the end points count in the model units of the cloud without a scale, and cloud.ply was in metres before this "
        f"run; if they were read off that cloud, the scale is wrong now: give --scale {factor:.6g} instead",
    )


def _oddness(camera_height_m: float) -> float:
    return abs(math.log(camera_height_m / CAMERA_HEIGHT_M))


def _likely(camera_height_m: float) -> bool:
    low, high = LIKELY_HEIGHTS_M
    return low <= camera_height_m <= high


def doubt_height(camera_height_m: float | None) -> tuple[str, ...]:
    """Warn where the scale would have the photographs taken from a height at which nobody holds a camera."""
    if camera_height_m is None or _likely(camera_height_m):
        return ()
    shown = f"{camera_height_m:.0f}" if camera_height_m >= 10 else f"{camera_height_m:.2g}"
    hint = "; was the length given in centimetres?" if _likely(camera_height_m / 100) else ""
    return (
        f"with this scale the photos were taken {shown} m above the ground (a phone is held at about "
        f"{CAMERA_HEIGHT_M:g} m): the scale, and with it every DBH, is probably wrong; look at the length given{hint}",
    )


def unknown_error(source: str, rel_std: float | None) -> tuple[str, ...]:
    """Say that the intervals do not contain the error of a scale of which none is known."""
    if source != "factor" or rel_std is not None:
        return ()
    return (
        "the error of a scale given as a number is not known: it is not in the intervals, and one per cent of it is "
        "one per cent of every DBH",
    )


def boards_at_two_places(boards: Scale, m_per_unit: float) -> list[str]:
    """One sentence for each board number found at several places: the sign of photos that were placed wrongly.

    ``m_per_unit`` are metres per unit of the scene, guessed where the scale is not known.
    """
    lines = []
    found = boards.details.get("markers", [])
    for number in sorted({entry["id"] for entry in found}):
        places = sorted((entry for entry in found if entry["id"] == number), key=lambda entry: -len(entry["views"]))
        for other in places[1:]:
            apart_m = m_per_unit * float(np.linalg.norm(np.subtract(other["center"], places[0]["center"])))
            views = sorted(other["views"])
            lines.append(
                f"Board {number} was found at two places {apart_m:.1f} m apart. Unless two boards have this number, "
                f"photos were placed wrongly, perhaps {views[0]} to {views[-1]}, and what is said of the trees cannot "
                "be trusted: take more photos there and on the way there, and turn slowly."
            )
    return lines

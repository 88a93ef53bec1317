"""Metres per scene unit: from a factor, from the known distance of two points, or from ArUco markers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fsinfer.errors import ScaleError
from fsinfer.geometry.triangulation import triangulate

if TYPE_CHECKING:
    from fsinfer.scene import Scene


if TYPE_CHECKING:
    from fsinfer.scene import Scene

__all__ = [
    "Scale",
    "check_length",
    "scale_from_clicks",
    "scale_from_endpoints",
    "scale_from_factor",
]

# A click on a photograph shown full screen lands within about two pixels of what was meant.
CLICK_SIGMA_PX = 2.0
# Picked in a viewer, the end of a stick in a cloud from photographs is hit to about a centimetre.
PICK_SIGMA_M = 0.01


@dataclass(frozen=True, kw_only=True)
class Scale:
    """The metric scale of a scene.

    Attributes
    ----------
    m_per_unit: metres per scene unit, or None where it is not known.
    source: ``none``, ``factor``, ``endpoints`` or ``aruco``.
    rel_std: relative standard deviation of ``m_per_unit``, or None where nothing is known about it.
    details: what it was made from; JSON values only.
    """

    m_per_unit: float | None
    source: str
    rel_std: float | None
    details: dict[str, Any] = field(default_factory=dict)


def scale_from_factor(m_per_unit: float) -> Scale:
    """Take the scale as given.

    Raises
    ------
    ScaleError
        It is not a positive number.
    """
    check_length(m_per_unit, "the scale")
    return Scale(m_per_unit=float(m_per_unit), source="factor", rel_std=None)


def scale_from_endpoints(first: Sequence[float], second: Sequence[float], length_m: float) -> Scale:
    """``s = L_real / L_model`` (the paper's equation) from two points of the model.

    Parameters
    ----------
    first, second: (3,) points in scene units.
    length_m: their real distance, metres.

    Returns
    -------
    Source ``endpoints``; ``rel_std`` is that of two points picked in a cloud, a centimetre each.

    Raises
    ------
    ScaleError
        The points coincide or are not finite, or the length is not positive.
    """
    check_length(length_m, "the length")
    if len(first) != 3 or len(second) != 3 or not np.isfinite([*first, *second]).all():
        msg = f"the end points {first} and {second} are not two points of three finite numbers; give X,Y,Z twice"
        raise ScaleError(msg)
    points = np.array([first, second], dtype=np.float64)
    length_units = float(np.linalg.norm(points[1] - points[0]))
    if not length_units > 1e-12 * float(np.abs(points).max()):
        msg = f"the end points {first} and {second} are the same; give the two ends of the {length_m} m length"
        raise ScaleError(msg)
    details = {"endpoints": points.tolist(), "length_units": length_units, "length_m": float(length_m)}
    rel_std = math.sqrt(2) * PICK_SIGMA_M / length_m
    return Scale(m_per_unit=length_m / length_units, source="endpoints", rel_std=rel_std, details=details)


def scale_from_clicks(scene: Scene, clicks: Mapping[str, Sequence[tuple[float, float]]], length_m: float) -> Scale:
    """Scale from the two ends of a known length clicked in two or more photographs of the scene.

    Parameters
    ----------
    scene: its views are named in ``clicks``.
    clicks: ``{view name: [(u, v) of the first end, (u, v) of the second end]}``, pixels of the scene image, the
        centre of the top left pixel is (0, 0).
    length_m: real distance of the two ends, metres.

    Returns
    -------
    Source ``endpoints``; ``rel_std`` follows from two pixels of clicking error and the angles of the rays.

    Raises
    ------
    ScaleError
        Fewer than two views, a view that is not in the scene, or rays that do not meet.
    """
    check_length(length_m, "the length")
    cameras = {view.name: view.camera for view in scene.views}
    unknown = sorted(set(clicks) - set(cameras))
    if unknown:
        msg = f"{unknown[0]} is no view of {scene.folder}; its views are {', '.join(sorted(cameras)[:5])}, ..."
        raise ScaleError(msg)
    if len(clicks) < 2 or any(len(ends) != 2 for ends in clicks.values()):
        msg = f"the ends were clicked in {len(clicks)} photos; click both ends in at least two photos"
        raise ScaleError(msg)
    projections = [cameras[name].intrinsic @ cameras[name].cam_from_world[:3] for name in clicks]
    ends, covariances, errors_px = [], [], []
    for end in range(2):
        pixels = np.array([clicks[name][end] for name in clicks], dtype=np.float64)
        point = triangulate(projections, pixels)
        if point is None or point.max_error_px > 10 * CLICK_SIGMA_PX:
            far = "do not meet" if point is None else f"miss each other by {point.max_error_px:.0f} pixels"
            msg = f"the rays to end {end + 1} of the length {far}; click the same spot in photos from different places"
            raise ScaleError(msg)
        ends.append(point.xyz)
        covariances.append(point.covariance * CLICK_SIGMA_PX**2)
        errors_px.append(point.max_error_px)
    scale = scale_from_endpoints(ends[0].tolist(), ends[1].tolist(), length_m)
    direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    std_units = math.sqrt(float(direction @ (covariances[0] + covariances[1]) @ direction))
    details = scale.details | {"views": list(clicks), "errors_px": errors_px}
    rel_std = std_units / float(scale.details["length_units"])
    return Scale(m_per_unit=scale.m_per_unit, source="endpoints", rel_std=rel_std, details=details)


def check_length(value: float, what: str) -> None:
    """Raise :class:`ScaleError` unless ``value`` is a positive number; ``what`` names it."""
    if not (math.isfinite(value) and value > 0):
        msg = f"{what} is {value}; give a number above 0"
        raise ScaleError(msg)


#: Where a standing person holds a phone: the guess at a metre while the scale is unknown.
CAMERA_HEIGHT_M = 1.5


def marker_centers(scale: Mapping[str, Any], cloud_from_scene: ArrayLike) -> NDArray[np.float64]:
    """Centres of the markers of a scale record in the frame of the cloud: (M, 3), M = 0 without markers.

    Parameters
    ----------
    scale: the record of the scale stage; ``details["markers"][i]["center"]`` is in scene units.
    cloud_from_scene: (4, 4) similarity.
    """
    centers = np.array([marker["center"] for marker in scale.get("details", {}).get("markers", [])]).reshape(-1, 3)
    similarity = np.asarray(cloud_from_scene, dtype=np.float64)
    return np.asarray(centers @ similarity[:3, :3].T + similarity[:3, 3])

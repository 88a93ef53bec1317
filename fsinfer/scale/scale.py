"""Metres per scene unit, what they were made from, and how well they are known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fsinfer.errors import ScaleError
from fsinfer.geometry.similarity import apply
from fsinfer.scale.request import Point

__all__ = [
    "Scale",
    "check_length",
    "scale_from_factor",
]

#: Height at which a standing person holds a phone: the guess at a metre while the scale is unknown. Source: adults.
CAMERA_HEIGHT_M = 1.5


class BoardVerdict(StrEnum):
    """What the other boards say of one: ``outvoted`` by a majority, or ``contradicted`` where there is none."""

    agrees = "agrees"
    outvoted = "outvoted"
    contradicted = "contradicted"


@dataclass(frozen=True, kw_only=True)
class MarkerScale:
    """What one marker says of the scale.

    Attributes
    ----------
    id: its number. views: names of the photographs that it was used in.
    center: in scene units. normal: unit vector away from the print.
    length_m: true side of the black square; side_units: the same in the scene.
    m_per_unit, rel_std: the scale by this marker alone, and its relative standard deviation.
    residual_rel, residual_mm: how much longer its side comes out with the scale of all.
    error_px: root mean square distance of its corners in the images.
    near_side_px: of the five largest images of its side the smallest: what the photographs from near by can measure.
    angle_deg: largest angle between the rays of its views.
    leave_one_out_m_per_unit, leave_one_out_rel: the scale without this marker; None where it is the only one.
    verdict: of the other boards on it.
    """

    id: int
    views: tuple[str, ...]
    center: Point
    length_m: float
    side_units: float
    m_per_unit: float
    rel_std: float
    residual_rel: float
    residual_mm: float
    error_px: float
    near_side_px: float
    angle_deg: float
    leave_one_out_m_per_unit: float | None
    leave_one_out_rel: float | None
    normal: Point | None = None
    verdict: BoardVerdict = BoardVerdict.agrees


@dataclass(frozen=True, kw_only=True)
class RejectedMarker:
    """A marker number that could not be used, and why."""

    id: int
    reason: str


class NoUsableMarkersError(ScaleError):
    """No marker gives the scale; ``rejected`` are the numbers that were seen all the same, and why they do not."""

    def __init__(self, message: str, rejected: Sequence[RejectedMarker]) -> None:
        super().__init__(message)
        self.rejected = tuple(rejected)


@dataclass(frozen=True, kw_only=True)
class MarkerDetails:
    """A scale by ArUco markers.

    Attributes
    ----------
    photos_searched, photos_with_markers: numbers of photographs.
    dictionary: of the markers.
    length_m: side of every marker; None where their numbers tell it.
    rejected: numbers that could not be used.
    mean_side_px: of all detections; edge_rel_std: what blooming may add to it, common to all.
    edge_shift_px: how far the camera draws black edges outwards, which was undone; None where too few markers tell.
    markers: each one's say.
    """

    photos_searched: int
    photos_with_markers: int
    dictionary: str
    length_m: float | None
    rejected: tuple[RejectedMarker, ...]
    mean_side_px: float
    edge_rel_std: float
    edge_shift_px: float | None = None
    markers: tuple[MarkerScale, ...]


@dataclass(frozen=True, kw_only=True)
class EndpointDetails:
    """A scale by the two ends of a known length; ``views`` and ``errors_px`` where they were clicked in photographs."""

    endpoints: tuple[Point, Point]
    length_units: float
    length_m: float
    views: tuple[str, ...] = ()
    errors_px: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Scale:
    """The metric scale of a scene.

    Attributes
    ----------
    m_per_unit: metres per scene unit, or None where it is not known.
    source: ``none``, ``factor``, ``endpoints`` or ``aruco``.
    rel_std: relative standard deviation of ``m_per_unit``, or None where nothing is known about it.
    details: what it was made from; None for a factor, or none.
    """

    m_per_unit: float | None
    source: str
    rel_std: float | None
    details: MarkerDetails | EndpointDetails | None = None

    @property
    def markers(self) -> tuple[MarkerScale, ...]:
        """The markers that it was made from; empty where it comes from elsewhere."""
        return self.details.markers if isinstance(self.details, MarkerDetails) else ()

    @property
    def rejected(self) -> tuple[RejectedMarker, ...]:
        """The marker numbers that could not be used."""
        return self.details.rejected if isinstance(self.details, MarkerDetails) else ()


#: No scale is known.
UNKNOWN = Scale(m_per_unit=None, source="none", rel_std=None)


def scale_from_factor(m_per_unit: float) -> Scale:
    """Take the scale as given.

    Raises
    ------
    ScaleError
        It is not a positive number.
    """
    check_length(m_per_unit, "the scale")
    return Scale(m_per_unit=float(m_per_unit), source="factor", rel_std=None)


def check_length(value: float, what: str) -> None:
    """Raise :class:`ScaleError` unless ``value`` is a positive number; ``what`` names it."""
    if not (math.isfinite(value) and value > 0):
        msg = f"{what} is {value}; give a number above 0"
        raise ScaleError(msg)


def marker_centers(scale: Scale, cloud_from_scene: ArrayLike) -> NDArray[np.float64]:
    """Centres of the markers of a scale in the frame of the cloud: (M, 3), M = 0 without markers.

    ``cloud_from_scene``: (4, 4) similarity from the scene to the cloud.
    """
    centers = np.array([marker.center for marker in scale.markers], dtype=np.float64).reshape(-1, 3)
    similarity = np.asarray(cloud_from_scene, dtype=np.float64)
    return apply(similarity, centers)

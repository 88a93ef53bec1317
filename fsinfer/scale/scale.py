"""Metres per scene unit: from a factor, from the known distance of two points, or from ArUco markers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fsinfer.errors import ScaleError
from fsinfer.geometry.similarity import apply
from fsinfer.geometry.triangulation import TriangulatedPoint, triangulate
from fsinfer.scale.agreement import agreement
from fsinfer.scale.request import Point
from fsinfer.scale.square_fit import MarkerSettings

if TYPE_CHECKING:
    from fsinfer.scene import Scene

__all__ = [
    "Scale",
    "check_length",
    "scale_from_clicks",
    "scale_from_endpoints",
    "scale_from_factor",
]

#: A click on a photograph shown full screen lands within about so many pixels of what was meant. Source: judgement.
CLICK_SIGMA_PX = 2.0
#: Picked in a viewer, the end of a stick in a cloud from photographs is hit to so much. Source: judgement.
PICK_SIGMA_M = 0.01
#: Rays that miss each other by so many standard deviations of a click do not meet. Source: judgement.
_MEETING_SIGMAS = 10
#: Rays that miss each other by so many standard deviations of a click more than others fit clearly worse. Source:
#: judgement; no click is off by so much.
_WORSE_SIGMAS = 5
#: End points nearer to each other than this share of their coordinates are the same. Source: numerics.
_SAME_POINT = 1e-12
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


def scale_from_endpoints(
    first: Sequence[float], second: Sequence[float], length_m: float, *, settings: MarkerSettings | None = None
) -> Scale:
    """``s = L_real / L_model`` (the paper's equation) from two points of the model.

    Parameters
    ----------
    first, second: (3,) points in scene units.
    length_m: their real distance, metres.
    settings: how well a length is known, and the model's warp.

    Returns
    -------
    Source ``endpoints``; ``rel_std`` is that of two points picked in a cloud, a centimetre each, with the warp of the
    model and the error of the length itself, as for one board (:func:`fsinfer.scale.agreement.agreement`).

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
    if not length_units > _SAME_POINT * float(np.abs(points).max()):
        msg = f"the end points {first} and {second} are the same; give the two ends of the {length_m} m length"
        raise ScaleError(msg)
    details = _end_details(points, length_units, length_m)
    return _of_one_length(details, math.sqrt(2) * PICK_SIGMA_M / length_m, settings)


def scale_from_clicks(
    scene: Scene,
    clicks: Mapping[str, Sequence[tuple[float, float]]],
    length_m: float,
    *,
    settings: MarkerSettings | None = None,
) -> Scale:
    """Scale from the two ends of a known length clicked in two or more photographs of the scene.

    Parameters
    ----------
    scene: its views are named in ``clicks``.
    clicks: ``{view name: [(u, v) of the first end, (u, v) of the second end]}``, pixels of the scene image, the
        centre of the top left pixel is (0, 0).
    length_m: real distance of the two ends, metres.
    settings: how well a length is known, and the model's warp.

    Returns
    -------
    Source ``endpoints``; ``rel_std`` follows from the angles of the rays and the clicking error: two pixels, or what
    the clicks miss the ends by where that is more. The warp of the model and the error of the length itself are in
    it, as for one board (:func:`fsinfer.scale.agreement.agreement`).

    Raises
    ------
    ScaleError
        Fewer than two views, a view that is not in the scene, rays that do not meet, or two views whose rays meet as
        well with the ends of one of them exchanged, so that two lengths fit the clicks.
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
    pixels = np.array([clicks[name] for name in clicks], dtype=np.float64)
    ends, covariances, errors_px = [], [], []
    for end in range(2):
        point = triangulate(projections, pixels[:, end])
        if point is None or not _meets(point):
            far = "do not meet" if point is None else f"miss each other by {point.max_error_px:.0f} pixels"
            msg = f"the rays to end {end + 1} of the length {far}; click the same spot in photos from different places"
            raise ScaleError(msg)
        ends.append(point.xyz)
        # Two numbers a photograph against three of the point: what they miss by tells of worse clicks.
        missed_px2 = float((point.errors_px**2).sum()) / (2 * len(clicks) - 3)
        covariances.append(point.covariance * max(CLICK_SIGMA_PX**2, missed_px2))
        errors_px.append(point.max_error_px)
    if len(clicks) == 2 and _meets_exchanged(projections, pixels, max(errors_px)):
        first, second = clicks
        msg = (
            f"photos {first} and {second} fit together whichever end was clicked first in {second}, and give another "
            "length each; click both ends in a third photo too, taken from another direction"
        )
        raise ScaleError(msg)
    # Ends that are one point are no length.
    scale_from_endpoints(ends[0].tolist(), ends[1].tolist(), length_m)
    direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    std_units = math.sqrt(float(direction @ (covariances[0] + covariances[1]) @ direction))
    length_units = float(np.linalg.norm(ends[1] - ends[0]))
    details = replace(
        _end_details(np.array(ends), length_units, length_m), views=tuple(clicks), errors_px=tuple(errors_px)
    )
    return _of_one_length(details, std_units / length_units, settings)


def _of_one_length(details: EndpointDetails, ends_rel_std: float, settings: MarkerSettings | None) -> Scale:
    """The scale by one length; ``ends_rel_std`` is what its ends are off by, as a share of it.

    Where it stands the model may be larger or smaller than elsewhere, which one length shows no more than one board.
    """
    m_per_unit = details.length_m / details.length_units
    alone = agreement(np.array([m_per_unit]), np.array([ends_rel_std]), settings or MarkerSettings())
    return Scale(m_per_unit=m_per_unit, source="endpoints", rel_std=alone.rel_std, details=details)


def _meets(point: TriangulatedPoint) -> bool:
    return point.max_error_px <= _MEETING_SIGMAS * CLICK_SIGMA_PX


def _meets_exchanged(projections: Sequence[NDArray[np.float64]], pixels: NDArray[np.float64], missed_px: float) -> bool:
    """Whether the rays of two views meet, and not clearly worse, with the two ends exchanged in the second.

    A length that lies along the line from one camera to the other has both ends on one epipolar line: each pair of
    its rays meets somewhere before the cameras, and nothing in the pictures says which pairs are one end's.

    Parameters
    ----------
    projections: two matrices K [R | t], (3, 4). pixels: (2, 2, 2), of each view both ends. missed_px: by which the rays
        miss the ends as they were clicked.
    """
    exchanged = np.stack([pixels[0], pixels[1, ::-1]])
    points = [triangulate(projections, exchanged[:, end]) for end in range(2)]
    # A short length upright between the cameras misses by half its pixels, which the tolerance may hold: no doubt yet.
    most_px = missed_px + _WORSE_SIGMAS * CLICK_SIGMA_PX
    return all(point is not None and _meets(point) and point.max_error_px <= most_px for point in points)


def _end_details(ends: NDArray[np.float64], length_units: float, length_m: float) -> EndpointDetails:
    first, second = ((float(x), float(y), float(z)) for x, y, z in ends)
    return EndpointDetails(endpoints=(first, second), length_units=length_units, length_m=float(length_m))


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

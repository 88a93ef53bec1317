"""Scale from the known distance of two points: picked in the cloud, or clicked in photographs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ScaleError
from fsinfer.geometry.triangulation import TriangulatedPoint, triangulate
from fsinfer.notices.numbers import counted
from fsinfer.scale.agreement import agreement
from fsinfer.scale.scale import EndpointDetails, Scale, check_length
from fsinfer.scale.square_fit import MarkerSettings

if TYPE_CHECKING:
    from fsinfer.scene import Scene

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
    details = _end_details(first, second, length_m)
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
        many = counted(len(clicks), "photo", "photos")
        msg = f"the ends were clicked in {many}; click both ends in at least two photos"
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
    details = replace(
        _end_details(ends[0].tolist(), ends[1].tolist(), length_m), views=tuple(clicks), errors_px=tuple(errors_px)
    )
    direction = (ends[1] - ends[0]) / details.length_units
    std_units = math.sqrt(float(direction @ (covariances[0] + covariances[1]) @ direction))
    return _of_one_length(details, std_units / details.length_units, settings)


def _of_one_length(details: EndpointDetails, ends_rel_std: float, settings: MarkerSettings | None) -> Scale:
    """The scale by one length; ``ends_rel_std`` is what its ends are off by, as a share of it.

    Where it stands the model may be larger or smaller than elsewhere, which one length shows no more than one board.
    That is guessed from other plots, with few degrees of freedom; how well ends are hit is known, and is added to it.
    """
    m_per_unit = details.length_m / details.length_units
    alone = agreement(np.array([m_per_unit]), np.zeros(1), settings or MarkerSettings())
    rel_std = math.hypot(alone.rel_std, ends_rel_std)
    return Scale(m_per_unit=m_per_unit, source="endpoints", rel_std=rel_std, details=details)


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


def _end_details(first: Sequence[float], second: Sequence[float], length_m: float) -> EndpointDetails:
    """The two ends of the length in the model; :class:`ScaleError` where they are none."""
    if len(first) != 3 or len(second) != 3 or not np.isfinite([*first, *second]).all():
        msg = f"the end points {first} and {second} are not two points of three finite numbers; give X,Y,Z twice"
        raise ScaleError(msg)
    points = np.array([first, second], dtype=np.float64)
    length_units = float(np.linalg.norm(points[1] - points[0]))
    if not length_units > _SAME_POINT * float(np.abs(points).max()):
        msg = f"the end points {first} and {second} are the same; give the two ends of the {length_m} m length"
        raise ScaleError(msg)
    one, other = ((float(x), float(y), float(z)) for x, y, z in points)
    return EndpointDetails(endpoints=(one, other), length_units=length_units, length_m=float(length_m))

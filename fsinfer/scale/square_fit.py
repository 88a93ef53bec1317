"""One ArUco marker in space from its corners in several views: a square of unknown side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fsinfer.geometry.triangulation import triangulate
from fsinfer.notices.numbers import counted


@dataclass(frozen=True, kw_only=True)
class MarkerSettings:
    """Constants of marker measurement.

    Attributes
    ----------
    min_views: a marker seen in fewer views is not trusted. Source: two views always agree along the epipolar line.
    min_side_px: smaller detections are noise of leaves, and a pixel is too much of them. Source: judgement.
    gate_side_share, gate_px: a detection belongs to a marker when its corners lie within this share of its side, or
        so many pixels if that is more. Source: judgement.
    min_angle_deg: largest angle between the rays of a marker's views; below, depth and with it size are guesses.
        Source: judgement.
    max_side_spread: sides of the freely triangulated square may differ by this share; false detections do. Source:
        judgement.
    max_off_plane: and its corners lie off their plane by this share of the side. Source: judgement.
    length_rel_std: of the printed length; common to all markers. Source: half a millimetre on a quarter of a metre.
    warp_rel_std: by which the model is larger or smaller at a board than over all, which no residual shows. Source:
        boards of one plot taken with a phone differ by 0.1 to 0.3 %; with three or four rendered boards the scale was
        right to 0.05 %.
    warp_dof: ``warp_rel_std`` counts as much as the spread of so many boards more. Source: judgement; it leaves one
        plot in twenty with a warp of more than 0.9 %.
    contradiction_stds, contradiction_rel: boards contradict each other whose scales differ by more than so many
        standard deviations and by more than this share. Source: judgement; a print that was fitted to the page is 3 to
        6 % smaller, boards of one plot differ by 0.1 to 0.3 %, and of simulated models with a warp of 1 % at each of
        three boards one in eleven loses a board by this.
    edge_std_px: how far blooming and the camera's tone curve may shift the edge between black and white; common to
        all edges, and the reason to go near the markers. Where the markers tell the shift it is undone. Source:
        judgement.
    min_blooming: sightings that must tell the shift. Source: judgement.
    least_bloom_std_px: what they tell is known no better. Source: simulated markers of 30 to 50 pixels.
    bloom_varies: share of the shift by which small and large sightings differ. Source: simulated markers of 24 and 50
        pixels, blurred by 0.8 pixels before the tone curve: 0.38 and 0.53.
    least_corner_std_px: a corner is hit no better. Source: judgement; OpenCV's refinement promises about a tenth.
    """

    min_views: int = 3
    min_side_px: float = 12.0
    gate_side_share: float = 0.06
    gate_px: float = 2.5
    min_angle_deg: float = 3.0
    max_side_spread: float = 0.12
    max_off_plane: float = 0.08
    length_rel_std: float = 0.002
    warp_rel_std: float = 0.002
    warp_dof: float = 2.0
    contradiction_stds: float = 4.0
    contradiction_rel: float = 0.03
    edge_std_px: float = 0.07
    min_blooming: int = 5
    least_bloom_std_px: float = 0.03
    bloom_varies: float = 0.2
    least_corner_std_px: float = 0.1


#: Pairs of detections that are tried for one number. Source: numerics.
_MOST_PAIRS = 150
#: Residual from which the robust loss grows linearly, pixels. Source: judgement.
_SOFT_PX = 0.5
#: Condition of the normal equations from which there is no solution, and depths that stand for none. Source: numerics.
_WORST_CONDITION, _LEAST_DEPTH = 1e14, 1e-12
#: Corners of a unit square round its centre, in the order in which OpenCV gives them (clockwise from top left, x right
#: and y down in the plane of the print). Source: format.
_UNIT_SQUARE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """One detection: the corners of marker ``marker_id`` in view ``view``, (4, 2) float64 pixels, in printed order.

    ``bloom_px`` is how far its edges stand outwards as far as it tells, see :mod:`fsinfer.scale.blooming`.
    """

    marker_id: int
    view: int
    corners_px: NDArray[np.float64]
    bloom_px: float | None = None

    @property
    def side_px(self) -> float:
        """Mean side length in the image."""
        return float(np.linalg.norm(self.corners_px - np.roll(self.corners_px, 1, axis=0), axis=1).mean())


@dataclass(frozen=True, kw_only=True)
class FittedMarker:
    """A marker in space.

    Attributes
    ----------
    corners: (4, 3) float64 of the fitted square, scene units.
    side_units: its side, scene units.
    side_rel_std: relative standard deviation of the side from the pixel residuals, at least ``least_corner_std_px``.
    error_px: root mean square distance of the corners in the images.
    angle_deg: largest angle between rays.
    sightings: the detections that it was made from.
    """

    corners: NDArray[np.float64]
    side_units: float
    side_rel_std: float
    error_px: float
    angle_deg: float
    sightings: tuple[Sighting, ...]


def find_markers(
    sightings: Sequence[Sighting],
    projections: Sequence[NDArray[np.float64]],
    centers: NDArray[np.float64],
    settings: MarkerSettings,
) -> tuple[list[FittedMarker], list[str]]:
    """Find the markers behind the detections of ONE number; the same number may hang in several places.

    Pairs of detections give hypotheses; the one that most views agree with is fitted and its detections are taken
    away, until too few are left.

    Parameters
    ----------
    sightings: all of one marker number.
    projections: K [R | t] of every view, (3, 4) float64.
    centers: (V, 3) float64.

    Returns
    -------
    The markers, and for what was rejected the reasons.
    """
    left = list(sightings)
    found: list[FittedMarker] = []
    reasons: list[str] = []
    while len({sighting.view for sighting in left}) >= settings.min_views:
        members = _best_group(left, projections, settings)
        if len(members) < settings.min_views:
            break
        left = [sighting for sighting in left if not any(sighting is member for member in members)]
        fitted = _fit_square(members, projections, centers, settings)
        reason = "the corners do not make a square" if fitted is None else _objection(fitted, projections, settings)
        if fitted is not None and not reason:
            found.append(fitted)
        else:
            reasons.append(f"{len(members)} views: {reason}")
    if left:
        reasons.append(f"{counted(len(left), 'view', 'views')}: fewer than {settings.min_views} agree on one place")
    return found, reasons


def _best_group(
    sightings: Sequence[Sighting], projections: Sequence[NDArray[np.float64]], settings: MarkerSettings
) -> list[Sighting]:
    pairs = [pair for pair in combinations(sightings, 2) if pair[0].view != pair[1].view]
    if len(pairs) > _MOST_PAIRS:
        chosen = np.random.default_rng(0).choice(len(pairs), _MOST_PAIRS, replace=False)
        pairs = [pairs[index] for index in chosen]
    matrices = np.array([projections[sighting.view] for sighting in sightings])
    pixels = np.array([sighting.corners_px for sighting in sightings])
    views = np.array([sighting.view for sighting in sightings])
    sides = np.array([sighting.side_px for sighting in sightings])
    gates = np.maximum(settings.gate_px, settings.gate_side_share * sides)
    best, best_error = np.zeros(0, np.intp), np.inf
    for pair in pairs:
        corners = _corners_in_space(pair, projections)
        if corners is None:
            continue
        errors = _corner_errors_px(corners, matrices, pixels)
        near = np.flatnonzero(errors < gates)
        near = near[np.lexsort((errors[near], views[near]))]
        # Of each view the detection that fits best.
        own = near[np.unique(views[near], return_index=True)[1]]
        total = float(errors[own].sum())
        if len(own) > len(best) or (len(own) == len(best) and total < best_error):
            best, best_error = own, total
    return [sightings[index] for index in np.sort(best)]


def _corners_in_space(
    members: Sequence[Sighting], projections: Sequence[NDArray[np.float64]]
) -> NDArray[np.float64] | None:
    """(4, 3), each corner on its own; None where one cannot be triangulated."""
    corners = []
    for corner in range(4):
        pixels = np.array([member.corners_px[corner] for member in members])
        point = triangulate([projections[member.view] for member in members], pixels)
        if point is None:
            return None
        corners.append(point.xyz)
    return np.array(corners)


def _corner_errors_px(
    corners: NDArray[np.float64], projections: NDArray[np.float64], pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Of detections (N, 4, 2) in views (N, 3, 4) the largest distance of a corner from where the square in space (4, 3)
    is seen, (N,); infinite behind the camera.
    """
    projected = corners @ projections[:, :, :3].transpose(0, 2, 1) + projections[:, None, :, 3]
    behind = np.asarray((projected[..., 2] <= 0).any(axis=1), np.bool_)
    depth = np.where(behind[:, None], 1.0, projected[..., 2])
    apart = np.linalg.norm(projected[..., :2] / depth[..., None] - pixels, axis=2).max(axis=1)
    return np.asarray(np.where(behind, np.inf, apart), np.float64)


def _fit_square(
    members: Sequence[Sighting],
    projections: Sequence[NDArray[np.float64]],
    centers: NDArray[np.float64],
    settings: MarkerSettings,
) -> FittedMarker | None:
    """Least squares of centre, rotation and logarithm of the side on all corners, with a robust loss."""
    start = _corners_in_space(members, projections)
    if start is None:
        return None
    side = float(np.linalg.norm(start - np.roll(start, 1, axis=0), axis=1).mean())
    axes = np.stack([start[1] + start[2] - start[0] - start[3], start[2] + start[3] - start[0] - start[1]])
    left, _, right = np.linalg.svd(axes, full_matrices=False)
    axes = left @ right
    rotation = np.column_stack([axes[0], axes[1], np.cross(axes[0], axes[1])])
    if side <= 0 or not np.isfinite(rotation).all():
        return None
    center = start.mean(axis=0)
    matrices = np.stack([projections[member.view] for member in members])
    pixels = np.stack([member.corners_px for member in members])

    def square(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        turned = Rotation.from_rotvec(parameters[3:6]).as_matrix() @ rotation
        local = _UNIT_SQUARE * (side * np.exp(parameters[6]))
        return np.asarray(center + side * parameters[:3] + local @ turned.T)

    def residuals(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        projected = np.einsum("vij,cj->vci", matrices[:, :, :3], square(parameters)) + matrices[:, None, :, 3]
        depth = np.where(np.abs(projected[..., 2:]) < _LEAST_DEPTH, _LEAST_DEPTH, projected[..., 2:])
        return np.asarray((projected[..., :2] / depth - pixels).ravel())

    fit = least_squares(residuals, np.zeros(7), loss="soft_l1", f_scale=_SOFT_PX)
    errors = residuals(fit.x)
    error_px = float(np.sqrt(2 * np.mean(errors**2)))
    normal = fit.jac.T @ fit.jac
    if np.linalg.cond(normal) > _WORST_CONDITION:
        return None
    # The parameters are taken from the degrees of freedom.
    sigma_px = max(settings.least_corner_std_px, float(np.sqrt((errors**2).sum() / max(1, len(errors) - len(fit.x)))))
    rel_std = sigma_px * float(np.sqrt(np.linalg.inv(normal)[6, 6]))
    corners = square(fit.x)
    rays = corners.mean(axis=0) - centers[[member.view for member in members]]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    angle_deg = float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1))))
    return FittedMarker(
        corners=corners,
        side_units=side * float(np.exp(fit.x[6])),
        side_rel_std=rel_std,
        error_px=error_px,
        angle_deg=angle_deg,
        sightings=tuple(members),
    )


def _objection(fitted: FittedMarker, projections: Sequence[NDArray[np.float64]], settings: MarkerSettings) -> str:
    """Why a fitted marker is not believed; empty where it is."""
    if fitted.angle_deg < settings.min_angle_deg:
        return f"seen within {fitted.angle_deg:.1f} degrees only; photograph it from places further apart"
    if any(_area_px2(sighting.corners_px) <= 0 for sighting in fitted.sightings):
        return "it is seen mirrored"
    free = _corners_in_space(fitted.sightings, projections)
    if free is None:
        return "the rays to its corners do not meet"
    sides = np.linalg.norm(free - np.roll(free, 1, axis=0), axis=1)
    if sides.max() - sides.min() > settings.max_side_spread * sides.mean():
        return f"its sides differ by {100 * (sides.max() - sides.min()) / sides.mean():.0f} %"
    offset = free - free.mean(axis=0)
    off_plane = float(np.abs(offset @ np.linalg.svd(offset)[2][2]).max())
    if off_plane > settings.max_off_plane * sides.mean():
        return f"its corners lie {100 * off_plane / sides.mean():.0f} % of its side off a plane"
    mean_side_px = float(np.mean([sighting.side_px for sighting in fitted.sightings]))
    if fitted.error_px > max(settings.gate_px, settings.gate_side_share * mean_side_px):
        return f"its corners are {fitted.error_px:.1f} pixels off"
    return ""


def _area_px2(corners_px: NDArray[np.float64]) -> float:
    """Signed area of the quadrilateral, positive when clockwise in the image (y down)."""
    x, y = corners_px[:, 0], corners_px[:, 1]
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)

"""The paper's circle in a thin slice at breast height, perpendicular to the stem's axis.

FS-MVSNet (Forests 2025, 16, 927): slice 1.3 m +- 1.5 cm, least squares, residuals above 1.5 cm dropped, random
subsamples fused (:mod:`fsinfer.trees.diameter.circle`). Sparse clouds get a wider slice.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.trees.cylinder.axis import AxisFit, AxisSettings, axis_coordinates, harmonics
from fsinfer.trees.diameter.circle import LEAST_POINTS, CircleSettings, covered_bins, fit_circle
from fsinfer.trees.points.cells import count_cells, rows
from fsinfer.trees.points.sums import lengths, weighted_sum
from fsinfer.trees.points.surface import PATCH_M, SECTORS, WALL_SIGMAS

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


#: Points so near to a height, in metres, hold every slice across a leaning stem there. Source: numerics.
SLAB_HALF_M = 0.25
#: A slice is not taken for thinner evidence than of this share of the circumference. Source: numerics.
LEAST_COVERAGE = 0.05


@dataclass(frozen=True, kw_only=True)
class SliceSettings:
    """Constants of :func:`fit_slice`.

    Attributes
    ----------
    half_slices_m: half of a slice's thickness; the next where the cloud is sparse. Source: Forests 2025, 16, 927 for
        the first; not recorded for the wider ones.
    slice_error_m: a slice is thick enough when sigma / sqrt(n * coverage) falls below this. Source: not recorded.
    min_seen: and when it shows this share of what the longer piece of the stem shows. Source: not recorded.
    circle: of the circle in the slice.
    """

    half_slices_m: tuple[float, ...] = (0.015, 0.03, 0.05, 0.10)
    slice_error_m: float = 0.002
    min_seen: float = 0.85
    circle: CircleSettings = field(default_factory=CircleSettings)


@dataclass(frozen=True, kw_only=True)
class Slice:
    """The points of a slice and the circle through them, in metres about the stem's axis.

    ``offsets_m`` (M, 2) in the plane perpendicular to the axis, taper and harmonics taken out; ``seen_m`` (M, 2) the
    same with the harmonics, as the stem is; ``kept`` (M,) those the circle used; ``circle_m`` (3,) its x, y, radius;
    ``half_m`` half of the slice's thickness. ``radius_m`` is None, and ``std_m`` NaN, where no circle could be fitted:
    then ``circle_m`` is that of the axis fit.
    """

    offsets_m: Floats
    seen_m: Floats
    kept: Bools
    circle_m: Floats
    half_m: float
    radius_m: float | None = None
    std_m: float = float("nan")


def fit_slice(
    points: Floats,
    fit: AxisFit,
    height: float,
    coverage: float,
    *,
    settings: SliceSettings | None = None,
    seed: int = 0,
) -> Slice:
    """The paper's fused circle in the thinnest slice about ``height`` that suffices.

    ``points`` (N, 3) are x, y, height above ground in metres, ``fit`` the axis to which the slice is perpendicular,
    ``coverage`` in [0, 1] the share of the circumference that the fit saw.
    """
    s = settings or SliceSettings()
    taper = float(fit.parameters[5])
    near = rows(points, np.abs(points[:, 2] - height) <= SLAB_HALF_M)
    offset, foot = axis_coordinates(near, fit.parameters, height)
    distance = lengths(offset)
    unit = offset / np.maximum(distance, 1e-6)[:, None]
    shape = weighted_sum(fit.shape_m, harmonics(unit[:, 0], unit[:, 1], len(fit.shape_m)).T)
    residual = distance - fit.radius_m - taper * foot - shape
    reach = np.abs(residual) <= AxisSettings().window_m
    offset, foot, distance, residual = rows(offset, reach), foot[reach], distance[reach], residual[reach]
    # Taper and shape are taken out, so that the circle meets a round section and only sees the local difference.
    as_seen, offset = (
        offset * (1.0 - excess / np.maximum(distance, 1e-6))[:, None]
        for excess in (taper * foot, taper * foot + shape[reach])
    )
    limit = _slice_limit(fit, s)
    plain = np.array([0.0, 0.0, fit.radius_m])
    none = np.zeros(len(offset), dtype=bool)
    last = Slice(offsets_m=offset, seen_m=as_seen, kept=none, circle_m=plain, half_m=s.half_slices_m[-1])
    for half in s.half_slices_m:
        use = np.abs(foot) <= half
        # Symmetric about the stem's axis and blind to the tail: the joint fit already knows where bark can be.
        candidate = use & (np.abs(residual) <= limit)
        count = int(candidate.sum())
        if count < LEAST_POINTS and half != s.half_slices_m[-1]:
            continue
        chosen = np.flatnonzero(candidate)
        last = Slice(offsets_m=offset[use], seen_m=as_seen[use], kept=candidate[use], circle_m=plain, half_m=half)
        if count < LEAST_POINTS:
            return last
        enough = fit.sigma_m / np.sqrt(count * max(coverage, LEAST_COVERAGE)) <= s.slice_error_m
        seen = float(covered_bins(offset[chosen], bins=SECTORS[1]).mean()) >= s.min_seen * coverage
        if not (enough and seen) and half != s.half_slices_m[-1]:
            continue
        try:
            circle = fit_circle(offset[chosen], settings=s.circle, seed=seed)
        except CloudError:
            return last
        kept = np.zeros(len(offset), dtype=bool)
        kept[chosen[circle.inliers]] = True
        fused = np.array([*circle.center, circle.radius])
        spread = circle.radius_std if np.isfinite(circle.radius_std) else fit.sigma_m
        patches = count_cells(offset[chosen], PATCH_M)
        spread *= np.sqrt(max(1.0, count / max(patches, 1) * PATCH_M / (2.0 * half + PATCH_M)))
        return Slice(
            offsets_m=offset[use],
            seen_m=as_seen[use],
            kept=kept[use],
            circle_m=fused,
            half_m=half,
            radius_m=circle.radius,
            std_m=float(spread),
        )
    return last


def _slice_limit(fit: AxisFit, s: SliceSettings) -> float:
    return max(s.circle.drop_residual_m, WALL_SIGMAS * fit.sigma_m)

"""The stem curve: diameters up the visible trunk, each with a reason where there is none.

From breast height upward and downward the axis is followed in steps: a tapered cylinder
(:mod:`fsinfer.trees.cylinder.axis`) is fitted to the points around each height, starting from the one before. Its error
is that of the fit alone (with what neighbouring points share): it is smaller than an interval as given for the DBH, and
calibrated on nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.csv_text import write_table
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.trees.cylinder.axis import AxisSettings, axis_coordinates, fit_axis, wider
from fsinfer.trees.diameter.circle import covered_bins
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.diameter.spread import fit_spread
from fsinfer.trees.measure import PlotResult
from fsinfer.trees.points.cells import PlanIndex, rows
from fsinfer.trees.points.surface import SECTORS, WALL_SIGMAS, reach_about_wall
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]


#: Points of a window; more do not move the fit. Source: numerics.
MOST_POINTS = 2000
#: No curve goes on above, metres. Source: numerics.
HIGHEST_M = 30.0
#: Points farther from the box round all stems than this, metres, are far from any curve: a point at (0, 0, 0) of a
#: cloud in national coordinates would ask for a table of all the land between. Source: numerics; beyond every
#: ``CurveSettings.reach_m``, so that curves do not hang on it.
_FAR_M = 100.0
#: A fit starts with no smaller radius, metres. Source: numerics.
LEAST_START_M = 0.015


@dataclass(frozen=True, kw_only=True)
class CurveSettings:
    """Constants of :func:`stem_curves`.

    Attributes
    ----------
    step_m: from height to height. Source: convention.
    half_window_m: of the piece of stem fitted; below half a step, so that heights share no points. Source: geometry.
    reach_m: in plan about the stem's place at breast height; stems that lean farther are not followed. Source: not
        recorded.
    min_points: of a window. Source: not recorded.
    min_coverage: without the metre around it, an arc must tell more than at breast height. Source: not recorded.
    max_noise: noise against that at breast height: times, and metres on top; more is twigs and leaves. Source: not
        recorded.
    max_std: of the diameter, share of it. Source: not recorded.
    max_growth: diameter from one height to the next farther up, least and greatest; stems taper. Source: not recorded.
    max_lost_m: without a diameter so far, the stem is not followed any farther. Source: not recorded.
    """

    step_m: float = 0.5
    half_window_m: float = 0.2
    reach_m: float = 1.5
    min_points: int = 30
    min_coverage: float = 90.0 / 360.0
    max_noise: tuple[float, float] = (1.6, 0.004)
    max_std: float = 0.04
    max_growth: tuple[float, float] = (0.75, 1.06)
    max_lost_m: float = 2.0


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """One height of a stem: diameter in cm, or None and ``why``; ``std_cm`` is the standard deviation of the fit."""

    tree_id: int
    height_m: float
    diameter_cm: float | None
    std_cm: float | None
    arc_coverage: float
    points: int
    why: Notice | None = None

    @property
    def reason(self) -> str:
        """Why there is no diameter, in words; empty where there is one."""
        return "" if self.why is None else sentence(self.why)


COLUMNS = ("tree_id", "height_m", "diameter_cm", "std_cm", "arc_coverage", "points", "reason")


def stem_curves(
    points: Floats, result: PlotResult, *, settings: CurveSettings | None = None
) -> dict[int, tuple[CurvePoint, ...]]:
    """Stem curves by tree id from points (N, 3) in the cloud's frame, for the trees with a DBH; heights ascend."""
    s = settings or CurveSettings()
    if not any(tree.dbh_cm is not None for tree in result.trees):
        return {}
    points = _near_stems(points, result.trees, max(_FAR_M, s.reach_m))
    origin = np.array([np.floor(points[:, 0].min()), np.floor(points[:, 1].min()), 0.0])
    index = PlanIndex(points - origin, 0.5 * s.reach_m)
    curves = {}
    for tree, section in zip(result.trees, result.sections, strict=True):
        if tree.dbh_cm is None:
            continue
        near = index.near(np.array([tree.x_m, tree.y_m]) - origin[:2], s.reach_m)
        near = near - np.array([0.0, 0.0, tree.z_ground_m])
        curves[tree.tree_id] = _curve(near, tree, section, origin, s)
    return curves


def write_curves(path: Path, curves: Iterable[tuple[CurvePoint, ...]]) -> None:
    """Write ``stem_curve.csv``: a row a height, empty where no diameter could be measured."""
    write_table(path, COLUMNS, (curve_row(point) for curve in curves for point in curve))


def curve_row(point: CurvePoint) -> tuple[int | float | str, ...]:
    """The values of ``COLUMNS``, rounded; empty strings for None."""
    return (
        point.tree_id,
        round(point.height_m, 2),
        "" if point.diameter_cm is None else round(point.diameter_cm, 2),
        "" if point.std_cm is None else round(point.std_cm, 2),
        round(point.arc_coverage, 2),
        point.points,
        point.reason,
    )


def _near_stems(points: Floats, trees: Sequence[Tree], reach_m: float) -> Floats:
    """Those of points (N, 3) no farther than ``reach_m`` from the box round the trees in plan."""
    places = np.array([[tree.x_m, tree.y_m] for tree in trees])
    low, high = places.min(axis=0) - reach_m, places.max(axis=0) + reach_m
    near = np.ones(len(points), dtype=bool)
    for axis in range(2):
        near &= (points[:, axis] >= low[axis]) & (points[:, axis] <= high[axis])
    return points if near.all() else rows(points, near)


def _curve(near: Floats, tree: Tree, section: Section, origin: Floats, s: CurveSettings) -> tuple[CurvePoint, ...]:
    start = np.array([tree.x_m - origin[0], tree.y_m - origin[1], *section.slope, section.circle_m[2], section.taper])
    top = min(HIGHEST_M, float(near[:, 2].max(initial=0.0)))
    # The highest window is full: half a one would tell of a lower height.
    up = np.arange(np.ceil(tree.bh_m / s.step_m) * s.step_m, top - s.half_window_m, s.step_m)
    down = np.arange(np.ceil(tree.bh_m / s.step_m) * s.step_m - s.step_m, 0.0, -s.step_m)
    found = []
    for heights in (down, up):
        state, at = start, tree.bh_m
        for height in heights:
            height = float(height)
            point, state_there = _at(near, tree, section, state, at, height, s)
            found.append(point)
            if state_there is not None:
                state, at = state_there, height
            elif abs(height - at) > s.max_lost_m:
                break
    found.sort(key=lambda point: point.height_m)
    # What ends the curve is told once, not at every height above.
    while len(found) > 1 and found[-1].diameter_cm is None and found[-2].diameter_cm is None:
        found.pop()
    return tuple(found)


def _at(
    near: Floats, tree: Tree, section: Section, state: Floats, at: float, height: float, s: CurveSettings
) -> tuple[CurvePoint, Floats | None]:
    expected = state.copy()
    expected[:2] += state[2:4] * (height - at)
    expected[4] = max(state[4] + state[5] * (height - at), LEAST_START_M)
    window = near[np.abs(near[:, 2] - height) <= s.half_window_m]
    offset, _ = axis_coordinates(window, expected, height)
    reach = reach_about_wall(expected[4], AxisSettings().window_m)
    window = window[np.abs(np.hypot(offset[:, 0], offset[:, 1]) - expected[4]) <= reach]
    window = window[:: max(len(window) // MOST_POINTS, 1)]

    def none(why: Notice, coverage: float = 0.0) -> tuple[CurvePoint, None]:
        point = CurvePoint(
            tree_id=tree.tree_id, height_m=height, diameter_cm=None, std_cm=None, arc_coverage=coverage,
            points=len(window), why=why,
        )  # fmt: skip
        return point, None

    if len(window) < s.min_points:
        return none(notice(StemCode.few_at_height, points=len(window)))
    noise = section.residual_m
    fit = fit_axis(window, expected, height, sigma_m=wider(noise))
    offset, foot = axis_coordinates(window, fit.parameters, height)
    wall = np.abs(fit.residuals_m) <= WALL_SIGMAS * fit.sigma_m
    coverage = float(covered_bins(offset[wall], bins=SECTORS[1]).mean())
    if wall.sum() < s.min_points:
        return none(notice(StemCode.few_on_bark_at_height, points=int(wall.sum())), coverage)
    if coverage < s.min_coverage:
        return none(notice(StemCode.little_seen, seen_deg=360.0 * coverage), coverage)
    times, slack = s.max_noise
    if fit.sigma_m > times * noise + slack:
        return none(notice(StemCode.rough_at_height, residual_cm=100.0 * fit.sigma_m), coverage)
    growth = fit.radius_m / max(float(state[4]), 1e-3)
    low, high = s.max_growth
    if height < at:
        low, high = 1.0 / high, 1.0 / low
    if not low <= growth <= high:
        return none(notice(StemCode.curvature_differs), coverage)
    std = float(np.sqrt(max(fit_spread(fit, offset, foot).covariance[4, 4], 0.0)))
    if std > s.max_std * fit.radius_m:
        why = notice(StemCode.uncertain_at_height, diameter_cm=200.0 * fit.radius_m, std_cm=200.0 * std)
        return none(why, coverage)
    point = CurvePoint(
        tree_id=tree.tree_id,
        height_m=height,
        diameter_cm=200.0 * fit.radius_m,
        std_cm=200.0 * std,
        arc_coverage=coverage,
        points=int(wall.sum()),
    )
    return point, fit.parameters

"""The stem curve: diameters up the visible trunk, each with a reason where there is none.

From breast height upward and downward the axis is followed in steps: at each height the stem is measured as it is at
breast height (:mod:`fsinfer.trees.diameter.dbh`), from a shorter piece, starting from the height before. Then a smooth
taper is laid through all heights and the diameter at breast height, which the photographs may know better
(:mod:`fsinfer.trees.taper_curve`). How far the standard deviations hold is printed by
``python -m tests.bench.stem_curve``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.csv_text import write_table
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.processes import shared_out
from fsinfer.progress import Progress, silent
from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.diameter.budget import relative_scale_std
from fsinfer.trees.diameter.dbh import measure_together
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.measure import PlotResult
from fsinfer.trees.points.cells import PlanIndex, rows
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.points.sums import Z95
from fsinfer.trees.search.stem import Stem
from fsinfer.trees.taper_curve import TaperSettings, smooth_taper
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


#: No curve goes on above, metres. Source: numerics.
HIGHEST_M = 30.0
#: Points farther from the box round all stems than this, metres, are far from any curve: a point at (0, 0, 0) of a
#: cloud in national coordinates would ask for a table of all the land between. Source: numerics; beyond every
#: ``CurveSettings.reach_m``, so that curves do not hang on it.
_FAR_M = 100.0
#: A fit starts with no smaller radius and no less noise, metres. Source: numerics.
LEAST_START_M, LEAST_NOISE_M = 0.015, 0.004
#: Stems that are followed at once. Source: numerics.
TOGETHER = 16


@dataclass(frozen=True, kw_only=True)
class CurveSettings:
    """Constants of :func:`stem_curves`.

    Attributes
    ----------
    step_m: from height to height. Source: convention.
    half_window_m: of the piece of stem fitted; half a step at most, so that heights share no points. Source: geometry.
    reach_m: in plan about the stem's place at breast height; stems that lean farther are not followed. Source: not
        recorded.
    min_points: of a window. Source: not recorded.
    min_coverage: without the metre around it, an arc must tell more than at breast height. Source: not recorded.
    max_noise: noise against that at breast height: times, and metres on top; more is twigs and leaves. Source: not
        recorded.
    max_interval: width of the 95 % interval of a height by itself, share of its diameter, beyond which it tells
        nothing. Source: not recorded.
    max_std: of the smoothed diameter, share of it; 0.05 is half of what makes a diameter at breast height doubtful.
        Source: as ``TaperSettings.bend``; with 0.03 a quarter of the diameters are lost, and errors a quarter smaller.
    max_growth: diameter from one height to the next farther up, least and greatest; stems taper. Source: not recorded.
    max_lost_m: without a diameter so far, the stem is not followed any farther. Source: not recorded.
    taper: of the smooth taper.
    """

    step_m: float = 0.5
    half_window_m: float = 0.25
    reach_m: float = 1.5
    min_points: int = 30
    min_coverage: float = 90.0 / 360.0
    max_noise: tuple[float, float] = (1.6, 0.004)
    max_interval: float = 1.2
    max_std: float = 0.05
    max_growth: tuple[float, float] = (0.75, 1.06)
    max_lost_m: float = 2.0
    taper: TaperSettings = field(default_factory=TaperSettings)


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """One height of a stem: diameter in cm, or None and ``why``; ``std_cm`` is its standard deviation."""

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
    points: Floats,
    result: PlotResult,
    *,
    settings: CurveSettings | None = None,
    errors: PointErrors | None = None,
    progress: Progress = silent,
) -> dict[int, tuple[CurvePoint, ...]]:
    """Stem curves by tree id from points (N, 3) in the cloud's frame, for the trees with a DBH; heights ascend.

    ``errors`` of a cloud of photographs are those by which its points are weighed; not by their normals: three and four
    metres up, where depth maps are seen from below, what is left by those is too thin (docs/trials-accuracy.md).
    """
    s = settings or CurveSettings()
    if not any(tree.dbh_cm is not None for tree in result.trees):
        return {}
    near = _near_stems(points, result.trees, max(_FAR_M, s.reach_m))
    points = points if near.all() else rows(points, near)
    origin = np.array([np.floor(points[:, 0].min()), np.floor(points[:, 1].min()), 0.0])
    points = points - origin
    if errors is not None:
        points = replace(errors, normals=None).select(near).beside(points)
    index = PlanIndex(points, 0.5 * s.reach_m)
    curves = {}
    trees = [(tree, section) for tree, section in zip(result.trees, result.sections, strict=True) if tree.dbh_cm]

    def asked() -> Iterator[list[tuple[Tree, Section, tuple[_Climb, _Climb]]]]:
        for first in range(0, len(trees), TOGETHER):
            some = trees[first : first + TOGETHER]
            yield [(tree, section, _climbs(index, tree, section, origin, s)) for tree, section in some]

    progress(0, len(trees), "measuring stem curves")
    for number, found in enumerate(shared_out(partial(_curves_of, s), asked()), start=1):
        curves.update(found)
        progress(min(number * TOGETHER, len(trees)), len(trees), "measuring stem curves")
    return curves


def _curves_of(
    s: CurveSettings, some: list[tuple[Tree, Section, tuple[_Climb, _Climb]]]
) -> dict[int, tuple[CurvePoint, ...]]:
    """The curves of some stems by their ids; their climbs are measured together."""
    _follow([climb for _, _, climbs in some for climb in climbs], s)
    return {
        tree.tree_id: _smooth([*reversed(down.found), *up.found], tree, section, s)
        for tree, section, (down, up) in some
    }


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


def _near_stems(points: Floats, trees: Sequence[Tree], reach_m: float) -> Bools:
    """Which of points (N, 3) are no farther than ``reach_m`` from the box round the trees in plan."""
    places = np.array([[tree.x_m, tree.y_m] for tree in trees])
    low, high = places.min(axis=0) - reach_m, places.max(axis=0) + reach_m
    near = np.ones(len(points), dtype=bool)
    for axis in range(2):
        near &= (points[:, axis] >= low[axis]) & (points[:, axis] <= high[axis])
    return near


@dataclass(kw_only=True)
class _Climb:
    """One way along a stem from breast height: the points near it, the heights that are left, where it stands now.

    ``near`` (N, 3 or 5) are x, y about the origin of all, and height above the stem's ground, sorted by height;
    ``state`` (6,) is the axis at the height ``at``.
    """

    tree: Tree
    noise_m: float
    near: Floats
    heights: Iterator[float]
    state: Floats
    at: float
    found: list[CurvePoint]

    def window(self, height: float, half_m: float) -> Floats:
        """The points about a height."""
        first, last = np.searchsorted(self.near[:, 2], [height - half_m, height + half_m])
        return self.near[first:last]


def _climbs(index: PlanIndex, tree: Tree, section: Section, origin: Floats, s: CurveSettings) -> tuple[_Climb, _Climb]:
    """The way down and the way up."""
    near = index.near(np.array([tree.x_m, tree.y_m]) - origin[:2], s.reach_m)
    near = near.copy()
    near[:, 2] -= tree.z_ground_m
    near = near.take(np.argsort(near[:, 2], kind="stable"), axis=0)
    start = np.array([tree.x_m - origin[0], tree.y_m - origin[1], *section.slope, section.circle_m[2], section.taper])
    top = min(HIGHEST_M, float(near[-1, 2]) if len(near) else 0.0)
    # The highest window is full: half a one would tell of a lower height.
    first = np.ceil(tree.bh_m / s.step_m) * s.step_m
    up, down = np.arange(first, top - s.half_window_m, s.step_m), np.arange(first - s.step_m, 0.0, -s.step_m)

    def climb(heights: Floats) -> _Climb:
        way = iter(heights.tolist())
        noise = section.residual_m
        return _Climb(tree=tree, noise_m=noise, near=near, heights=way, state=start, at=tree.bh_m, found=[])

    return climb(down), climb(up)


def _follow(climbs: Sequence[_Climb], s: CurveSettings) -> None:
    """Measure height by height, all climbs at once, until each has lost its stem or come to its end."""
    # A height has no place for a doubt: where there are two walls, it has no diameter.
    settings = replace(DbhSettings(), half_windows_m=(s.half_window_m,), max_interval=s.max_interval, most_walls_m=0.0)
    going = list(climbs)
    while going:
        those = [(climb, height) for climb in going if (height := next(climb.heights, None)) is not None]
        windows = [climb.window(height, s.half_window_m) for climb, height in those]
        enough = [n for n, window in enumerate(windows) if len(window) >= s.min_points]
        sections = measure_together(
            [windows[n] for n in enough],
            [_stem_at(*those[n], s) for n in enough],
            bh_m=[those[n][1] for n in enough],
            settings=settings,
        )
        measured = dict(zip(enough, sections, strict=True))
        going = []
        for n, (climb, height) in enumerate(those):
            section = measured.get(n)
            few = notice(StemCode.few_at_height, points=len(windows[n]))
            why = few if section is None else _why_not(climb, height, section, s)
            climb.found.append(_point(climb, height, section, why))
            if section is not None and climb.found[-1].diameter_cm is not None:
                state = [*section.center, *section.slope, section.circle_m[2], section.taper]
                climb.state, climb.at = np.array(state), height
            if abs(height - climb.at) <= s.max_lost_m:
                going.append(climb)


def _stem_at(climb: _Climb, height: float, s: CurveSettings) -> Stem:
    """The stem as it is expected at a height."""
    state, rise = climb.state.copy(), height - climb.at
    state[:2] += state[2:4] * rise
    state[4] = max(state[4] + state[5] * rise, LEAST_START_M)
    axis = Axis(parameters=state, height_m=height, sigma_m=max(climb.noise_m, LEAST_NOISE_M))
    half = 2.0 * s.half_window_m
    return Stem(
        axis=axis, bottom_m=height - half, top_m=height + half, length_m=2 * half, arc_coverage=1.0, quality=1.0
    )


def _why_not(climb: _Climb, height: float, section: Section, s: CurveSettings) -> Notice | None:
    """Why a section is no diameter of the curve, None where it is one."""
    if section.coverage and section.coverage < s.min_coverage:
        return notice(StemCode.little_seen, seen_deg=360.0 * section.coverage)
    times, slack = s.max_noise
    if section.residual_m > times * climb.noise_m + slack:
        return notice(StemCode.rough_at_height, residual_cm=100.0 * section.residual_m)
    if section.dbh_m is None:
        return _at_height(section)
    low, high = s.max_growth
    if height < climb.at:
        low, high = 1.0 / high, 1.0 / low
    if not low <= section.circle_m[2] / max(float(climb.state[4]), 1e-3) <= high:
        return notice(StemCode.curvature_differs)
    return None


def _at_height(section: Section) -> Notice:
    """Why there is no diameter at all, in the words of a curve."""
    why = section.reasons[0]
    if why.code in {StemCode.too_few_at_breast_height, StemCode.too_few_on_bark}:
        return notice(StemCode.few_on_bark_at_height, points=section.points)
    if why.code == StemCode.too_rough:
        return notice(StemCode.rough_at_height, residual_cm=100.0 * section.residual_m)
    if why.code == StemCode.too_uncertain:
        diameter_cm, std_cm = 200.0 * float(section.circle_m[2]), 100.0 * section.half95_m / Z95
        return notice(StemCode.uncertain_at_height, diameter_cm=diameter_cm, std_cm=std_cm)
    return notice(StemCode.curvature_differs)


def _point(climb: _Climb, height: float, section: Section | None, why: Notice | None) -> CurvePoint:
    dbh_m = None if section is None or why is not None else section.dbh_m
    return CurvePoint(
        tree_id=climb.tree.tree_id,
        height_m=height,
        diameter_cm=None if dbh_m is None else 100.0 * dbh_m,
        std_cm=None if section is None or dbh_m is None else 100.0 * section.sd_m,
        arc_coverage=0.0 if section is None else section.coverage,
        points=0 if section is None else section.points,
        why=why,
    )


def _smooth(found: list[CurvePoint], tree: Tree, section: Section, s: CurveSettings) -> tuple[CurvePoint, ...]:
    """The curve of a stem whose heights were measured one by one, ascending."""
    measured = [point for point in found if point.diameter_cm is not None]
    # All diameters of the cloud share the error of its scale.
    dbh_cm, scale = 100.0 * (section.dbh_m or 0.0), relative_scale_std(section.parts_m, section.dbh_m or 0.0)
    std_cm = float(np.sqrt(max((100.0 * section.half95_m / Z95) ** 2 - (scale * dbh_cm) ** 2, 0.0)))
    diameters, stds = smooth_taper(
        np.array([point.height_m for point in measured]),
        np.array([point.diameter_cm for point in measured], dtype=np.float64),
        np.array([point.std_cm for point in measured], dtype=np.float64),
        breast_height=(tree.bh_m, dbh_cm - 200.0 * section.by_taper_m, std_cm),
        settings=s.taper,
    )
    smooth = {
        point.height_m: _smoothed(point, float(cm), float(np.hypot(std, scale * cm)), s)
        for point, cm, std in zip(measured, diameters, stds, strict=True)
    }
    curve = [smooth.get(point.height_m, point) for point in found]
    # What ends the curve is told once, not at every height above.
    while len(curve) > 1 and curve[-1].diameter_cm is None and curve[-2].diameter_cm is None:
        curve.pop()
    return tuple(curve)


def _smoothed(point: CurvePoint, diameter_cm: float, std_cm: float, s: CurveSettings) -> CurvePoint:
    if std_cm <= s.max_std * diameter_cm:
        return replace(point, diameter_cm=diameter_cm, std_cm=std_cm)
    why = notice(StemCode.uncertain_at_height, diameter_cm=diameter_cm, std_cm=std_cm)
    return replace(point, diameter_cm=None, std_cm=None, why=why)

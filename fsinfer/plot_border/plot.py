"""The stems of a plot against its border: who is in, who is near it, and the plot's figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.plots import PlotCode
from fsinfer.plot_border.border import Border
from fsinfer.plot_border.hectare import (
    LEAST_SHARE,
    HectareFigure,
    PlotStems,
    basal_area_per_ha,
    part_per_ha,
    stems_per_ha,
)
from fsinfer.plot_border.request import Place
from fsinfer.plot_border.sight import SeenShare
from fsinfer.trees.points.sums import Z95
from fsinfer.trees.rough_dbh import rough_dbh_cm
from fsinfer.trees.stand import stand_of_diameters
from fsinfer.trees.tree import OUTSIDE, Tree

Floats = NDArray[np.float64]
#: Standard deviation of the place of a stem that could not be measured, metres. Source: judgement; half the radius of
#: a usual stem.
UNMEASURED_STD_M = 0.1
#: Radius of such a stem, metres. Source: judgement.
UNMEASURED_RADIUS_M = 0.1
#: A stem's centre is known no better, metres: lean and roots stand between it and what a person would measure.
#: Source: judgement.
LEAST_STD_M = 0.01
#: Less of the plot seen than this is said as a warning. Source: judgement.
MOSTLY_SEEN = 0.8


@dataclass(frozen=True, kw_only=True)
class PlotFigures:
    """The plot within its border.

    Attributes
    ----------
    origin: "walk", "marker 7", "coordinate" or "polygon".
    center, radius_m: of a circle; None for a polygon. corners: of a polygon.
    area_m2: horizontal; seen_share: of it; seen_method: how that was judged.
    slope_deg: of the ground under the cloud.
    stems, measured, doubtful, unmeasured: numbers of stems that are in; the last two are among the first.
    outside: number of stems that are out.
    on_unseen: number of stems that are in and stand on the part that does not count as seen.
    border_cases: numbers of the trees at the border, in or out.
    quadratic_mean_dbh_cm, mean_dbh_cm: of the measured stems that are in.
    stems_per_ha, basal_area_m2_per_ha: None where too little of the plot was seen; the latter also where no stem that
        is in was measured, for nothing tells how thick those are that were not seen.
    doubtful_stems_per_ha, doubtful_basal_area_m2_per_ha: how much of these figures rests on doubtful stems.
    """

    origin: str
    center: Place | None
    radius_m: float | None
    corners: tuple[Place, ...]
    area_m2: float
    seen_share: float
    seen_method: str
    slope_deg: float
    stems: int
    measured: int
    doubtful: int
    unmeasured: int
    outside: int
    border_cases: tuple[int, ...]
    quadratic_mean_dbh_cm: float | None
    mean_dbh_cm: float | None
    stems_per_ha: HectareFigure | None
    basal_area_m2_per_ha: HectareFigure | None
    doubtful_stems_per_ha: float | None
    doubtful_basal_area_m2_per_ha: float | None
    on_unseen: int = 0

    @property
    def no_basal_area(self) -> bool:
        """Whether the basal area is 0, and has no interval: the plot was seen, and no stem stands in it."""
        return self.stems == 0 and self.stems_per_ha is not None and self.basal_area_m2_per_ha is None

    @property
    def border(self) -> Border:
        """The border, to draw it."""
        return Border(
            center=self.center, radius_m=self.radius_m, corners=self.corners, origin=self.origin, moves_along=True
        )


@dataclass(frozen=True, kw_only=True)
class Upright:
    """How well it is known which way is up.

    Attributes
    ----------
    std_rad: standard deviation of up about a level axis; 0 for a cloud whose z was surveyed, or is the user's own.
    z_m: height of the ground in the middle of the border, metres: what lies above or below it is moved aside.
    """

    std_rad: float = 0.0
    z_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Bordered:
    """Trees with their columns of the border, the plot's figures, and what is to be told."""

    trees: tuple[Tree, ...]
    figures: PlotFigures
    warnings: tuple[Notice, ...]


def sort_trees(
    trees: Sequence[Tree], border: Border, *, scale_rel_std: float = 0.0, upright: Upright | None = None
) -> tuple[Tree, ...]:
    """The trees with ``in_plot``, ``border_m`` and ``at_border``: in by the centre at breast height.

    At the border is who stands nearer to it than the stem's radius, or than the 95 % error of its place.
    """
    if not trees:
        return ()
    inside_m = border.inside_m(_places(trees))
    radius, std = _radii(trees), _place_std(trees, scale_rel_std, upright or Upright())
    scale = scale_rel_std * np.linalg.norm(_places(trees) - np.array(border.anchor), axis=1)
    near = np.abs(inside_m) < np.maximum(radius, Z95 * np.hypot(std, scale))
    return tuple(
        replace(tree, in_plot=bool(distance > 0), border_m=float(distance), at_border=bool(close))
        for tree, distance, close in zip(trees, inside_m, near, strict=True)
    )


def plot_of(
    trees: Sequence[Tree],
    border: Border,
    seen: SeenShare,
    *,
    slope_deg: float,
    scale_rel_std: float = 0.0,
    shared_m: Floats | None = None,
    upright: Upright | None = None,
) -> Bordered:
    """Sort the trees by the border, and put the plot to the hectare.

    ``shared_m`` (T,) is the part of each diameter's standard deviation with one cause in all stems, metres: NaN where
    it is not known (taken to be what it usually is in the others), None where there is none.
    """
    upright = upright or Upright()
    sorted_trees = sort_trees(trees, border, scale_rel_std=scale_rel_std, upright=upright)
    own = [tree for tree in sorted_trees if tree.in_plot]
    doubtful = [tree for tree in own if tree.status == "doubtful"]
    enough = seen.share >= LEAST_SHARE
    stems = _stems(sorted_trees, seen, scale_rel_std, shared_m, upright)
    of_plot = stand_of_diameters([tree.dbh_cm for tree in own], 0.0)
    rests = stems.inside & np.array([tree.status == "doubtful" for tree in sorted_trees], dtype=bool)

    def of_doubtful(amounts: Floats) -> float | None:
        return part_per_ha(amounts * rests, stems.on_seen, area_m2=border.area_m2, share=seen.share) if enough else None

    cases = tuple(tree.tree_id for tree in sorted_trees if tree.at_border)
    # Seen a little too steeply a slope is shorter in plan, along its fall only.
    level_rel_std = float(np.tan(np.radians(slope_deg))) * upright.std_rad
    figures = PlotFigures(
        origin=border.origin,
        center=border.center,
        radius_m=border.radius_m,
        corners=border.corners,
        area_m2=border.area_m2,
        seen_share=seen.share,
        seen_method=seen.method,
        slope_deg=slope_deg,
        stems=len(own),
        measured=of_plot.measured,
        doubtful=len(doubtful),
        unmeasured=len(own) - of_plot.measured,
        outside=len(sorted_trees) - len(own),
        border_cases=cases,
        quadratic_mean_dbh_cm=of_plot.quadratic_mean_dbh_cm,
        mean_dbh_cm=of_plot.mean_dbh_cm,
        stems_per_ha=stems_per_ha(
            stems,
            area_m2=border.area_m2,
            share=seen.share,
            scale_rel_std=scale_rel_std,
            level_rel_std=level_rel_std,
        )
        if enough
        else None,
        basal_area_m2_per_ha=basal_area_per_ha(
            stems, area_m2=border.area_m2, share=seen.share, level_rel_std=level_rel_std
        )
        if enough
        else None,
        doubtful_stems_per_ha=of_doubtful(np.ones(len(rests))),
        doubtful_basal_area_m2_per_ha=of_doubtful(np.nan_to_num(stems.sections_m2)),
        on_unseen=int((stems.inside & ~stems.on_seen).sum()),
    )
    return Bordered(trees=sorted_trees, figures=figures, warnings=_warnings(sorted_trees, seen, border.middle))


def stem_circles(trees: Sequence[Tree]) -> Floats:
    """x, y and radius (T, 3) of the stems, metres."""
    return np.column_stack([_places(trees), _radii(trees)]).reshape(-1, 3)


def _warnings(trees: Sequence[Tree], seen: SeenShare, middle: Place) -> tuple[Notice, ...]:
    told = []
    cases = tuple(
        f"tree {tree.tree_id} ({abs(tree.border_m or 0.0):.2f} m {'in' if tree.in_plot else 'out'})"
        for tree in trees
        if tree.at_border
    )
    if cases:
        told.append(notice(PlotCode.border_cases, trees=cases))
    # By the status: those that were measured all the same (--far-stems) count with their own section.
    beyond = tuple(str(tree.tree_id) for tree in trees if tree.status == OUTSIDE and tree.in_plot)
    if beyond:
        told.append(notice(PlotCode.outside_walk_in_plot, stems=len(beyond), trees=beyond))
    percent = 100.0 * seen.share
    if seen.ground_share == 0.0 and not any(tree.in_plot for tree in trees):
        told.append(notice(PlotCode.border_elsewhere, x_m=middle[0], y_m=middle[1]))
    elif seen.share < LEAST_SHARE:
        told.append(notice(PlotCode.plot_hardly_seen, percent=percent, least=100.0 * LEAST_SHARE))
    elif seen.share < MOSTLY_SEEN:
        told.append(notice(PlotCode.plot_partly_seen, percent=percent))
    return tuple(told)


def _stems(
    trees: Sequence[Tree], seen: SeenShare, scale_rel_std: float, shared_m: Floats | None, upright: Upright
) -> PlotStems:
    inside_m = np.array([tree.border_m or 0.0 for tree in trees])
    dbh_m = np.array([np.nan if tree.dbh_cm is None else tree.dbh_cm / 100.0 for tree in trees], dtype=np.float64)
    std_m = np.sqrt(np.maximum(_dbh_std_m(trees) ** 2 - (scale_rel_std * dbh_m) ** 2, 0.0))
    rough = np.array([rough_dbh_cm(tree) or (np.nan, np.nan) for tree in trees]).reshape(-1, 2) / 100.0
    return PlotStems(
        inside=np.array([bool(tree.in_plot) for tree in trees], dtype=bool),
        # Without the scale, which is a part of its own.
        chance=np.asarray(ndtr(inside_m / _place_std(trees, scale_rel_std, upright))) if len(trees) else np.zeros(0),
        dbh_m=dbh_m,
        std_m=std_m,
        rough_m=rough[:, 0],
        rough_std_m=rough[:, 1],
        seen=seen.stems,
        shared_m=None if shared_m is None else _known_or_usual(shared_m, std_m),
    )


def _known_or_usual(shared_m: Floats, std_m: Floats) -> Floats:
    """The shared parts (T,) of standard deviations (T,), with the median share where one is not known."""
    known = np.isfinite(shared_m) & (std_m > 0)
    usual = float(np.median(shared_m[known] / std_m[known])) if known.any() else 1.0
    return np.where(np.isfinite(shared_m), shared_m, usual * std_m)


def _places(trees: Sequence[Tree]) -> Floats:
    return np.array([(tree.x_m, tree.y_m) for tree in trees], dtype=np.float64).reshape(-1, 2)


def _radii(trees: Sequence[Tree]) -> Floats:
    return np.array([UNMEASURED_RADIUS_M if tree.dbh_cm is None else tree.dbh_cm / 200.0 for tree in trees])


def _dbh_std_m(trees: Sequence[Tree]) -> Floats:
    """Of the intervals in the table, the scale included; NaN where there is none."""
    std = np.array([tree.half95_cm for tree in trees]) / (100.0 * Z95)
    return np.where(np.isfinite(std), std, np.nan)


def _place_std(trees: Sequence[Tree], scale_rel_std: float, upright: Upright) -> Floats:
    """Standard deviation (T,) of the centres in metres, without that of the scale.

    What moves the far side of a stem that is seen from one side by the error of the diameter moves its centre by half.
    A cloud that does not stand upright has what lies high or low on a slope aside of where it is.
    """
    radius = _radii(trees)
    own = np.sqrt(np.maximum(_dbh_std_m(trees) ** 2 - (2.0 * radius * scale_rel_std) ** 2, 0.0)) / 2.0
    measured = np.where(np.isfinite(own), np.maximum(own, LEAST_STD_M), UNMEASURED_STD_M)
    above = np.array([tree.z_ground_m for tree in trees]) - upright.z_m
    return np.asarray(np.hypot(measured, above * upright.std_rad))

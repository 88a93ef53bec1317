"""The forest that the plots of a batch sample: which plots count, and what they say of it and of its strata."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fsinfer.batch.estimator import Estimate, estimate_ratio
from fsinfer.batch.outcome import State
from fsinfer.batch.rows import PlotRow
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.sample import MOST_NAMES, REASONS, SampleCode
from fsinfer.plot_border.hectare import M2_PER_HA

Floats = NDArray[np.float64]


class Method(StrEnum):
    """How plots were put together."""

    mean = "mean of plots"
    ratio = "ratio of means"
    stratified = "stratified"


class Scope(StrEnum):
    """What a row of the estimates is of."""

    all = "all"
    stratum = "stratum"


@dataclass(frozen=True, kw_only=True)
class ForestFigures:
    """What the plots say of the forest, or of a stratum of it; None where a figure cannot be said.

    Attributes
    ----------
    scope, stratum: of what; the stratum's name is empty for all, and for plots without one. method: see
        :class:`Method`.
    plots: how many count; sampled_m2: their area. area_ha: of what they stand for, hectares; None where nobody says it.
    stems_per_ha, basal_area_m2_per_ha: of horizontal ground.
    quadratic_mean_dbh_cm: of the stem of mean basal area; mean_dbh_cm: arithmetic. Stems count alike, wherever they
        stand.
    stems, basal_area_m2: totals on ``area_ha``.
    """

    scope: Scope
    stratum: str
    method: Method
    plots: int
    sampled_m2: float
    area_ha: float | None
    stems_per_ha: Estimate | None
    basal_area_m2_per_ha: Estimate | None
    quadratic_mean_dbh_cm: Estimate | None
    mean_dbh_cm: Estimate | None
    stems: Estimate | None
    basal_area_m2: Estimate | None


@dataclass(frozen=True, kw_only=True)
class ForestEstimates:
    """Rows of all plots, then of each stratum as the table has them; none where no plot counts. What is to be told."""

    rows: tuple[ForestFigures, ...]
    notices: tuple[Notice, ...]


@dataclass(frozen=True, kw_only=True)
class _Plot:
    """A plot that counts: what stands on it."""

    name: str
    stratum: str
    area_m2: float
    stems: float
    basal_area_m2: float | None
    mean_dbh_cm: float | None


def forest_estimates(rows: Sequence[PlotRow]) -> ForestEstimates:
    """Estimate the forest from the plots that have results, a border, and figures a hectare."""
    plots = [plot for row in rows if (plot := _plot(row)) is not None]
    told: list[Notice] = []
    measured = [row for row in rows if row.has_border is not None]
    # Without a scale no border is placed, though one may have been given.
    if measured and not any(row.has_border or row.units != "m" for row in measured):
        told.append(notice(SampleCode.no_borders))
    elif len(plots) < len(rows):
        why = _why_left_out(rows, {plot.name for plot in plots})
        left = len(rows) - len(plots)
        told.append(
            notice(SampleCode.plots_left_out, plots=left, of=len(rows), why=why)
            if plots
            else notice(SampleCode.no_plot_counts, why=why)
        )
    if not plots:
        return ForestEstimates(rows=(), notices=tuple(told))
    areas_ha = {row.stratum: row.stratum_ha for row in rows}
    found: dict[str, list[_Plot]] = {name: [] for name in areas_ha}
    for plot in plots:
        found[plot.stratum].append(plot)
    present = {name: own for name, own in found.items() if own}
    is_parted, with_areas = set(areas_ha) != {""}, None not in areas_ha.values()
    strata = [
        _figures(own, {name: areas_ha[name]}, scope=Scope.stratum, stratum=name)
        for name, own in present.items()
        if is_parted
    ]
    of_all = _figures(plots, {name: areas_ha[name] for name in present} if with_areas else {}, scope=Scope.all)
    told += _of_plots(plots)
    if is_parted:
        told += _of_strata(areas_ha, present, with_areas=with_areas)
    return ForestEstimates(rows=(of_all, *strata), notices=tuple(told))


def _plot(row: PlotRow) -> _Plot | None:
    if row.state not in (State.done, State.outdated) or not row.has_border:
        return None
    if row.stems_per_ha is None or row.area_m2 is None or row.area_m2 <= 0.0:
        return None
    hectares = row.area_m2 / M2_PER_HA
    basal_area = row.basal_area_m2_per_ha
    return _Plot(
        name=row.plot,
        stratum=row.stratum,
        area_m2=row.area_m2,
        stems=row.stems_per_ha * hectares,
        basal_area_m2=None if basal_area is None else basal_area * hectares,
        mean_dbh_cm=row.mean_dbh_cm,
    )


def _figures(
    plots: Sequence[_Plot], areas_ha: dict[str, float | None], *, scope: Scope, stratum: str = ""
) -> ForestFigures:
    """Of plots in strata of these areas, without which strata are left aside."""
    known = [area for area in areas_ha.values() if area is not None]
    area_ha = sum(known) if known and len(known) == len(areas_ha) else None
    by_strata = area_ha is not None and len(areas_ha) > 1

    def estimate(
        own: Sequence[_Plot], amount: Callable[[_Plot], float], other: Callable[[_Plot], float]
    ) -> Estimate | None:
        if by_strata and {plot.stratum for plot in own} != set(areas_ha):
            return None
        values = [np.array([of(plot) for plot in own], dtype=np.float64) for of in (amount, other, _hectares)]
        if not by_strata:
            return estimate_ratio(*values)
        number = {name: place for place, name in enumerate(areas_ha)}
        stratum_of = np.array([number[plot.stratum] for plot in own], dtype=np.intp)
        return estimate_ratio(*values, stratum=stratum_of, stratum_areas=np.array(known))

    with_basal_area = [plot for plot in plots if plot.basal_area_m2 is not None]
    with_mean = [plot for plot in with_basal_area if plot.mean_dbh_cm is not None or not plot.stems]
    stems = estimate(plots, _stems, _hectares)
    basal_area = estimate(with_basal_area, _basal_area, _hectares)
    section = estimate(with_basal_area, _basal_area, _stems)
    return ForestFigures(
        scope=scope,
        stratum=stratum,
        method=_method(plots, by_strata=by_strata),
        plots=len(plots),
        sampled_m2=sum(plot.area_m2 for plot in plots),
        area_ha=area_ha,
        stems_per_ha=stems,
        basal_area_m2_per_ha=basal_area,
        # Of a section in square metres the diameter in centimetres.
        quadratic_mean_dbh_cm=section.root().times(200.0 / math.sqrt(math.pi)) if section and section.value else None,
        mean_dbh_cm=estimate(with_mean, _sum_of_dbh, _stems),
        stems=stems.times(area_ha) if stems and area_ha else None,
        basal_area_m2=basal_area.times(area_ha) if basal_area and area_ha else None,
    )


def _method(plots: Sequence[_Plot], *, by_strata: bool) -> Method:
    if by_strata:
        return Method.stratified
    alike = all(math.isclose(plot.area_m2, plots[0].area_m2) for plot in plots)
    return Method.mean if alike else Method.ratio


def _hectares(plot: _Plot) -> float:
    return plot.area_m2 / M2_PER_HA


def _stems(plot: _Plot) -> float:
    return plot.stems


def _basal_area(plot: _Plot) -> float:
    return plot.basal_area_m2 or 0.0


def _sum_of_dbh(plot: _Plot) -> float:
    """Of all stems, those without a diameter taken to be like the others of the plot."""
    return plot.stems * (plot.mean_dbh_cm or 0.0)


def _why_left_out(rows: Sequence[PlotRow], counted: set[str]) -> tuple[Notice, ...]:
    """Each reason with the names of its plots."""
    left: dict[SampleCode, list[str]] = {}
    for row in rows:
        if row.plot not in counted:
            left.setdefault(_why(row), []).append(row.plot)
    return tuple(notice(code, plots=len(left[code]), names=_shown(left[code])) for code in REASONS if code in left)


def _why(row: PlotRow) -> SampleCode:
    if row.state is State.failed:
        return SampleCode.left_failed
    if row.state is State.waiting:
        return SampleCode.left_waiting
    if row.has_border:
        return SampleCode.left_hardly_seen
    return SampleCode.left_without_border if row.units == "m" else SampleCode.left_without_scale


def _of_plots(plots: Sequence[_Plot]) -> list[Notice]:
    told = []
    unknown = [plot.name for plot in plots if plot.basal_area_m2 is None]
    if unknown:
        told.append(notice(SampleCode.basal_area_unknown, plots=len(unknown), names=_shown(unknown)))
    if len(plots) == 1:
        told.append(notice(SampleCode.one_plot))
    elif not any(plot.stems for plot in plots):
        told.append(notice(SampleCode.no_stems))
    return told


def _of_strata(areas_ha: dict[str, float | None], present: dict[str, list[_Plot]], *, with_areas: bool) -> list[Notice]:
    told = []
    without = [name or "plots without a stratum" for name, area in areas_ha.items() if area is None]
    missing = [name for name in areas_ha if name not in present]
    if not with_areas:
        told.append(notice(SampleCode.strata_without_area, names=_shown(without)))
    elif missing:
        told.append(notice(SampleCode.strata_without_plots, names=_shown(missing)))
    no_basal_area = [name for name, own in present.items() if all(plot.basal_area_m2 is None for plot in own)]
    if with_areas and len(present) > 1 and no_basal_area:
        told.append(notice(SampleCode.strata_without_basal_area, names=_shown(no_basal_area)))
    # Plots without a stratum are none that a second one could be measured in.
    single = [name for name, own in present.items() if name and len(own) == 1]
    if single and len(present) > 1:
        told.append(notice(SampleCode.strata_of_one_plot, names=_shown(single)))
    small = [
        name
        for name, own in present.items()
        if (area := areas_ha[name]) is not None and sum(map(_hectares, own)) > area
    ]
    if small:
        told.append(notice(SampleCode.strata_smaller_than_plots, names=_shown(small)))
    return told


def _shown(names: Iterable[str]) -> tuple[str, ...]:
    """The first names, and how many more there are."""
    names = tuple(names)
    more = len(names) - MOST_NAMES
    return names if more <= 0 else (*names[:MOST_NAMES], f"and {more} more")

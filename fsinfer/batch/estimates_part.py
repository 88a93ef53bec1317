"""The forest in the batch's report: a table of the estimates over all plots and in each stratum."""

from __future__ import annotations

from dataclasses import dataclass

from fsinfer.batch.estimates import ForestEstimates, ForestFigures, Method, Scope
from fsinfer.batch.estimator import Estimate
from fsinfer.notices.numbers import counted
from fsinfer.notices.sentences import sentences
from fsinfer.report.page import Part, missing_part

# What is shown of each: its attribute, its name, and its digits behind the point. Source: layout.
_SHOWN = (
    ("stems_per_ha", "Stems/ha", 0),
    ("basal_area_m2_per_ha", "Basal area (m²/ha)", 1),
    ("quadratic_mean_dbh_cm", "Quadratic mean DBH (cm)", 1),
    ("mean_dbh_cm", "Mean DBH (cm)", 1),
    ("stems", "Stems in total", 0),
    ("basal_area_m2", "Basal area in total (m²)", 0),
)
_HEAD = ("Figure", "Plots", "Estimate", "Standard error", "95 % interval", "Between plots (CV)", "Sampling error")
_METHODS = {
    Method.mean: "mean of plots of equal area",
    Method.ratio: "ratio of means, of plots of different areas",
    Method.stratified: "by strata, each with its area",
}


@dataclass(frozen=True, kw_only=True)
class EstimatesView:
    """The head of the table; of all plots and of each stratum its name and its rows; what is to be told."""

    head: tuple[str, ...]
    groups: tuple[tuple[str, tuple[tuple[str, ...], ...]], ...]
    notices: tuple[str, ...]


def estimates_part(estimates: ForestEstimates) -> Part:
    """The section of the forest; without a plot that counts it says why."""
    told = sentences(estimates.notices)
    if not estimates.rows:
        return missing_part("forest", "Forest", ". ".join(text[0].upper() + text[1:] for text in told) + ".")
    groups = tuple((_title(row), _rows(row)) for row in estimates.rows)
    view = EstimatesView(head=_HEAD, groups=groups, notices=told)
    return Part(anchor="forest", title="Forest", view=view, template="estimates")


def _title(row: ForestFigures) -> str:
    plots = counted(row.plots, "plot", "plots")
    if row.scope is Scope.all:
        return f"All {plots}{_area(row)}: {_METHODS[row.method]}"
    name = f"Stratum {row.stratum}" if row.stratum else "Without a stratum"
    return f"{name}, {plots}{_area(row)}: {_METHODS[row.method]}"


def _area(row: ForestFigures) -> str:
    return "" if row.area_ha is None else f", {row.area_ha:.10g} ha"


def _rows(row: ForestFigures) -> tuple[tuple[str, ...], ...]:
    found = [(name, getattr(row, attribute), digits) for attribute, name, digits in _SHOWN]
    return tuple(_row(name, estimate, digits) for name, estimate, digits in found if estimate is not None)


def _row(name: str, found: Estimate, digits: int) -> tuple[str, ...]:
    # A standard error is told to a digit more than what it is of.
    std_error = "" if found.std_error is None else f"{found.std_error:.{digits + 1 if digits else 0}f}"
    interval = "" if found.lo95 is None else f"{found.lo95:.{digits}f} – {found.hi95:.{digits}f}"
    shares = ("" if share is None else f"{share:.1f} %" for share in (found.cv_percent, found.sampling_error_percent))
    return (name, str(found.plots), f"{found.value:.{digits}f}", std_error, interval, *shares)

"""The estimates of the forest as a table, a row for all plots and one a stratum, and in JSON."""

from __future__ import annotations

from typing import Any

from fsinfer.batch.estimates import ForestEstimates, ForestFigures
from fsinfer.batch.estimator import Estimate
from fsinfer.io.csv_text import Cell
from fsinfer.notices.notice import notice_json
from fsinfer.notices.sentences import joined, sentence
from fsinfer.output.json_values import as_json

# Names of a figure's columns: the figure itself, and what goes before the ends "lo95" and such, and behind them; then
# digits behind the point, of the value and of its errors. Source: layout; more than plots tell.
_FIGURES = (
    ("stems_per_ha", "stems_per_ha_", "", 1),
    ("basal_area_m2_per_ha", "basal_area_", "_m2_per_ha", 3),
    ("quadratic_mean_dbh_cm", "quadratic_mean_dbh_", "_cm", 2),
    ("mean_dbh_cm", "mean_dbh_", "_cm", 2),
)
# The same of totals. Source: layout.
_TOTALS = (("stems", "stems_", "", 0), ("basal_area_m2", "basal_area_", "_m2", 1))
_OF_EACH = (("se", "std_error"), ("lo95", "lo95"), ("hi95", "hi95"))
#: Digits of shares in per cent and of degrees of freedom. Source: layout; more than plots tell.
_DIGITS = 2


def _columns() -> tuple[str, ...]:
    names = ["scope", "stratum", "method", "plots", "sampled_m2", "area_ha"]
    for figure, before, behind, _ in _FIGURES:
        own = figure.removesuffix("_m2_per_ha").removesuffix("_per_ha").removesuffix("_cm")
        names += [f"{own}_plots", figure, *(f"{before}{end}{behind}" for end, _ in _OF_EACH)]
        names += [f"{own}_df", f"{own}_cv_percent", f"{own}_sampling_error_percent"]
    for figure, before, behind, _ in _TOTALS:
        names += [figure, *(f"{before}{end}{behind}" for end, _ in _OF_EACH)]
    return (*names, "remarks")


#: Columns of the table.
ESTIMATE_COLUMNS = _columns()


def estimate_rows(estimates: ForestEstimates) -> list[tuple[Cell, ...]]:
    """The values of ``ESTIMATE_COLUMNS``, rounded; what is to be told stands in the row of all plots."""
    return [
        (*_cells(row), joined(estimates.notices) if number == 0 else "") for number, row in enumerate(estimates.rows)
    ]


def estimates_json(estimates: ForestEstimates) -> dict[str, Any]:
    """The rows with all digits, and the notices as codes with their sentences."""
    notices = [{**notice_json(given), "text": sentence(given)} for given in estimates.notices]
    return {"rows": as_json(estimates.rows), "notices": notices}


def _cells(row: ForestFigures) -> list[Cell]:
    cells: list[Cell] = [row.scope.value, row.stratum, row.method.value, row.plots, round(row.sampled_m2, 1)]
    cells.append(None if row.area_ha is None else round(row.area_ha, 4))
    for figure, _, _, digits in _FIGURES:
        found: Estimate | None = getattr(row, figure)
        cells += [None if found is None else found.plots, *_with_ends(found, digits)]
        shares = (None, None, None) if found is None else (found.df, found.cv_percent, found.sampling_error_percent)
        cells += [_rounded(share, _DIGITS) for share in shares]
    for figure, _, _, digits in _TOTALS:
        cells += _with_ends(getattr(row, figure), digits)
    return cells


def _with_ends(found: Estimate | None, digits: int) -> list[Cell]:
    """The value, its standard error and the ends of its interval."""
    if found is None:
        return [None] * (1 + len(_OF_EACH))
    return [_rounded(found.value, digits), *(_rounded(getattr(found, name), digits) for _, name in _OF_EACH)]


def _rounded(value: float | None, digits: int) -> Cell:
    return None if value is None else round(value, digits)

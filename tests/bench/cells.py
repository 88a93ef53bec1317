"""What the tables of :mod:`tests.bench.templates` are put together from: numbers in words, cells, Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from tests.bench.results import Result

Lines = list[str]


def number(value: float, spec: str) -> str:
    """A number with a real minus sign."""
    return format(value, spec).replace("-", "\N{MINUS SIGN}")


def counted(value: float, one: str, many: str) -> str:
    """``no false trees``, ``1 false tree``, ``2 false trees``."""
    return f"no {many}" if value == 0 else f"{value:g} {one if value == 1 else many}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Lines:
    """A Markdown table."""
    return [f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows)]


def known(result: Result, key: str, spec: str, unit: str) -> str:
    """A figure with its unit, a dash where the result has none."""
    return f"{number(result.figures[key], spec)}{unit}" if key in result.figures else "–"


def source(result: Result, name: str) -> str:
    """RMSE and largest error of the points or the edges alone."""
    rmse, worst = (known(result, f"{name}_alone_{key}_cm", ".2f", " cm") for key in ("rmse", "worst"))
    return f"{rmse}, {worst}" if rmse != "–" else "–"


def error(result: Result, prefix: str) -> str:
    """RMSE and bias of one group."""
    return f"{known(result, f'{prefix}rmse_cm', '.2f', ' cm')}, {known(result, f'{prefix}bias_cm', '+.2f', ' cm')}"


def covered(result: Result, prefix: str) -> str:
    """Stems with a DBH, RMSE, coverage and the median half width of one group."""
    return f"{group(result, prefix)}, ± {known(result, f'{prefix}half_width_median_cm', '.2f', ' cm')}"


def group(result: Result, prefix: str) -> str:
    """Stems with a DBH, RMSE and coverage of one group."""
    rmse = known(result, f"{prefix}rmse_cm", ".2f", " cm")
    inside = known(result, f"{prefix}inside_interval_percent", ".1f", " %")
    return f"{result.figures[f'{prefix}measured']:g}, {rmse}, {inside}"

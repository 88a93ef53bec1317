"""All tables of the trees as one workbook."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from fsinfer.trees.measure import PlotResult
from fsinfer.trees.stem_curve import CurvePoint

if TYPE_CHECKING:
    from fsinfer.trees import PlotResult
    from fsinfer.trees.stem_curve import CurvePoint


def write_tables(path: Path, result: PlotResult, curves: dict[int, tuple[CurvePoint, ...]]) -> None:
    """Write the trees, the stand table and the stem curves as sheets of one XLSX workbook."""
    from fsinfer.io.workbook import write_workbook
    from fsinfer.trees.outputs.table import COLUMNS, table_row
    from fsinfer.trees.stem_curve import COLUMNS as CURVE_COLUMNS
    from fsinfer.trees.stem_curve import curve_row

    stand = [("figure", "value"), *asdict(result.stand).items()]
    write_workbook(
        path,
        {
            "trees": [COLUMNS, *map(table_row, result.trees)],
            "stand": stand,
            "stem curve": [CURVE_COLUMNS, *(curve_row(point) for curve in curves.values() for point in curve)],
        },
    )

"""The figures of the stand: from ``plot.json`` where a run gave them, else from the diameters in ``trees.csv``."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fsinfer.report.contents import Contents, measured_cm, number, tree_number
from fsinfer.report.number_table import NumberTable
from fsinfer.report.plot_border import border_of, lost_border, rows_in, same_mean
from fsinfer.trees.rough_dbh import rough_of_text
from fsinfer.trees.stand import StandTable, counted_basal_area_m2, or_nan, stand_of_diameters

#: Width of the diameter classes of the stand table. Source: layout; inventories use 2, 4 or 5 cm.
CLASS_CM = 5


def stand_of(contents: Contents) -> StandTable:
    """The stand's figures; a table that was changed since the run counts for itself."""
    dbh_cm = [number(tree.get("dbh_cm")) for tree in contents.counted]
    area_m2 = max(number(contents.plot.get("plot_area_m2")) or 0.0, 0.0)
    own = stand_of_diameters(dbh_cm, area_m2, rough_cm=_rough_cm(contents.counted))
    given = contents.plot.get("stand")
    if not isinstance(given, dict):
        return own
    if is_changed(contents):
        return _with_share(own, _share_on_area(given))
    on_area = number(given.get("stems_on_area"))
    return StandTable(
        stems=own.stems,
        measured=own.measured,
        plot_area_m2=number(given.get("plot_area_m2")),
        area_method=str(given.get("area_method") or own.area_method),
        stems_per_ha=number(given.get("stems_per_ha")),
        basal_area_m2_per_ha=number(given.get("basal_area_m2_per_ha")),
        quadratic_mean_dbh_cm=number(given.get("quadratic_mean_dbh_cm")),
        mean_dbh_cm=number(given.get("mean_dbh_cm")),
        stems_on_area=None if on_area is None else int(on_area),
        off_area=_off_area(given),
    )


def is_changed(contents: Contents) -> bool:
    """Whether ``trees.csv`` was changed since its figures were made: other stems, or other diameters."""
    if contents.trees is None:
        return False
    if lost_border(contents):
        return True
    given = contents.plot.get("stand")
    if not isinstance(given, dict):
        return False
    everywhere, off = measured_cm(contents.counted), _off_area(given)
    if (given.get("stems"), given.get("measured")) != (len(contents.counted), len(everywhere)):
        return True
    # Before the means were those of the stems on the area they were of all.
    on_area = measured_cm([tree for tree in contents.counted if tree_number(tree) not in off])
    return not any(same_mean(values, number(given.get("mean_dbh_cm"))) for values in (on_area, everywhere))


def _off_area(given: Mapping[str, Any]) -> tuple[int, ...]:
    """Numbers of the stems that stand on other ground than that whose area is known."""
    return tuple(int(n) for one in given.get("off_area") or () if (n := number(one)) is not None)


def _rough_cm(rows: Sequence[Mapping[str, str]]) -> list[float | None]:
    """What is roughly known of those without a DBH, cm, by the reasons in the table."""
    known = [None if number(tree.get("dbh_cm")) else rough_of_text(tree.get("reason") or "") for tree in rows]
    return [None if rough is None else rough[0] for rough in known]


def _share_on_area(given: Mapping[str, Any]) -> float:
    """Share of the stems of the run that stood on the ground whose area is known."""
    on_area, stems = number(given.get("stems_on_area")), number(given.get("stems"))
    return 1.0 if on_area is None or not stems else on_area / stems


def _with_share(own: StandTable, share: float) -> StandTable:
    """The stand where this share of the stems stands on the area: nobody knows which of a table that was changed."""
    if own.stems_per_ha is None:
        return own
    basal = own.basal_area_m2_per_ha
    return replace(
        own,
        stems_per_ha=own.stems_per_ha * share,
        basal_area_m2_per_ha=None if basal is None else basal * share,
        stems_on_area=round(own.stems * share),
    )


def diameters_cm(contents: Contents, *, everywhere: bool = False) -> list[float]:
    """DBH of the measured stems: in the plot where it has a border, unless those ``everywhere`` are asked for.

    Without those outside of the walk, which no border counts.
    """
    rows = contents.counted
    if not everywhere and border_of(contents) is not None:
        rows = rows_in(contents)
    return measured_cm(rows)


def basal_area_m2(dbh_cm: Sequence[float]) -> float:
    """Sum of pi/4 DBH^2."""
    return math.pi / 4 * sum((d / 100) ** 2 for d in dbh_cm)


def class_table(contents: Contents, stand: StandTable) -> NumberTable | None:
    """Stems and basal area by classes of diameter, within the plot's border where it has one; None without a DBH."""
    plot = border_of(contents)
    trees = contents.counted if plot is None else rows_in(contents)
    off = frozenset(stand.off_area if plot is None else ())
    sized = [(d, tree_number(tree) not in off) for tree in trees if (d := number(tree.get("dbh_cm"))) is not None]
    dbh_cm = [d for d, _ in sized]
    if not dbh_cm:
        return None
    counting = [d for d, counts in sized if counts]
    on = np.array([tree_number(tree) not in off for tree in trees], dtype=bool)
    all_cm = or_nan([number(tree.get("dbh_cm")) for tree in trees])
    whole_m2 = counted_basal_area_m2(all_cm, or_nan(_rough_cm(trees)), on)
    if plot is None:
        count = stand.stems - len(stand.off_area)
        per_hectare = _a_hectare(stand.stems_per_ha, stand.basal_area_m2_per_ha, count, whole_m2)
    else:
        stems, basal = plot.stems_per_ha, plot.basal_area_m2_per_ha
        of_stems, of_basal = (None if figure is None else figure.value for figure in (stems, basal))
        per_hectare = _a_hectare(of_stems, of_basal, plot.stems, whole_m2)
    head = ["DBH class (cm)", "Stems", "Basal area (m²)"]
    if per_hectare is not None:
        head += ["Stems per ha", "Basal area (m²/ha)"]
    counted = Counter(int(d // CLASS_CM) for d in dbh_cm)
    rows = []
    for k in range(min(counted), max(counted) + 1):
        own, counts = ([d for d in of if int(d // CLASS_CM) == k] for of in (dbh_cm, counting))
        rows.append(_class_row(f"{k * CLASS_CM} to under {(k + 1) * CLASS_CM}", own, counts, per_hectare))
    rows.append(_class_row("All with a DBH", dbh_cm, counting, per_hectare))
    title = "Stand table" if plot is None else "Stand table of the plot"
    return NumberTable(title=title, head=tuple(head), rows=tuple(rows), total=True)


def _a_hectare(
    stems_per_ha: float | None, basal_m2_per_ha: float | None, stems: int, whole_m2: float | None
) -> tuple[float, float] | None:
    """What a stem, and a square metre of section, counts a hectare, so that classes add up to the plot's figures.

    ``stems`` are those that count, ``whole_m2`` the sum of their sections with what those without a DBH count for.
    """
    if stems_per_ha is None or not stems:
        return None
    stem = stems_per_ha / stems
    return stem, stem if basal_m2_per_ha is None or not whole_m2 else basal_m2_per_ha / whole_m2


def _class_row(
    name: str, dbh_cm: Sequence[float], counting: Sequence[float], per_hectare: tuple[float, float] | None
) -> tuple[str, ...]:
    """Stems and basal area of a class, and what those of its stems that count to the hectare make there."""
    basal_m2 = basal_area_m2(dbh_cm)
    row = (name, str(len(dbh_cm)), f"{basal_m2:.3f}")
    if per_hectare is None:
        return row
    stem, section = per_hectare
    return (*row, f"{len(counting) * stem:.0f}", f"{basal_area_m2(counting) * section:.1f}")

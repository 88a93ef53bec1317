"""The stand table: stems and basal area a hectare, quadratic mean diameter, and the area they refer to."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.points.cells import column_min, rows
from fsinfer.trees.rough_dbh import is_hardly_known, rough_dbh_cm
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]

#: Cells by which it is asked how much of a plot was seen, metres. Source: not recorded.
CELL_M = 0.5
#: The area is counted by finer ones, so many times as wide as one point stands from the next: a cell that a rim cuts
#: counts as whole, which makes the area half a cell larger along it, and between points the rim frays by as much.
#: Source: simulated points, evenly spread over circles and squares of 50 to 1,000 m², 4 to 400 a square metre.
SPACINGS = 1.35
#: ... but no finer, metres. Source: numerics; along the rim of a circle of 100 m² it makes 0.9 %.
LEAST_CELL_M = 0.05
#: ... nor more in a raster. Source: numerics; 50 m square by the finest.
MOST_CELLS = 1e6
#: Herbs and noise: what lies so low, metres, stands for ground that was seen. Source: not recorded.
NEAR_GROUND_M = 0.3
#: Half the width of gaps that are closed, metres: the shadow of a stem or a shrub on the ground belongs to the plot.
#: Source: not recorded.
CLOSE_M = 1.0
AREA_METHOD = "ground seen in the cloud, gaps of up to 2 m closed"
NO_AREA = "unknown: the cloud shows too little ground around the stems"
#: Share of the stems that must stand on ground that was seen, or its area says nothing of the plot. Source: judgement;
#: what stands on the rest is counted nowhere, and half of the stems are hardly the plot.
LEAST_ON_GROUND = 0.5

#: Measured stems whose mean section stands for those without a DBH. Source: judgement; one is no mean.
LEAST_MEASURED = 2
#: Per cent of the basal area that stems without a known size may be unsaid. Source: judgement; as much as diameters
#: that are 5 % wrong make.
_MOST_UNSAID_PERCENT = 10.0


@dataclass(frozen=True, kw_only=True)
class StandTable:
    """The stems, and what of them stands on a hectare.

    ``stems`` are all, ``measured`` those with a DBH. ``plot_area_m2`` is horizontal, None where it is not known;
    ``area_method`` says how it was taken. Only the ``stems_on_area`` count to the hectare: those on other ground, whose
    numbers ``off_area`` are, would make the plot denser than it is. In the basal area those without a DBH count with
    what is roughly known of them (:func:`fsinfer.trees.rough_dbh.rough_dbh_cm`) or the mean section of the others, as
    on a plot with a border; it is None where too few were measured for that, and 0 without stems. The mean
    diameters are those of the measured stems that count to the hectare, or of all where no area is known.
    """

    stems: int
    measured: int
    plot_area_m2: float | None
    area_method: str
    stems_per_ha: float | None
    basal_area_m2_per_ha: float | None
    quadratic_mean_dbh_cm: float | None
    mean_dbh_cm: float | None
    stems_on_area: int | None = None
    off_area: tuple[int, ...] = ()


def stand_table(
    trees: Sequence[Tree],
    plot_area_m2: float,
    *,
    on_area: NDArray[np.bool_] | None = None,
    area_method: str = AREA_METHOD,
) -> StandTable:
    """Summarise ``trees`` on ``plot_area_m2`` square metres (0 when unknown: nothing is given a hectare).

    ``on_area`` (T,) says which of them stand on it, all where it is None.
    """
    dbh_cm, rough_cm = [tree.dbh_cm for tree in trees], _rough_cm(trees)
    stand = stand_of_diameters(dbh_cm, plot_area_m2, on_area=on_area, rough_cm=rough_cm, area_method=area_method)
    if on_area is None or stand.stems_on_area is None:
        return stand
    return replace(stand, off_area=tuple(tree.tree_id for tree, on in zip(trees, on_area, strict=True) if not on))


def stand_of_diameters(
    dbh_cm: Sequence[float | None],
    plot_area_m2: float,
    *,
    on_area: NDArray[np.bool_] | None = None,
    rough_cm: Sequence[float | None] | None = None,
    area_method: str = AREA_METHOD,
) -> StandTable:
    """:func:`stand_table` of one DBH a stem, None where it was not measured; ``rough_cm`` is what is known of those."""
    all_cm = or_nan(dbh_cm)
    on = np.ones(len(all_cm), dtype=bool) if on_area is None else on_area
    hectares = plot_area_m2 / 10_000.0
    measured = np.isfinite(all_cm)
    # Means are of the stems that count to the hectare, as the basal area is.
    dbh = all_cm[measured & on] if hectares > 0 else all_cm[measured]
    rough = or_nan([None] * len(all_cm) if rough_cm is None else rough_cm)
    basal_m2 = counted_basal_area_m2(all_cm, rough, on) if hectares > 0 else None
    return StandTable(
        stems=len(all_cm),
        measured=int(measured.sum()),
        plot_area_m2=plot_area_m2 if hectares > 0 else None,
        area_method=area_method if hectares > 0 else NO_AREA,
        stems_per_ha=float(on.sum()) / hectares if hectares > 0 else None,
        basal_area_m2_per_ha=None if basal_m2 is None else basal_m2 / hectares,
        quadratic_mean_dbh_cm=float(np.sqrt((dbh**2).mean())) if len(dbh) else None,
        mean_dbh_cm=float(dbh.mean()) if len(dbh) else None,
        stems_on_area=int(on.sum()) if hectares > 0 else None,
    )


def _rough_cm(trees: Sequence[Tree]) -> list[float | None]:
    return [None if (known := rough_dbh_cm(tree)) is None else known[0] for tree in trees]


def sizes_unknown(trees: Sequence[Tree], off_area: Collection[int] = ()) -> tuple[Notice, ...]:
    """A warning where much of a basal area a hectare is that of stems of whose size hardly anything is known.

    ``off_area`` are the numbers of those of the ``trees`` that it does not count. Measured ones among them have a say
    in what those of unknown size are taken for all the same, as in the figure (:func:`counted_basal_area_m2`).
    """
    dbh_cm, rough_cm = or_nan([tree.dbh_cm for tree in trees]), or_nan(_rough_cm(trees))
    on = np.array([tree.tree_id not in off_area for tree in trees], dtype=bool)
    unknown = on & np.array([is_hardly_known(tree) for tree in trees], dtype=bool)
    whole, rest = (counted_basal_area_m2(dbh_cm, rough_cm, some) for some in (on, on & ~unknown))
    if not unknown.any() or whole is None or rest is None:
        return ()
    percent = 100.0 * (1.0 - rest / whole)
    if percent < _MOST_UNSAID_PERCENT:
        return ()
    names = tuple(str(tree.tree_id) for tree, lost in zip(trees, unknown, strict=True) if lost)
    return (notice(StemCode.sizes_unknown, percent=percent, trees=names),)


def or_nan(values: Sequence[float | None]) -> Floats:
    """(T,) with NaN for None."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def counted_basal_area_m2(dbh_cm: Floats, rough_cm: Floats, on: NDArray[np.bool_]) -> float | None:
    """Of the stems ``on`` (T,) the plot: those without a DBH (NaN) count as ``rough_cm`` (T,), or, where that is NaN
    too, with the mean section of all that were measured (T,); None where those are too few, 0 where no stem is ``on``.
    """
    if not on.any():
        return 0.0  # nothing stands there: who takes means over plots has to count it, not to leave it out
    sections, rough = (np.pi / 4.0 * (values / 100.0) ** 2 for values in (dbh_cm, rough_cm))
    measured = np.isfinite(sections)
    known = np.where(measured, sections, rough)
    mean = mean_section(sections[measured], lacking=bool((on & ~np.isfinite(known)).any()))
    return None if mean is None else float(np.where(np.isfinite(known), known, mean)[on].sum())


def mean_section(sections_m2: Floats, *, lacking: bool) -> float | None:
    """Mean of the sections (M,) of the measured stems, which stands for those of others, if any are ``lacking``.

    None where there is no stem that was measured, or too few to stand for others.
    """
    return float(sections_m2.mean()) if len(sections_m2) >= (LEAST_MEASURED if lacking else 1) else None


@dataclass(frozen=True, kw_only=True)
class SeenCells:
    """Square cells of ``cell_m`` where ground was seen: ``seen`` (X, Y), the first one beginning at ``corner`` (2,)."""

    seen: NDArray[np.bool_]
    corner: Floats
    cell_m: float = CELL_M

    def at(self, xy: Floats) -> NDArray[np.bool_]:
        """Whether the ground was seen at each of places (N, 2)."""
        cell = np.floor((xy - self.corner) / self.cell_m).astype(np.int64)
        within = ((cell >= 0) & (cell < self.seen.shape)).all(axis=1)
        result = np.zeros(len(xy), dtype=bool)
        result[within] = self.seen[cell[within, 0], cell[within, 1]]
        return result

    @property
    def middles(self) -> Floats:
        """(C, 2) of the cells that were seen."""
        return np.asarray(self.corner + self.cell_m * (np.argwhere(self.seen) + 0.5))

    def only(self, chosen: NDArray[np.bool_]) -> SeenCells:
        """Those of the cells that were seen, in the order of :attr:`middles`, which ``chosen`` (C,) names."""
        seen = self.seen.copy()
        seen[seen] = chosen
        return replace(self, seen=seen)

    def with_places(self, xy: Floats) -> SeenCells:
        """With the cells of places (N, 2) where ground was seen, too; gaps between them are closed."""
        cell = np.floor((xy - self.corner) / self.cell_m).astype(np.int64)
        reach = round(CLOSE_M / self.cell_m) + 1
        low = cell.min(axis=0, initial=0) - reach
        high = np.maximum(cell.max(axis=0, initial=0) + 1, self.seen.shape) + reach
        seen = np.zeros(tuple(high - low), dtype=bool)
        seen[-low[0] : self.seen.shape[0] - low[0], -low[1] : self.seen.shape[1] - low[1]] = self.seen
        seen[tuple((cell - low).T)] = True
        return replace(self, seen=_closed(seen, self.cell_m), corner=self.corner + low * self.cell_m)

    def area(self, stems_xy: Floats) -> float:
        """Horizontal, square metres; 0 where too many stems (T, 2) stand off it: then it says nothing of the plot."""
        if not self.seen.any() or np.count_nonzero(self.at(stems_xy)) < LEAST_ON_GROUND * len(stems_xy):
            return 0.0
        return float(self.seen.sum() * self.cell_m**2)


def near_ground(points: Floats, ground_m: Floats | float) -> Floats:
    """Places (M, 2) of those of points (N, 3) that show ground, or what is as low as herbs.

    ``ground_m`` (N,) is the height of the ground there.
    """
    return rows(points[:, :2], np.abs(points[:, 2] - ground_m) <= NEAR_GROUND_M)


def seen_cells(low: Floats, *, close: bool = True) -> SeenCells:
    """Where the ground is seen: cells with points of ``low`` (N, 2), those within ``NEAR_GROUND_M`` of the ground.

    ``close`` counts gaps of up to two metres as seen, by cells as fine as the points allow.
    """
    if len(low) == 0:
        return SeenCells(seen=np.zeros((0, 0), dtype=bool), corner=np.zeros(2))
    origin = column_min(low)
    cell_m = _cell_m(low, origin) if close else CELL_M
    reach = round(CLOSE_M / cell_m)
    column, row = (((low[:, axis] - origin[axis]) / cell_m).astype(np.int64) + reach + 1 for axis in range(2))
    seen = np.zeros((int(column.max()) + reach + 2, int(row.max()) + reach + 2), dtype=bool)
    seen[column, row] = True
    if close:
        seen = _closed(seen, cell_m)
    return SeenCells(seen=seen, corner=origin - (reach + 1) * cell_m, cell_m=cell_m)


def seen_share(low: Floats, box: Floats) -> float:
    """Share of a ``box`` (2, 2) in plan, lowest and highest x and y, that points ``low`` (N, 2) of the ground show."""
    inside = low[((low >= box[0]) & (low <= box[1])).all(axis=1)]
    plan_m2 = float(np.prod(box[1] - box[0]))
    return seen_cells(inside, close=False).area(np.zeros((0, 2))) / plan_m2 if plan_m2 > 0 else 0.0


def _cell_m(low: Floats, origin: Floats) -> float:
    """Side of the cells by which points (N, 2), which begin at ``origin`` (2,), measure an area, metres."""
    column, row = (((low[:, axis] - origin[axis]) / CELL_M).astype(np.int64) for axis in range(2))
    width = int(row.max()) + 1
    least_m = max(LEAST_CELL_M, CELL_M * float(np.sqrt((column.max() + 1.0) * width / MOST_CELLS)))
    if least_m >= CELL_M:
        return CELL_M
    counts = np.bincount(column * width + row)
    per_m2 = float(np.median(counts[counts > 0])) / CELL_M**2
    return float(np.clip(SPACINGS / np.sqrt(per_m2), least_m, CELL_M))


def _closed(seen: NDArray[np.bool_], cell_m: float) -> NDArray[np.bool_]:
    """With the gaps that a square of twice ``CLOSE_M`` does not fit into."""
    width = 2 * round(CLOSE_M / cell_m) + 1
    grown = maximum_filter(seen.astype(np.uint8), size=width, mode="constant")
    return np.asarray(minimum_filter(grown, size=width, mode="constant") > 0)

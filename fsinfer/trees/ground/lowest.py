"""The lowest dense layers of a plot by cell: what of it can be ground."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, grey_dilation, grey_erosion
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fsinfer.trees.ground.settings import GroundSettings
from fsinfer.trees.points.cells import MAX_TABLE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
#: Cells of the raster, at most, so that its equations stay solvable in seconds; a hectare keeps its 0.4 m.
#: Source: numerics.
MOST_CELLS = 60_000.0
#: Points of a cell whose median is a height. Source: not recorded.
LEAST_OF_A_CELL = 3
#: The least step of a slope from cell to cell has this share of the greatest. Source: shapes of relief
#: (``python -m tests.bench.relief``); a ditch three metres wide is none.
ALIKE = 0.7


@dataclass(frozen=True, kw_only=True)
class LowestCells:
    """What of a plot can be ground: its lowest dense layers by cell.

    ``columns`` are x, y, z (N,) of the points, ``index`` (N,) their cells, ``cell`` (C,) the cells that have a ``low``
    (C,) of so many points, ``count`` (C,), of which ``reachable`` (C,) can be ground, and ``at_bank`` (C,) lie about a
    bank steeper than the slope of ground, on either side. ``settings`` have the size of the cells that was used.
    """

    settings: GroundSettings
    columns: tuple[Floats, Floats, Floats]
    origin: Floats
    shape: tuple[int, int]
    index: Ints
    cell: Ints
    low: Floats
    count: Floats
    reachable: NDArray[np.bool_]
    at_bank: NDArray[np.bool_]


def lowest_cells(points: Floats, settings: GroundSettings) -> LowestCells:
    """The lowest dense layers below points (N, 3), metres, z up, and which of them can be ground."""
    x, y, z = (np.ascontiguousarray(points[:, axis]) for axis in range(3))
    origin = np.array([x.min(), y.min()])
    area = max(float(x.max() - origin[0]), settings.cell_m) * max(float(y.max() - origin[1]), settings.cell_m)
    settings = replace(settings, cell_m=max(settings.cell_m, float(np.sqrt(area / MOST_CELLS))))
    index, column = (_steps(v, low, settings.cell_m) for v, low in ((y, origin[1]), (x, origin[0])))
    shape = (int(index.max()) + 1, int(column.max()) + 1)
    index *= shape[1]
    index += column
    cell, low, count = _lowest_layers(index, z, settings)
    reachable, at_bank = _slope_filter(cell, low, shape, settings)
    return LowestCells(
        settings=settings,
        columns=(x, y, z),
        origin=origin,
        shape=shape,
        index=index,
        cell=cell,
        low=_low_at_middles((x - origin[0], y - origin[1], z), index, cell, low, shape, settings),
        count=count,
        reachable=reachable,
        at_bank=at_bank,
    )


def _low_at_middles(
    columns: tuple[Floats, Floats, Floats],
    index: Ints,
    cell: Ints,
    low: Floats,
    shape: tuple[int, int],
    settings: GroundSettings,
) -> Floats:
    """The heights (C,) of the lowest dense layers at the cells' middles, where the ground is steep.

    A level layer of a slope holds the lower border of a cell, farther below the ground at its middle than points are
    looked for about it (``band_m``). Such a cell is looked at once more, in layers along the slope. ``columns`` are x,
    y from the corner of the raster and z (N,) of the points.
    """
    surface = np.full(shape, np.nan)
    surface.ravel()[cell] = low
    down, right = (_slope_about(surface, axis) / settings.cell_m for axis in (0, 1))
    steep = (0.5 * settings.cell_m * np.hypot(down, right) > settings.band_m).ravel()
    if not steep[cell].any():
        return low
    chosen = np.flatnonzero(steep.take(index))
    own = index.take(chosen)
    x, y, z = (column.take(chosen) for column in columns)
    z = z - right.ravel().take(own) * (x - settings.cell_m * (own % shape[1] + 0.5))
    z -= down.ravel().take(own) * (y - settings.cell_m * (own // shape[1] + 0.5))
    found, heights, _ = _lowest_layers(own, z, settings)
    surface.ravel()[found] = heights
    return np.asarray(surface.ravel()[cell])


def _slope_about(surface: Floats, axis: int) -> Floats:
    """How much a raster (H, W) rises from cell to cell along an axis, by the least of the two steps on either side.

    It is 0 where that is less than :data:`ALIKE` of the greatest, about a bank or a ditch, and where fewer than two
    of them are known (NaN).
    """
    steps = np.diff(surface, axis=axis, append=np.nan)  # the last is none, and comes round before the first
    four = np.stack([np.roll(steps, shift, axis=axis) for shift in (-1, 0, 1, 2)])
    known = np.isfinite(four)
    signs = np.where(known, np.sign(four), 0.0).sum(axis=0)
    alike = (np.abs(signs) == known.sum(axis=0)) & (known.sum(axis=0) >= 2)
    least, most = (np.where(known, np.abs(four), none) for none in (np.inf, 0.0))
    least, most = least.min(axis=0), most.max(axis=0)
    alike &= least >= ALIKE * most
    return np.asarray(np.where(alike, np.sign(signs) * np.where(alike, least, 0.0), 0.0))


def _steps(values: Floats, low: float, size: float) -> Ints:
    """In which step of ``size`` above ``low`` each of the values (N,) lies."""
    position = values - low
    position /= size
    return position.astype(np.int64)


def _slope_filter(
    cell: Ints, low: Floats, shape: tuple[int, int], settings: GroundSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which cells can be ground: none nearby lies lower than the steepest slope allows (Vosselman's slope filter).

    And, second, which lie about a bank that is steeper.
    """
    surface = np.full(shape, np.inf)
    surface.ravel()[cell] = low
    reach = int(np.ceil(settings.filter_radius_m / settings.cell_m))
    steps = np.arange(-reach, reach + 1) * settings.cell_m
    cone = np.tan(np.radians(settings.max_slope_deg)) * np.hypot(*np.meshgrid(steps, steps)) + settings.filter_slack_m
    lowest = grey_erosion(surface, structure=-cone, mode="constant", cval=np.inf)
    return _with_terraces(cell, surface, low <= lowest.ravel()[cell], settings)


def _with_terraces(
    cell: Ints, surface: Floats, reachable: NDArray[np.bool_], settings: GroundSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which cells (C,) can be ground, those above a bank as well, which the steepest slope does not allow there.

    They go on level, step by step, from cells farther from the bank that can be ground. All cells (C,) near them come
    second, above the bank and below it. ``surface`` (H, W) has the lowest heights of the cells, infinite where there is
    none.
    """
    numbers = np.arange(surface.size).reshape(surface.shape)
    pairs = []
    for here, there in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        with np.errstate(invalid="ignore"):
            level = np.abs(surface[here] - surface[there]) <= settings.terrace_step_m
        pairs.append((numbers[here][level], numbers[there][level]))
    first, second = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    joined = coo_matrix((np.ones(len(first)), (first, second)), shape=(surface.size, surface.size))
    _, group = connected_components(joined, directed=False)
    of_cell = group[cell]
    all_of, can_be = (np.bincount(of_cell, weights=weights, minlength=1) for weights in (None, reachable))
    level_ground = (can_be >= settings.terrace_share * all_of) & (can_be >= settings.terrace_cells)
    above_bank = np.bincount(of_cell, weights=~reachable, minlength=1) >= settings.terrace_hidden
    hidden = (level_ground & above_bank)[of_cell] & ~reachable
    if not hidden.any():
        return reachable, hidden
    elsewhere = np.ones(surface.size, dtype=bool)
    elsewhere[cell[hidden]] = False
    distance = distance_transform_edt(elsewhere.reshape(surface.shape)).ravel()[cell]
    return np.asarray(reachable | hidden), np.asarray(distance * settings.cell_m <= settings.filter_radius_m)


def opened(cell: Ints, low: Floats, shape: tuple[int, int], settings: GroundSettings) -> Floats:
    """The heights (H, W) of cells with what is narrower than undergrowth cut off, by a morphological opening.

    It leaves slopes, valleys and banks as they are, and cuts crests and mounds, which a surface can climb again.
    """
    reach = int(np.ceil(settings.open_m / settings.cell_m))
    steps = np.arange(-reach, reach + 1)
    disc = np.hypot(*np.meshgrid(steps, steps)) <= reach + 0.3
    known = np.zeros(shape, dtype=bool)
    known.ravel()[cell] = True
    surface = np.zeros(shape)
    surface.ravel()[cell] = low
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    surface = surface[tuple(nearest)]
    eroded = grey_erosion(surface, footprint=disc, mode="nearest")
    return np.asarray(grey_dilation(eroded, footprint=disc, mode="nearest"))


def _count(key: Ints) -> tuple[Ints, Ints]:
    """The values (K,) among ``key`` (N,), ascending, and how often each occurs."""
    if int(key.max()) > min(MAX_TABLE, 20 * len(key)):
        values, count = np.unique(key, return_counts=True)
        return values, count
    table = np.bincount(key)
    values = np.flatnonzero(table)
    return values, table[values]


def _lowest_layers(index: Ints, z: Floats, settings: GroundSettings) -> tuple[Ints, Floats, Floats]:
    """Cells, height and points of their lowest dense layer (C,): strays below the ground are not dense."""
    bottom = float(z.min())
    key = _steps(z, bottom, settings.layer_m)
    layers = int(key.max()) + 1
    key += index * layers
    key, count = _count(key)
    cell, level = key // layers, key % layers
    starts = np.flatnonzero(np.r_[True, cell[1:] != cell[:-1]])
    lowest = np.repeat(level[starts], np.diff(np.r_[starts, len(cell)]))
    near = level - lowest <= settings.search_m / settings.layer_m
    # Two adjacent bins together, because a thin ground layer may straddle a boundary.
    joined = count.astype(np.float64)
    adjacent = np.r_[(cell[1:] == cell[:-1]) & (level[1:] == level[:-1] + 1), False]
    joined[adjacent] += np.r_[count[1:], 0][adjacent]
    most = np.maximum.reduceat(np.where(near, joined, 0.0), starts)
    most_each = np.repeat(most, np.diff(np.r_[starts, len(cell)]))
    dense = near & (joined >= np.maximum(settings.dense_share * most_each, 2.0))
    first = np.full(len(starts), -1)
    group = np.repeat(np.arange(len(starts)), np.diff(np.r_[starts, len(cell)]))
    rows = np.flatnonzero(dense)
    first[group[rows[::-1]]] = rows[::-1]
    found = first[first >= 0]
    next_count = np.where(adjacent[found], np.r_[count[1:], 0][found], 0)
    center = (level[found] + 0.5 + next_count / np.maximum(joined[found], 1)) * settings.layer_m + bottom
    return cell[found], center, joined[found]


def support(count: Floats, well_seen: float) -> Floats:
    """What cells with so many points (C,) count beside one with ``well_seen`` times those of the median one, 0 to 1.

    At the border of a plot a handful of points of leaves and haze is all there is, beside thousands elsewhere.
    """
    if len(count) == 0:
        return count
    return np.asarray(np.minimum(1.0, count / max(well_seen * float(np.median(count)), 1.0)))


def cell_medians(index: Ints, z: Floats) -> tuple[Ints, Floats]:
    """Those of the cells ``index`` (N,) with enough points, and the median of their heights ``z`` (N,); (K,) each."""
    if len(index) == 0:
        return index, z
    # By cell, then by height, in one sort: a cell's heights stay within the span that separates it from the next.
    bottom, span = float(z.min()) - 0.5, float(np.ptp(z)) + 1.0
    both = np.sort(index * span + (z - bottom))
    index = (both / span).astype(np.int64)
    z = both - index * span + bottom
    starts = np.flatnonzero(np.r_[True, index[1:] != index[:-1]])
    count = np.diff(np.r_[starts, len(index)])
    enough = count >= LEAST_OF_A_CELL
    return index[starts][enough], z[(starts + count // 2)][enough]

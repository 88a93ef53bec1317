"""The ground under a plot: a RANSAC plane, and a smooth terrain raster on top where the plane does not hold.

FS-MVSNet (Forests 2025, 16, 927) takes the ground as a RANSAC plane with points within 2-5 cm of it. Real plots slope
and undulate, so the plane is only the start: the evidence is the share of the plot whose lowest dense layer lies within
3 cm of the plane. Below 90 % a raster is added, fitted by penalised least squares with asymmetric weights
(P. Eilers' asymmetric smoothing in two dimensions): what stands above the surface hardly pulls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import grey_erosion

from fsinfer.errors import CloudError
from fsinfer.trees.ground.raster import height_on, smooth_surface
from fsinfer.trees.points.cells import MAX_TABLE
from fsinfer.trees.points.sums import MAD_TO_SIGMA, median
from fsinfer.trees.points.surface import OUTSIDE_SIGMAS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


#: Numerics: cells of the raster, at most, so that its equations stay solvable in seconds; a hectare keeps its 0.4 m.
MOST_CELLS = 60_000.0
#: Numerics: planes through random triples; one with 30 % inliers is found with probability > 1 - 1e-4.
TRIALS = 400
#: Numerics: rounds of least squares on the points near the best of them.
PLANE_ROUNDS = 5


@dataclass(frozen=True, kw_only=True)
class GroundSettings:
    """Constants of :func:`find_ground`.

    Attributes
    ----------
    tolerance_m: points within it are ground; between the two it follows the noise. Source: Forests 2025, 16, 927.
    cell_m: below the 0.5-1 m of usual terrain rasters, so that root collars and bumps follow. Source: not recorded.
    layer_m: height bins in which the lowest dense layer of a cell is looked for. Source: not recorded.
    search_m: the lowest dense layer lies at most this far above the lowest point of its cell. Source: not recorded.
    dense_share: a layer is dense with this share of what the fullest of them holds. Source: not recorded.
    filter_radius_m: within this distance of a stem foot the ground cannot hide in a crown. Source: not recorded.
    filter_slack_m: stones, roots and noise may stand above what the slope allows. Source: not recorded.
    max_slope_deg: of levelled clouds; steeper is a wall or a cloud that is not z up. Source: not recorded.
    agree_m: cells so near to the surface agree with it. Source: not recorded.
    band_m: points so near to the surface make its second, finer form; wider where noise is. Source: not recorded.
    plane_share: the plane alone is believed when this share of the cells lies within ``plane_tolerance_m``. Source: not
        recorded.
    plane_tolerance_m: 3 cm of height cost 0.5 mm of a tapering stem's diameter. Source: geometry.
    smoothness: weight of squared second differences against one cell's height. Source: not recorded.
    min_ground_share: fewer of the lowest cells than this on one surface: no ground was seen. Source: not recorded.
    """

    tolerance_m: tuple[float, float] = (0.02, 0.05)
    cell_m: float = 0.4
    layer_m: float = 0.05
    search_m: float = 1.0
    dense_share: float = 0.15
    filter_radius_m: float = 3.0
    filter_slack_m: float = 0.3
    max_slope_deg: float = 40.0
    agree_m: float = 0.15
    band_m: float = 0.08
    plane_share: float = 0.9
    plane_tolerance_m: float = 0.03
    smoothness: float = 2.0
    min_ground_share: float = 0.3


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Terrain height as a function of x, y (metres).

    ``plane`` (3,) holds a, b, c of z = a x + b y + c. ``raster_m`` (H, W) adds to the plane at the cell centres
    ``origin + cell_m * (column, row)``; it is None where the plane alone holds. ``noise_m`` is the robust standard
    deviation of the ground points about the surface, ``share`` the share of the plot's lowest cells that show ground,
    ``reach`` the share of all its cells that can be ground at all.
    """

    method: str
    plane: Floats
    raster_m: Floats | None
    origin: Floats
    cell_m: float
    noise_m: float
    tolerance_m: float
    share: float
    plane_share: float
    points: int
    reach: float = 1.0

    def height_at(self, xy: Floats) -> Floats:
        """Terrain height (N,) at positions (N, 2); outside the raster its border continues."""
        z = self.plane[0] * xy[:, 0] + self.plane[1] * xy[:, 1] + self.plane[2]
        if self.raster_m is None:
            return np.asarray(z)
        return np.asarray(z + height_on(self.raster_m, self.origin, self.cell_m, xy[:, 0], xy[:, 1]))

    @property
    def slope_deg(self) -> float:
        """Slope of the plane."""
        return float(np.degrees(np.arctan(np.hypot(self.plane[0], self.plane[1]))))


@dataclass(frozen=True, kw_only=True)
class _LowestCells:
    """What of a plot can be ground: its lowest dense layers by cell.

    ``columns`` are x, y, z (N,) of the points, ``index`` (N,) their cells, ``cell`` (C,) the cells that have a ``low``
    (C,), of which ``reachable`` (C,) can be ground. ``settings`` have the size of the cells that was used.
    """

    settings: GroundSettings
    columns: tuple[Floats, Floats, Floats]
    origin: Floats
    shape: tuple[int, int]
    index: Ints
    cell: Ints
    low: Floats
    reachable: NDArray[np.bool_]


def _lowest_cells(points: Floats, settings: GroundSettings) -> _LowestCells:
    x, y, z = (np.ascontiguousarray(points[:, axis]) for axis in range(3))
    origin = np.array([x.min(), y.min()])
    area = max(float(x.max() - origin[0]), settings.cell_m) * max(float(y.max() - origin[1]), settings.cell_m)
    settings = replace(settings, cell_m=max(settings.cell_m, float(np.sqrt(area / MOST_CELLS))))
    index, column = (_steps(v, low, settings.cell_m) for v, low in ((y, origin[1]), (x, origin[0])))
    shape = (int(index.max()) + 1, int(column.max()) + 1)
    index *= shape[1]
    index += column
    cell, low = _lowest_layers(index, z, settings)
    reachable = _slope_filter(cell, low, shape, settings)
    return _LowestCells(
        settings=settings,
        columns=(x, y, z),
        origin=origin,
        shape=shape,
        index=index,
        cell=cell,
        low=low,
        reachable=reachable,
    )


def _steps(values: Floats, low: float, size: float) -> Ints:
    """In which step of ``size`` above ``low`` each of the values (N,) lies."""
    position = values - low
    position /= size
    return position.astype(np.int64)


def reach_of(points: Floats, *, settings: GroundSettings | None = None) -> float:
    """The ``reach`` of :func:`find_ground` alone, for a fraction of its time; 0 where no cell is dense."""
    reachable = _lowest_cells(points, settings or GroundSettings()).reachable
    return float(reachable.mean()) if len(reachable) else 0.0


def find_ground(points: Floats, *, settings: GroundSettings | None = None, seed: int = 0) -> Ground:
    """Find the terrain below points (N, 3) in metres, z up.

    Raises :class:`~fsinfer.errors.CloudError` when no surface holds together (no ground in the cloud, not z up).
    """
    seen = _lowest_cells(points, settings or GroundSettings())
    settings, origin, shape, index, reachable = seen.settings, seen.origin, seen.shape, seen.index, seen.reachable
    x, y, z = seen.columns
    cell, low = seen.cell[reachable], seen.low[reachable]
    center = origin + settings.cell_m * (np.column_stack([cell % shape[1], cell // shape[1]]) + 0.5)
    plane = _ransac_plane(center, low, settings, np.random.default_rng(seed))
    relative = low - (center @ plane[:2] + plane[2])
    noise = _core_noise(relative, settings)
    tolerance = float(np.clip(2.0 * noise, *settings.tolerance_m))
    plane_share = float(np.mean(np.abs(relative) <= settings.plane_tolerance_m))
    surface = np.zeros(shape)
    if plane_share < settings.plane_share:
        surface = smooth_surface(cell, relative, shape, settings.smoothness)
    share = float(np.mean(np.abs(relative - surface.ravel()[cell]) <= settings.agree_m))
    if share < settings.min_ground_share or len(cell) < 3:
        msg = (
            f"no ground in the cloud: only {100 * share:.0f} % of the plot agrees on one surface; "
            "the cloud must be in metres with z up and show the ground around the stems"
        )
        raise CloudError(msg)
    # Second pass: the lowest layer sits below the middle of a noisy ground; medians of the ground points do not.
    above = z - (plane[0] * x + plane[1] * y + plane[2])
    over = above - surface.ravel().take(index)
    band = np.flatnonzero(np.abs(over) <= max(OUTSIDE_SIGMAS * noise, settings.band_m))
    used, heights = _cell_medians(index.take(band), above.take(band))
    use_raster = plane_share < settings.plane_share
    if use_raster:
        surface = smooth_surface(used, heights, shape, settings.smoothness, symmetric=True)
    elif len(used) >= 3:
        where = origin + settings.cell_m * (np.column_stack([used % shape[1], used // shape[1]]) + 0.5)
        good = np.abs(heights - np.median(heights)) <= tolerance
        plane = plane + _least_squares_plane(where[good], heights[good])
    result = Ground(
        method="plane + raster" if use_raster else "plane",
        plane=plane,
        raster_m=surface if use_raster else None,
        origin=origin + 0.5 * settings.cell_m,
        cell_m=settings.cell_m,
        noise_m=noise,
        tolerance_m=tolerance,
        share=share,
        plane_share=plane_share,
        points=0,
        reach=float(reachable.mean()),
    )
    final = z.take(band) - result.height_at(np.stack([x.take(band), y.take(band)]).T)
    noise = MAD_TO_SIGMA * median(np.abs(final)) if len(final) else noise
    tolerance = float(np.clip(2.0 * noise, *settings.tolerance_m))
    count = int(np.count_nonzero(np.abs(final) <= tolerance))
    return Ground(**{**vars(result), "noise_m": noise, "tolerance_m": tolerance, "points": count})


def _slope_filter(cell: Ints, low: Floats, shape: tuple[int, int], settings: GroundSettings) -> NDArray[np.bool_]:
    """Which cells can be ground: none nearby lies lower than the steepest slope allows (Vosselman's slope filter)."""
    surface = np.full(shape, np.inf)
    surface.ravel()[cell] = low
    reach = int(np.ceil(settings.filter_radius_m / settings.cell_m))
    steps = np.arange(-reach, reach + 1) * settings.cell_m
    cone = np.tan(np.radians(settings.max_slope_deg)) * np.hypot(*np.meshgrid(steps, steps)) + settings.filter_slack_m
    lowest = grey_erosion(surface, structure=-cone, mode="constant", cval=np.inf)
    return np.asarray(low <= lowest.ravel()[cell])


def _count(key: Ints) -> tuple[Ints, Ints]:
    """The values (K,) among ``key`` (N,), ascending, and how often each occurs."""
    if int(key.max()) > min(MAX_TABLE, 20 * len(key)):
        values, count = np.unique(key, return_counts=True)
        return values, count
    table = np.bincount(key)
    values = np.flatnonzero(table)
    return values, table[values]


def _lowest_layers(index: Ints, z: Floats, settings: GroundSettings) -> tuple[Ints, Floats]:
    """Cells (C,) and height of their lowest dense layer (C,): strays below the ground are not dense."""
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
    return cell[found], center


def _ransac_plane(xy: Floats, z: Floats, settings: GroundSettings, rng: np.random.Generator) -> Floats:
    if len(z) < 3:
        msg = f"no ground in the cloud: it covers less than three cells of {settings.cell_m:g} m; is it in metres?"
        raise CloudError(msg)
    middle = xy.mean(axis=0)
    index = rng.integers(0, len(z), size=(TRIALS, 3))
    matrix = np.concatenate([xy[index] - middle, np.ones((TRIALS, 3, 1))], axis=2)
    usable = np.abs(np.linalg.det(matrix)) > 1e-6
    best, best_score = np.array([0.0, 0.0, float(np.percentile(z, 10))]), -1.0
    if usable.any():
        planes = np.linalg.solve(matrix[usable], z[index][usable][..., None])[..., 0]
        planes = planes[np.hypot(planes[:, 0], planes[:, 1]) <= np.tan(np.radians(settings.max_slope_deg))]
        limit = 2.0 * settings.tolerance_m[1]
        for plane in planes:
            residual = z - ((xy - middle) @ plane[:2] + plane[2])
            # Truncated squares reward closeness; what lies well below the plane speaks against it being the ground.
            score = np.maximum(1.0 - (residual / limit) ** 2, 0.0).sum() - 0.5 * np.count_nonzero(residual < -2 * limit)
            if score > best_score:
                best, best_score = plane, float(score)
    for _ in range(PLANE_ROUNDS):
        residual = z - ((xy - middle) @ best[:2] + best[2])
        near = np.abs(residual) <= 2.0 * settings.tolerance_m[1]
        if near.sum() < 6:
            break
        best = best + _least_squares_plane(xy[near] - middle, residual[near])
    return np.array([best[0], best[1], best[2] - best[:2] @ middle])


def _least_squares_plane(xy: Floats, z: Floats) -> Floats:
    if len(z) < 3:
        return np.zeros(3)
    middle = xy.mean(axis=0)
    design = np.column_stack([xy - middle, np.ones(len(z))])
    a, b, c = np.linalg.lstsq(design, z, rcond=None)[0]
    return np.array([a, b, c - a * middle[0] - b * middle[1]])


def _core_noise(relative: Floats, settings: GroundSettings) -> float:
    near = relative[np.abs(relative) <= settings.agree_m]
    if len(near) < 3:
        return settings.tolerance_m[1]
    return float(MAD_TO_SIGMA * np.median(np.abs(near - np.median(near))))


def _cell_medians(index: Ints, z: Floats) -> tuple[Ints, Floats]:
    if len(index) == 0:
        return index, z
    # By cell, then by height, in one sort: a cell's heights stay within the span that separates it from the next.
    bottom, span = float(z.min()) - 0.5, float(np.ptp(z)) + 1.0
    both = np.sort(index * span + (z - bottom))
    index = (both / span).astype(np.int64)
    z = both - index * span + bottom
    starts = np.flatnonzero(np.r_[True, index[1:] != index[:-1]])
    count = np.diff(np.r_[starts, len(index)])
    enough = count >= 3
    return index[starts][enough], z[(starts + count // 2)][enough]

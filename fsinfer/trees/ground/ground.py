"""The ground under a plot: a RANSAC plane, and a smooth terrain raster on top where the plane does not hold.

FS-MVSNet (Forests 2025, 16, 927) takes the ground as a RANSAC plane with points within 2-5 cm of it. Real plots slope
and undulate, so the plane is only the start: it is kept where the lowest dense layer of 90 % of the plot lies within
3 cm of it and nothing but single cells departs from it. Else a raster is added. It starts from the lowest layers opened
by a disc (as in Zhang et al. 2003 and SMRF, Pingel et al. 2013), which are below undergrowth and follow slopes, valleys
and banks; from there it climbs by penalised least squares with asymmetric weights (P. Eilers' asymmetric smoothing in
two dimensions): what stands above the surface hardly pulls. A finer surface through the points near it comes last, in
rounds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.trees.ground.lowest import cell_medians, lowest_cells, opened, support
from fsinfer.trees.ground.raster import height_on, smooth_surface
from fsinfer.trees.ground.settings import GroundSettings
from fsinfer.trees.points.sums import MAD_TO_SIGMA, median
from fsinfer.trees.points.surface import OUTSIDE_SIGMAS

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


#: Planes through random triples; one with 30 % inliers is found with probability > 1 - 1e-4. Source: numerics.
TRIALS = 400
#: Rounds of least squares on the points near the best of them. Source: numerics.
PLANE_ROUNDS = 5
#: A cell far below a plane speaks against it as much as this share of one on it speaks for it. Source: not recorded.
AGAINST = 0.5
#: Without any plane the ground lies at this percentile of the lowest cells. Source: not recorded.
LOW_PERCENTILE = 10
#: Metres over which the slope is taken. Source: geometry; a stem and its foot.
GRADIENT_M = 1.0


@dataclass(frozen=True, kw_only=True)
class Ground:
    """Terrain height as a function of x, y (metres).

    ``plane`` (3,) holds a, b, c of z = a x + b y + c. ``raster_m`` (H, W) adds to the plane at the cell centres
    ``origin + cell_m * (column, row)``; it is None where the plane alone holds. ``noise_m`` is the robust standard
    deviation of the ground points about the surface, ``share`` the share of the plot's lowest cells that show ground,
    ``reach`` the share of all its cells that can be ground at all. ``cells`` (C, 3) are the middles of those cells and
    how far above the surface the lowest dense layer lies there; None where they are not known.
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
    cells: Floats | None = None

    def height_at(self, xy: Floats) -> Floats:
        """Terrain height (N,) at positions (N, 2); outside the raster its border continues."""
        z = self.plane[0] * xy[:, 0] + self.plane[1] * xy[:, 1] + self.plane[2]
        if self.raster_m is None:
            return np.asarray(z)
        return np.asarray(z + height_on(self.raster_m, self.origin, self.cell_m, xy[:, 0], xy[:, 1]))

    def gradient_at(self, xy: Floats) -> Floats:
        """Slope (N, 2) of the terrain at positions (N, 2), dz/dx and dz/dy over a metre either way."""
        steps = GRADIENT_M * np.eye(2)
        return np.column_stack(
            [(self.height_at(xy + step) - self.height_at(xy - step)) / (2.0 * GRADIENT_M) for step in steps]
        )

    def moved(self, by: Floats) -> Ground:
        """The same terrain, all of whose places are moved by ``by`` (2,), metres; heights stay as they are."""
        return replace(
            self,
            origin=self.origin + by,
            plane=self.plane - np.array([0.0, 0.0, float(self.plane[:2] @ by)]),
            cells=None if self.cells is None else self.cells + np.array([*by, 0.0]),
        )

    @property
    def slope_deg(self) -> float:
        """Slope of the plane."""
        return float(np.degrees(np.arctan(np.hypot(self.plane[0], self.plane[1]))))


def reach_of(points: Floats, *, settings: GroundSettings | None = None) -> float:
    """The ``reach`` of :func:`find_ground` alone, for a fraction of its time; 0 where no cell is dense."""
    reachable = lowest_cells(points, settings or GroundSettings()).reachable
    return float(reachable.mean()) if len(reachable) else 0.0


def find_ground(points: Floats, *, settings: GroundSettings | None = None, seed: int = 0) -> Ground:
    """Find the terrain below points (N, 3) in metres, z up.

    Raises :class:`~fsinfer.errors.CloudError` when no surface holds together (no ground in the cloud, not z up).
    """
    seen = lowest_cells(points, settings or GroundSettings())
    settings, origin, shape, index, reachable = seen.settings, seen.origin, seen.shape, seen.index, seen.reachable
    x, y, z = seen.columns
    cell, low = seen.cell[reachable], seen.low[reachable]
    known, known_finely = (support(seen.count[reachable], share) for share in settings.well_seen)
    known_by_cell = np.zeros(shape[0] * shape[1])
    known_by_cell[cell] = known_finely
    center = origin + settings.cell_m * (np.column_stack([cell % shape[1], cell // shape[1]]) + 0.5)
    plane = _ransac_plane(center, low, settings, np.random.default_rng(seed))
    relative = low - (center @ plane[:2] + plane[2])
    noise = _core_noise(relative, settings)
    tolerance = float(np.clip(2.0 * noise, *settings.tolerance_m))
    plane_share = float(np.mean(np.abs(relative) <= settings.plane_tolerance_m))
    low_enough = opened(cell, relative, shape, settings)
    firm = seen.at_bank[reachable]
    surface = smooth_surface(cell, relative, shape, settings.smoothness[0], start=low_enough, support=known, firm=firm)
    # A mound or a terrace that few cells show is relief all the same, and a stem may stand on it.
    on_plane = np.abs(surface.ravel()[cell]).max() <= settings.plane_tolerance_m
    use_raster = not (plane_share >= settings.plane_share and on_plane)
    if not use_raster:
        surface = np.zeros(shape)
    share = float(np.mean(np.abs(relative - surface.ravel()[cell]) <= settings.agree_m))
    if use_raster and settings.min_ground_share <= share < settings.sure_ground_share:
        share = min(share, _share_foretold(cell, relative, shape, settings))
    if share < settings.min_ground_share:
        msg = (
            f"no ground in the cloud: only {100 * share:.0f} % of the plot agrees on one surface; "
            "the cloud must be in metres with z up, show the ground around the stems, and have few stray points below "
            "it (take out noise first)"
        )
        raise CloudError(msg)
    noise = _core_noise(relative - surface.ravel()[cell], settings)
    # Second pass: the lowest layer sits below the middle of a noisy ground; medians of the ground points do not.
    above = z - (plane[0] * x + plane[1] * y + plane[2])
    reach = max(OUTSIDE_SIGMAS * noise, settings.band_m)
    band = np.flatnonzero(np.abs(above - surface.ravel().take(index)) <= reach)
    used, heights = cell_medians(index.take(band), above.take(band))
    if use_raster:
        stiff = (surface, settings.hold)
        for _ in range(settings.rounds):
            known = known_by_cell[used]
            surface = smooth_surface(
                used, heights, shape, settings.smoothness[1], symmetric=True, support=known, held_to=stiff
            )
            band = np.flatnonzero(np.abs(above - surface.ravel().take(index)) <= reach)
            used, heights = cell_medians(index.take(band), above.take(band))
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
    off = low - result.height_at(center)
    final = z.take(band) - result.height_at(np.stack([x.take(band), y.take(band)]).T)
    noise = MAD_TO_SIGMA * median(np.abs(final)) if len(final) else noise
    tolerance = float(np.clip(2.0 * noise, *settings.tolerance_m))
    near = int(np.count_nonzero(np.abs(final) <= tolerance))
    cells = np.column_stack([center, off])
    return replace(result, noise_m=noise, tolerance_m=tolerance, points=near, cells=cells)


def _share_foretold(cell: Ints, low: Floats, shape: tuple[int, int], settings: GroundSettings) -> float:
    """The share of every other cell (C,) that a surface through the rest foretells: anything can be followed."""
    told = (cell // shape[1] + cell % shape[1]) % 2 == 0
    if told.all() or not told.any():
        return 0.0
    start = opened(cell[told], low[told], shape, settings)
    surface = smooth_surface(cell[told], low[told], shape, settings.smoothness[0], start=start)
    return float(np.mean(np.abs(low[~told] - surface.ravel()[cell[~told]]) <= settings.agree_m))


def _ransac_plane(xy: Floats, z: Floats, settings: GroundSettings, rng: np.random.Generator) -> Floats:
    if len(z) < 3:
        msg = f"no ground in the cloud: it covers less than three cells of {settings.cell_m:g} m; is it in metres?"
        raise CloudError(msg)
    middle = xy.mean(axis=0)
    index = rng.integers(0, len(z), size=(TRIALS, 3))
    matrix = np.concatenate([xy[index] - middle, np.ones((TRIALS, 3, 1))], axis=2)
    usable = np.abs(np.linalg.det(matrix)) > 1e-6
    best, best_score = np.array([0.0, 0.0, float(np.percentile(z, LOW_PERCENTILE))]), -1.0
    if usable.any():
        planes = np.linalg.solve(matrix[usable], z[index][usable][..., None])[..., 0]
        planes = planes[np.hypot(planes[:, 0], planes[:, 1]) <= np.tan(np.radians(settings.max_slope_deg))]
        limit = 2.0 * settings.tolerance_m[1]
        for plane in planes:
            residual = z - ((xy - middle) @ plane[:2] + plane[2])
            # Truncated squares reward closeness; what lies well below the plane speaks against it being the ground.
            score = np.maximum(1.0 - (residual / limit) ** 2, 0.0).sum() - AGAINST * np.count_nonzero(
                residual < -2 * limit
            )
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

"""Large clouds brought down to what the dendrometry needs while they are read, in memory that does not grow with them.

Three readings: pieces of the file tell what it spans; then points are counted in cells of 0.2 m; then each point is
kept with the probability that leaves a bounded number in its cell. Cells are much wider than the noise of bark, and
points are drawn at random in them: the noise keeps its form, which one point a voxel would not (it flattens the
density across the bark, and what stands outside of it would count as much as the bark). Cells at the height of breast
height get most of the budget.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from fsinfer.io.chunks import ChunkedCloud
from fsinfer.io.cloud import nothing_usable
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.progress import Progress, silent
from fsinfer.trees.points.cells import BOX_MARGIN_M, BOX_PERCENTILES

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


#: Cells, at most, 160 MB of counts; larger plots get wider ones. And halvings by which a limit is found.
#: Source: numerics.
MOST_CELLS, HALVINGS = 40_000_000, 60
#: The pieces of a file that are looked at first may miss a border this wide, metres. Source: numerics.
UNSEEN_MARGIN_M = 10.0
#: The ground is looked for in columns of so many cells, at this quantile of a column's points (lower ones are strays),
#: and at most so many cells above the lowest of its neighbours: 35 degrees along the diagonal. Source: not recorded.
COLUMN_CELLS, GROUND_QUANTILE, MOST_STEP_CELLS = 5, 0.005, 5


@dataclass(frozen=True, kw_only=True)
class ThinningSettings:
    """Constants of :func:`thin_while_reading`.

    Attributes
    ----------
    max_points: clouds up to this are measured whole; with it the measurement stays below 3 GB, without the processes
        that work for it, of 200 MB each. Source: measured
        (tests/bench/cloud_size.py).
    cell_m: over ten times the noise of bark in photogrammetric clouds. Source: chosen on simulated stems.
    fine_heights_m: stems are looked for between 0.5 and 2.5 m. Source: ``StemSettings.heights_m``.
    fine_share: of the points kept. Source: not recorded.
    seed: of the draws. Source: numerics.
    """

    max_points: int = 8_000_000
    cell_m: float = 0.2
    fine_heights_m: tuple[float, float] = (0.3, 2.7)
    fine_share: float = 0.75
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class ThinnedCloud:
    """Points (N, 3) float64 kept of ``total`` that can be used, and what the user should know about that."""

    xyz: Floats
    total: int
    warnings: tuple[Notice, ...]


@dataclass(frozen=True, kw_only=True)
class _Grid:
    origin: Floats
    cell_m: float
    shape: tuple[int, int, int]

    def index(self, xyz: Floats) -> tuple[Ints, NDArray[np.bool_]]:
        """Flat cell index of the points inside the grid in plan, and which those are; heights are clipped."""
        cell = np.floor((xyz - self.origin) / self.cell_m)
        inside = (cell[:, 0] >= 0) & (cell[:, 1] >= 0) & (cell[:, 0] < self.shape[0]) & (cell[:, 1] < self.shape[1])
        if not inside.all():
            cell = cell[inside]
        rows = cell.astype(np.int64)
        np.clip(rows[:, 2], 0, self.shape[2] - 1, out=rows[:, 2])
        return (rows[:, 0] * self.shape[1] + rows[:, 1]) * self.shape[2] + rows[:, 2], inside


def thin_while_reading(
    cloud: ChunkedCloud, *, settings: ThinningSettings | None = None, progress: Progress = silent
) -> ThinnedCloud:
    """Keep at most about ``settings.max_points`` points of ``cloud``, most of them near breast height.

    Raises
    ------
    CloudError
        The file is damaged, or holds no point that can be used.
    """
    s = settings or ThinningSettings()
    grid = _grid(cloud.sample(), cloud, s)
    counts = np.zeros(int(np.prod(grid.shape)), dtype=np.uint32)
    finite = inside = 0
    flagged: list[int] = []
    for xyz in cloud.chunks(flagged.append):
        index, _ = grid.index(xyz)
        np.add.at(counts, index, np.uint32(1))
        finite, inside = finite + len(xyz), inside + len(index)
        progress(finite // 2, cloud.points, "reading the cloud")
    used = cloud.points - sum(flagged)
    if not finite:
        raise nothing_usable(cloud.path, sum(flagged))
    fine = _fine_cells(counts.reshape(grid.shape), grid.cell_m, s).ravel()
    budgets = _split(int(counts[fine].sum()), int(counts[~fine].sum()), s)
    crowd = _crowd(counts.reshape(grid.shape)).ravel()
    most = tuple(
        _most(counts[chosen], crowd[chosen], budget)
        for chosen, budget in zip((fine & (counts > 0), ~fine & (counts > 0)), budgets, strict=True)
    )
    chance = np.where(fine, np.float32(most[0]), np.float32(most[1])) / np.maximum(crowd, np.float32(1.0))
    del counts, fine, crowd
    rng = np.random.default_rng(s.seed)
    kept = []
    read = 0
    for xyz in cloud.chunks():
        index, within = grid.index(xyz)
        drawn = rng.random(len(index), dtype=np.float32) < chance[index]
        kept.append(xyz[within][drawn])
        read += len(xyz)
        progress((finite + read) // 2, cloud.points, "reading the cloud")
    warnings = [_told(used, sum(map(len, kept)), most, grid.cell_m, s)]
    if any(flagged):
        warnings.append(notice(StemCode.flagged, points=sum(flagged)))
    if finite < used:
        warnings.append(notice(StemCode.not_finite, points=used - finite))
    if inside < finite:
        warnings.append(notice(StemCode.far_outside, points=finite - inside))
    return ThinnedCloud(xyz=np.concatenate(kept), total=used, warnings=tuple(warnings))


def _grid(sample: Floats, cloud: ChunkedCloud, s: ThinningSettings) -> _Grid:
    if not len(sample):
        raise nothing_usable(cloud.path)
    low, high = np.percentile(sample, BOX_PERCENTILES, axis=0)
    # As far as the measurement itself looks: a point a kilometre away must not widen the cells.
    margin = 0.5 * float((high - low)[:2].max()) + BOX_MARGIN_M
    # Nor must cells be spent where nothing is.
    low = np.maximum(low - margin, sample.min(axis=0) - UNSEEN_MARGIN_M)
    high = np.minimum(high + margin, sample.max(axis=0) + UNSEEN_MARGIN_M)
    size = np.maximum(high - low, s.cell_m)
    cell = max(s.cell_m, float(np.cbrt(np.prod(size) / MOST_CELLS)))
    shape = tuple(int(n) for n in np.ceil(size / cell).astype(np.int64))
    return _Grid(origin=low, cell_m=cell, shape=(shape[0], shape[1], shape[2]))


def _fine_cells(counts: NDArray[np.uint32], cell_m: float, s: ThinningSettings) -> NDArray[np.bool_]:
    """Cells (X, Y, Z) at stem height over a rough ground: the low quantile of each column and its neighbours."""
    step = max(round(COLUMN_CELLS * s.cell_m / cell_m), 1)
    nx, ny, nz = counts.shape
    starts = (np.arange(0, nx, step), np.arange(0, ny, step))
    columns = np.add.reduceat(np.add.reduceat(counts, starts[0], axis=0, dtype=np.int64), starts[1], axis=1)
    cumulated = np.cumsum(columns, axis=2)
    total = cumulated[..., -1]
    level = np.argmax(cumulated >= np.maximum(GROUND_QUANTILE * total, 1.0)[..., None], axis=2)
    level = np.where(total > 0, level, nz)
    lowest = minimum_filter(level, size=3, mode="nearest")
    # A column that stands far above its neighbours shows a crown or a shrub and no ground.
    level = np.where(level - lowest <= MOST_STEP_CELLS, level, lowest)
    ground = np.repeat(np.repeat(level, step, axis=0)[:nx], step, axis=1)[:, :ny].astype(np.int32)
    low, high = (round(height / cell_m) for height in s.fine_heights_m)
    fine = np.empty(counts.shape, dtype=bool)
    for z in range(nz):
        fine[..., z] = (z >= ground + low) & (z <= ground + high + 1)
    return fine


def _split(fine: int, coarse: int, s: ThinningSettings) -> tuple[int, int]:
    """Budgets of the two kinds of cells; what one does not need goes to the other."""
    wanted = round(s.fine_share * s.max_points)
    fine_budget = min(fine, max(wanted, s.max_points - coarse))
    return fine_budget, min(coarse, s.max_points - fine_budget)


def _crowd(counts: NDArray[np.uint32]) -> NDArray[np.float32]:
    """What each cell (X, Y, Z) is taken to hold: the fullest of its neighbours in plan, evened out.

    Bark and the haze outside of it may lie in different cells; if each were thinned by its own count, the haze would
    gain on the bark, and stems would come out too thick.
    """
    fullest = maximum_filter(counts, size=(3, 3, 1), mode="nearest").astype(np.float32)
    return np.asarray(uniform_filter(fullest, size=(3, 3, 1), mode="nearest"), dtype=np.float32)


def _most(counts: NDArray[np.uint32], crowd: NDArray[np.float32], budget: int) -> float:
    """Points to leave in a full cell so that cells of ``counts`` (C,), each thinned by its crowd, keep ``budget``."""
    if int(counts.sum()) <= budget or not len(counts):
        return float(crowd.max(initial=0.0))
    crowds, group = np.unique(np.rint(crowd), return_inverse=True)
    points = np.bincount(group, weights=counts)
    low, high = 0.0, float(crowds[-1])
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        kept = float((points * np.minimum(middle / np.maximum(crowds, 1.0), 1.0)).sum())
        low, high = (middle, high) if kept <= budget else (low, middle)
    return low


def _told(total: int, kept: int, most: tuple[float, ...], cell_m: float, s: ThinningSettings) -> Notice:
    low, high = s.fine_heights_m
    return notice(
        StemCode.thinned,
        total=total,
        kept=kept,
        fine=most[0],
        elsewhere=most[1],
        cell_cm=100.0 * cell_m,
        low_m=low,
        high_m=high,
    )

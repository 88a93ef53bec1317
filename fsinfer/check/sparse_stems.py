"""Stems in the sparse points of structure from motion: upright strings of points that lie on a circle.

Bark is full of features and litter and leaves give few that three photos agree on, so that a plot's stems stand out
of the sparse points long before there is a dense cloud: on a rendered plot of 25 trees from 8 cm up, 24 have a hundred
points or more between 0.4 and 2.6 m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from fsinfer.check.settings import SparseStemSettings
from fsinfer.conventions.breast_height import BREAST_HEIGHT_M
from fsinfer.trees.diameter.circle import residuals_to

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Random circles through three points. Source: numerics; with half of the points on the circle, 150 all miss with 2e-9.
_TRIALS = 150
#: Steps of the fit at most. Source: numerics.
_MOST_STEPS = 50
#: Members are looked for from this share of the least height to so many times the greatest. Source: judgement.
_MEMBERS_FROM, _MEMBERS_TO = 0.5, 1.15
#: Points of a slice, and slices, that tell how a stem leans. Source: judgement.
_LEAN_POINTS, _LEAN_SLICES = 3, 4
#: Cells in a reach, so that the points of one are within reach of each other. Source: numerics.
_CELLS_IN_REACH = 1.5
#: The steps to half of the cells that may be in reach of one, nearest first. Source: numerics.
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (1, 2), (1, -2), (2, 1), (2, -1), (2, 2), (2, -2))
#: What is looked at closely, and how far pairs of cells are put apart, in reaches. Source: numerics.
_BEYOND, _PAIRS_APART = 1.0 + 1e-9, 8.0
#: What stands for none. Source: numerics.
_LEAST = 1e-9


@dataclass(frozen=True, kw_only=True)
class SparseStem:
    """A stem.

    Attributes
    ----------
    center: (2,) float64, plan position at 1.3 m.
    radius: of the circle; from one side only it is a rough guess.
    lean: (2,) metres sideways for each metre up.
    members: (M,) int64, indices of the points on it.
    """

    center: Floats
    radius: float
    lean: Floats
    members: Ints


def find_sparse_stems(
    points: Floats,
    heights: Floats,
    trusted: NDArray[np.bool_],
    *,
    settings: SparseStemSettings | None = None,
    seed: int = 0,
) -> list[SparseStem]:
    """Find stems.

    Parameters
    ----------
    points: (N, 3) metres, z up. heights: (N,) above the ground.
    trusted: (N,) bool, what may make a stem; its other points count as members later. Those out of reach are not.

    Returns
    -------
    Stems, those with the most points first.
    """
    settings = settings or SparseStemSettings()
    tall = trusted & (heights > settings.min_height_m) & (heights < settings.max_height_m)
    chosen = np.flatnonzero(tall)
    if len(chosen) < settings.min_points:
        return []
    clusters = _clusters(points[chosen, :2], heights[chosen], settings)
    rng = np.random.default_rng(seed)
    fitted = [_fit(points, heights, chosen[own], settings, rng) for own in clusters]
    stems = [(stem, chosen[own]) for stem, own in zip(fitted, clusters, strict=True) if stem is not None]
    # A thick stem seen from the front and the back, and not from the side, comes in two parts.
    merged: list[tuple[SparseStem, Ints]] = []
    for stem, own in sorted(stems, key=lambda entry: -len(entry[1])):
        for rank, (other, others) in enumerate(merged):
            apart = float(np.linalg.norm(stem.center - other.center))
            if apart < max(stem.radius, other.radius) + settings.tolerance_m:
                both = np.concatenate([others, own])
                again = _fit(points, heights, both, settings, rng)
                merged[rank] = (again or other, both)
                break
        else:
            merged.append((stem, own))
    found = [stem for stem, _ in merged if len(stem.members) >= settings.min_points]
    return sorted(found, key=lambda stem: -len(stem.members))


def _clusters(plan: Floats, heights: Floats, settings: SparseStemSettings) -> Sequence[Ints]:
    """Groups of points whose neighbourhoods are upright, each of indices into ``plan``."""
    slices = ((heights - settings.min_height_m) / settings.slice_m).astype(np.int64)
    filled = np.zeros(len(plan), dtype=np.int64)
    for number in np.unique(slices):
        filled += _reaches(plan, plan[slices == number], settings.reach_m)
    upright = np.flatnonzero(filled >= settings.min_slices)
    if len(upright) == 0:
        return []
    labels = _joined(plan[upright], settings.reach_m)
    order = np.argsort(labels, kind="stable")
    groups = np.split(upright[order], np.flatnonzero(np.diff(labels[order])) + 1)
    return sorted((group for group in groups if len(group) >= settings.min_points), key=lambda group: int(group[0]))


def _reaches(places: Floats, others: Floats, reach: float) -> NDArray[np.bool_]:
    """Whether one of ``others`` (M, D), M > 0, is no farther than ``reach`` from each of ``places`` (N, D)."""
    tree = cKDTree(others)
    # The bound itself is left out.
    _, nearest = tree.query(places, distance_upper_bound=reach * _BEYOND)
    near = np.zeros(len(places), dtype=bool)
    found = np.flatnonzero(nearest < len(others))
    near[found] = ((places[found] - others[nearest[found]]) ** 2).sum(axis=1) <= reach * reach
    return near


def _joined(plan: Floats, reach: float) -> Ints:
    """Numbers (N,) of the groups that points (N, 2) make with steps of up to ``reach``.

    The pairs of points within reach grow with the square of their density; cells whose points all are, do not.
    """
    cell = np.floor(plan * (_CELLS_IN_REACH / reach)).astype(np.int64)
    cell -= cell.min(axis=0)
    width = int(cell[:, 1].max()) + 1
    keys, cell_of = np.unique(cell[:, 0] * width + cell[:, 1], return_inverse=True)
    labels = np.arange(len(keys))
    links = np.zeros((2, 0), dtype=np.int64)
    for dx, dy in _STEPS:
        wanted = keys + dx * width + dy
        there = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        here = np.flatnonzero((keys[there] == wanted) & (labels != labels[there]))
        if len(here) == 0:
            continue
        # No cell begins two pairs or ends two; pairs are put so far apart that nothing reaches from one to another.
        pair = np.full((2, len(keys)), -1)
        pair[0, here] = pair[1, there[here]] = np.arange(len(here))
        start, end = (np.flatnonzero(side[cell_of] >= 0) for side in pair)
        far = _PAIRS_APART * reach
        places, others = (
            np.column_stack([plan[own], far * side[cell_of[own]]]) for own, side in zip((start, end), pair, strict=True)
        )
        met = np.unique(pair[0, cell_of[start[_reaches(places, others, reach)]]])
        links = np.concatenate([links, [here[met], there[here[met]]]], axis=1)
        graph = coo_matrix((np.ones(links.shape[1]), (links[0], links[1])), shape=(len(keys), len(keys)))
        labels = connected_components(graph, directed=False)[1]
    return np.asarray(labels[cell_of], np.int64)


def _fit(
    points: Floats, heights: Floats, own: Ints, settings: SparseStemSettings, rng: np.random.Generator
) -> SparseStem | None:
    """A leaning cylinder through the cluster, by its plan position at 1.3 m; None where too few points lie on one."""
    plan, up = points[own, :2], heights[own] - BREAST_HEIGHT_M
    best, best_score = None, 0.0
    # Bark that is seen on one side below and on another above looks like lean: upright is tried as well.
    for lean in (np.zeros(2), _lean(plan, heights[own], settings)):
        flat = plan - up[:, None] * lean
        for _ in range(_TRIALS):
            circle = _through(flat[rng.choice(len(flat), 3, replace=False)])
            if circle is None or not settings.min_radius_m < circle[2] < settings.max_radius_m:
                continue
            off = np.abs(residuals_to(flat, circle))
            score = float(np.clip(1 - (off / settings.tolerance_m) ** 2, 0, None).sum())
            if score > best_score:
                best, best_score = np.concatenate([circle, lean]), score
    if best is None:
        return None
    refined = least_squares(
        lambda v: np.linalg.norm(plan - v[:2] - up[:, None] * v[3:], axis=1) - v[2],
        best,
        loss="soft_l1",
        f_scale=settings.tolerance_m / 2,
        max_nfev=_MOST_STEPS,
    ).x
    if settings.min_radius_m < refined[2] < settings.max_radius_m and np.linalg.norm(refined[3:]) < settings.max_lean:
        best = refined
    off = np.abs(np.linalg.norm(plan - best[:2] - up[:, None] * best[3:], axis=1) - best[2])
    if (off < settings.tolerance_m).mean() < settings.min_inlier_share:
        return None
    # Stems are no exact cylinders: what belongs to one is judged by twice the tolerance.
    low, high = _MEMBERS_FROM * settings.min_height_m, _MEMBERS_TO * settings.max_height_m
    band = np.flatnonzero((heights > low) & (heights < high))
    axis = best[:2] + (heights[band, None] - BREAST_HEIGHT_M) * best[3:]
    near = np.abs(np.linalg.norm(points[band, :2] - axis, axis=1) - best[2]) < 2 * settings.tolerance_m
    return SparseStem(center=best[:2], radius=float(best[2]), lean=best[3:], members=band[near])


def _lean(plan: Floats, heights: Floats, settings: SparseStemSettings) -> Floats:
    """Metres sideways for each metre up (2,), from the medians of the slices; at most ``max_lean``."""
    slices = ((heights - settings.min_height_m) / settings.slice_m).astype(np.int64)
    numbers, counts = np.unique(slices, return_counts=True)
    members = [slices == number for number in numbers[counts >= _LEAN_POINTS]]
    rows = np.array([(heights[own].mean(), *np.median(plan[own], axis=0)) for own in members])
    if len(rows) < _LEAN_SLICES:
        return np.zeros(2)
    design = np.column_stack([rows[:, 0], np.ones(len(rows))])
    slope = np.linalg.lstsq(design, rows[:, 1:], rcond=None)[0][0]
    return np.asarray(slope * min(1.0, settings.max_lean / max(float(np.linalg.norm(slope)), _LEAST)))


def _through(three: Floats) -> Floats | None:
    """Circle (x, y, radius) through three points (3, 2), None for points on a line."""
    a, b = three[1] - three[0], three[2] - three[0]
    cross = 2 * (a[0] * b[1] - a[1] * b[0])
    if abs(cross) < _LEAST:
        return None
    aa, bb = a @ a, b @ b
    offset = np.array([b[1] * aa - a[1] * bb, a[0] * bb - b[0] * aa]) / cross
    return np.array([*(three[0] + offset), np.linalg.norm(offset)])

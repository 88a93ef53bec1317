"""Stems of sparse points, and ferns between them; which points belong together, in bounded memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from fsinfer.check import sparse_stems
from fsinfer.check.settings import SparseStemSettings
from fsinfer.check.sparse_stems import find_sparse_stems

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Plan = Callable[[np.random.Generator, int], Floats]


def plain_clusters(plan: Floats, heights: Floats, settings: SparseStemSettings) -> list[Ints]:
    """By the distances of all pairs."""
    near = cdist(plan, plan, "sqeuclidean") <= settings.reach_m**2
    slices = ((heights - settings.min_height_m) / settings.slice_m).astype(np.int64)
    filled = np.array([len(np.unique(slices[row])) for row in near])
    left = np.flatnonzero(filled >= settings.min_slices).tolist()
    groups = []
    while left:
        group, new = set[int](), {left[0]}
        while new:
            group |= new
            new = {n for n in left if n not in group and near[n, list(new)].any()}
        left = [n for n in left if n not in group]
        if len(group) >= settings.min_points:
            groups.append(np.array(sorted(group)))
    return groups


def spread(rng: np.random.Generator, points: int) -> Floats:
    return rng.uniform(-1.0, 1.0, (points, 2)) * rng.uniform(0.2, 3.0)


def on_stems(rng: np.random.Generator, points: int) -> Floats:
    angle = rng.uniform(0.0, 2.0 * np.pi, points)
    circle = rng.uniform(0.05, 0.2) * np.column_stack([np.cos(angle), np.sin(angle)])
    centers = rng.uniform(-2.0, 2.0, (8, 2))[rng.integers(0, 8, points)]
    return np.asarray(centers + circle + rng.normal(0.0, 0.01, (points, 2)))


def on_a_lattice(rng: np.random.Generator, points: int) -> Floats:
    """Many at the same place, and many a step apart that is some part of the reach."""
    return np.asarray(rng.integers(-9, 10, (points, 2)) * 0.125 * rng.choice([0.25, 0.5, 1.0]))


def on_a_diagonal(rng: np.random.Generator, points: int) -> Floats:
    """Steps of a little less than the reach, or of a little more."""
    step = rng.choice([0.122, 0.128]) / np.sqrt(2.0)
    return np.asarray(rng.uniform(0.0, 1.0) + step * np.repeat(rng.permutation(points)[:, None], 2, axis=1))


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("plan_of", [spread, on_stems, on_a_lattice, on_a_diagonal])
def test_the_same_points_belong_together_as_by_all_pairs(
    plan_of: Plan, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(20, 500))
    plan, heights = plan_of(rng, count), rng.uniform(0.45, 2.55, count)
    settings = SparseStemSettings(reach_m=0.125, min_points=3 + 2 * (seed % 2), min_slices=1 + seed % 3)
    asked = (np.column_stack([plan, heights]), heights, rng.random(count) < 0.9)
    told = find_sparse_stems(*asked, settings=settings)
    groups: list[list[Ints]] = []

    def both(plan: Floats, heights: Floats, settings: SparseStemSettings) -> list[Ints]:
        groups.append(list(ours(plan, heights, settings)))
        groups.append(plain_clusters(plan, heights, settings))
        return groups[1]

    ours = sparse_stems._clusters
    monkeypatch.setattr(sparse_stems, "_clusters", both)
    plain = find_sparse_stems(*asked, settings=settings)
    assert [group.tolist() for group in groups[0]] == [group.tolist() for group in groups[1]]
    assert [stem.members.tolist() for stem in told] == [stem.members.tolist() for stem in plain]


def test_memory_does_not_grow_with_the_square_of_the_density() -> None:
    """Of 6,000 points on one stem all were paired with each other, 18 million pairs."""
    rng = np.random.default_rng(0)
    angle, heights = rng.uniform(0.0, 2.0 * np.pi, 6000), rng.uniform(0.45, 2.55, 6000)
    points = np.column_stack([0.06 * np.cos(angle), 0.06 * np.sin(angle), heights])
    tracemalloc.start()
    stems = find_sparse_stems(points, heights, np.ones(len(points), bool))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert [len(stem.members) for stem in stems] == [6000]
    assert stems[0].radius == pytest.approx(0.06, abs=1e-6)
    assert peak < 20e6


STEMS = ((0.0, 0.0, 0.15), (3.0, 0.5, 0.1), (1.0, 3.0, 0.2))


def bark(rng: np.random.Generator, x: float, y: float, radius: float, count: int = 120) -> NDArray[np.float64]:
    angle, height = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.3, 2.8, count)
    ring = radius + rng.normal(0.0, 0.008, count)
    return np.column_stack([x + ring * np.cos(angle), y + ring * np.sin(angle), height])


@pytest.mark.parametrize("order", ["stems first", "ferns first", "mixed"])
def test_ferns_take_no_stem_in_whichever_order_the_points_come(order: str) -> None:
    rng = np.random.default_rng(0)
    # Knee-high over all of the plot, but for the stems' feet.
    ferns = np.column_stack([rng.uniform(-1.0, 5.0, (3000, 2)), rng.uniform(0.2, 0.6, 3000)])
    clear = [np.hypot(ferns[:, 0] - x, ferns[:, 1] - y) > radius + 0.2 for x, y, radius in STEMS]
    points = np.concatenate([*(bark(rng, *stem) for stem in STEMS), ferns[np.all(clear, axis=0)]])
    points = {"stems first": points, "ferns first": points[::-1], "mixed": rng.permutation(points)}[order]
    found = find_sparse_stems(points, points[:, 2], np.ones(len(points), bool))
    assert sorted((round(stem.center[0], 1), round(stem.center[1], 1)) for stem in found) == sorted(
        (x, y) for x, y, _ in STEMS
    )
    for stem in found:
        (radius,) = (r for x, y, r in STEMS if np.hypot(*(stem.center - [x, y])) < 0.1)
        assert stem.radius == pytest.approx(radius, abs=0.02)

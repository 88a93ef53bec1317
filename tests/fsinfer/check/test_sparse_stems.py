"""Stems among the sparse points of a walk, and ferns between them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.check.sparse_stems import find_sparse_stems

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

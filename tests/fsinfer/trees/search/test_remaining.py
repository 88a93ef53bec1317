"""What a stem owns that was found already is not looked at again."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.points.cells import thin
from fsinfer.trees.search.remaining import search_again
from fsinfer.trees.search.stem import Stem, StemSettings
from tests.support.stem_clouds import Floats, wall

CELL_M = 0.02


def leaning(seed: int, x: float, y: float, radius: float, lean: tuple[float, float], spacing_m: float) -> Floats:
    rng = np.random.default_rng(seed)
    points = wall(rng, radius=radius, top_m=3.0, spacing_m=spacing_m)
    points[:, :2] += np.outer(points[:, 2], lean)
    points[:, :2] += [x, y]
    return points + rng.normal(0.0, 0.003, points.shape)


@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)])
def test_the_upper_end_of_a_stem_that_leans_takes_no_candidate_from_another(lean: tuple[float, float]) -> None:
    # A thick one that is known, and a thin one of fewer points: one candidate alone is looked at.
    known = leaning(1, 0.0, 0.0, 0.25, lean, 0.012)
    thin_one = leaning(2, 4.0, 4.0, 0.06, (0.0, 0.0), 0.02)
    points = thin(np.concatenate([known, thin_one]), CELL_M / 2)
    parameters = np.array([1.3 * lean[0], 1.3 * lean[1], *lean, 0.25, -0.005])
    stem = Stem(
        axis=Axis(parameters=parameters, height_m=1.3, sigma_m=0.004),
        bottom_m=0.5, top_m=2.5, length_m=2.0, arc_coverage=1.0, quality=1.0,
    )  # fmt: skip
    found = search_again(points, [stem], CELL_M, StemSettings(), index_cell_m=0.5, most=1)
    assert [tuple(np.round(other.axis.center_at(1.3), 1)) for other in found] == [(4.0, 4.0)]

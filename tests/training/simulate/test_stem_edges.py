"""Simulated edges lie on the hull of the stem, and their interval holds where only few sides are seen."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees.diameter.budget import factor95
from fsinfer.trees.diameter.silhouette import fit_silhouette
from training.simulate.stem_edges import EdgeSpec, simulate_edges

CLEAN = EdgeSpec(covered=0.0, shadow=0.0, junk=0.0, drift_m=(0.0, 0.0), light_px=(0.0, 0.0), edge_px=0.0)


def test_same_seed_same_edges() -> None:
    a, b, c = (simulate_edges(seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(a.edges.support_m, b.edges.support_m)
    assert (a.dbh_m, a.arc_deg) == (b.dbh_m, b.arc_deg)
    assert a.dbh_m != c.dbh_m


def test_the_mean_of_the_support_all_round_is_what_a_tape_reads() -> None:
    """Cauchy: the girth of a hull is the integral of its support function."""
    spec = EdgeSpec(**{**vars(CLEAN), "arc_deg": (360.0, 360.0), "photos": (59, 60)})
    stem = simulate_edges(43001, spec)
    breast = np.abs(stem.edges.height_m) < 0.05
    assert 2.0 * stem.edges.support_m[breast].mean() == pytest.approx(stem.dbh_m, rel=0.005)


@pytest.mark.parametrize("seed", [43246, 43252, 43318, 43354, 43365])
def test_few_sides_stay_inside_the_interval_by_what_nobody_saw(seed: int) -> None:
    """Five of the stems of seeds 43200 to 43419 that were outside by less than unseen sides add."""
    stem = simulate_edges(seed, EdgeSpec(arc_deg=(5.0, 110.0)))
    fit = fit_silhouette(stem.edges, stem.known_m, taper=-0.006)
    assert fit is not None
    assert fit.sectors < 0.4
    off, wide = abs(fit.radius_m - stem.dbh_m / 2.0), factor95(fit.dof)
    assert off <= wide * fit.std_m
    assert off > wide * np.sqrt(fit.std_m**2 - fit.one_sided_m**2)

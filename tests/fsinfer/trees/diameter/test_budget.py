"""Budgets of intervals: what adds up, and how wide an interval is that few blocks tell."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.trees.diameter.budget import effective_dof, factor95, total_std


def test_parts_add_up_by_their_squares() -> None:
    assert total_std({"fit": 0.003, "scale": 0.004}) == pytest.approx(0.005)


def test_few_degrees_of_freedom_widen_the_interval_as_student_says() -> None:
    """Quantiles of the tables of Student's distribution; never narrower than a Gaussian's 1.96."""
    assert [factor95(dof) for dof in (1.0, 3.0, 10.0)] == pytest.approx([12.706, 3.182, 2.228], abs=0.001)
    assert factor95(float("inf")) == factor95(1e6) == pytest.approx(1.96, abs=1e-4)
    assert factor95(0.2) == factor95(1.0)


def test_only_uncertain_parts_cost_degrees_of_freedom() -> None:
    """JCGM 100:2008, equation G.2b, by hand."""
    assert effective_dof({"fit": 1.0, "scale": 0.0}, {"fit": 4.0}) == pytest.approx(4.0)
    assert effective_dof({"fit": 1.0, "scale": 1.0}, {"fit": 4.0}) == pytest.approx(16.0)
    assert np.isinf(effective_dof({"scale": 1.0}, {"fit": 4.0}))


def test_student_holds_the_truth_where_a_gaussian_does_not() -> None:
    """Means of four draws with their own standard error: 1.96 of them hold 86 %."""
    rng = np.random.default_rng(43000)
    draws = rng.normal(0.0, 1.0, (20_000, 4))
    mean, error = draws.mean(axis=1), draws.std(axis=1, ddof=1) / 2.0
    inside = np.abs(mean) <= factor95(effective_dof({"mean": 1.0}, {"mean": 3.0})) * error
    assert inside.mean() == pytest.approx(0.95, abs=0.01)
    assert (np.abs(mean) <= 1.96 * error).mean() < 0.88

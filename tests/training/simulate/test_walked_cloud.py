"""The second simulator: its truth is what a tape reads, its classes are what its stations see."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from training.simulate.grown_stem import GrownStem, GrowthSpec
from training.simulate.walked_cloud import WalkSpec, simulate_walk

SPARSE: dict[str, Any] = {"spacing_m": (0.025, 0.025), "shrubs_per_tree": 0.0}
FEW = WalkSpec(trees=6, torn=0.0, **SPARSE)
SMOOTH = GrowthSpec(furrow=(0.0, 0.0), flat=(0.0, 0.0), oval_std=0.0, flare=(0.0, 0.0))


def test_same_seed_same_cloud() -> None:
    a, b, c = (simulate_walk(seed, FEW) for seed in (3, 3, 4))
    np.testing.assert_array_equal(a.points, b.points)
    assert a.stems == b.stems
    assert len(c.points) != len(a.points)


def test_a_tape_spans_furrows_and_dents() -> None:
    round_stem = GrownStem(np.random.default_rng(0), 0.30, 1.3, SMOOTH)
    assert round_stem.tape_m() == pytest.approx(0.30, abs=1e-4)
    deep = GrownStem(
        np.random.default_rng(0), 0.30, 1.3, GrowthSpec(furrow=(0.05, 0.05), oval_std=0.0, flat=(0.0, 0.0))
    )
    angle = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    mean = 2.0 * float(deep.radius_at(angle, np.full(4000, 1.3)).mean())
    assert mean < 0.297 < deep.tape_m() < 0.302


def test_stems_lean_taper_and_flare() -> None:
    stem = GrownStem(np.random.default_rng(5), 0.30, 1.3, GrowthSpec(lean_deg=(10.0, 10.0), flare=(0.4, 0.4)))
    foot, breast, high = stem.axis_at(np.array([0.0, 1.3, 2.6]))
    assert np.degrees(np.arctan(np.linalg.norm(high - foot) / 2.6)) == pytest.approx(10.0, abs=2.0)
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    radii = [float(stem.radius_at(angle, np.full(100, h)).mean()) for h in (0.0, 1.3, 3.0)]
    assert radii[0] > 1.1 * radii[1] > 1.1 * radii[2]
    assert np.linalg.norm(breast) > 0.1


@pytest.mark.parametrize("kind", ["walked-photo", "walked-lidar"])
def test_points_lie_on_the_sides_that_were_seen(kind: str) -> None:
    cloud = simulate_walk(11, WalkSpec(kind=kind, trees=8, ring=0.0, past=1.0, torn=0.0, **SPARSE))
    hidden = [stem for stem in cloud.stems if "half hidden" in stem.tags]
    assert hidden
    for stem in cloud.stems:
        own = cloud.points[cloud.owner == stem.tree_id - 1]
        ring = own[np.abs(own[:, 2] - stem.z_ground_m - 1.3) < 0.15] - [stem.x_m, stem.y_m, 0.0]
        side = np.floor(np.degrees(np.arctan2(ring[:, 1], ring[:, 0])) / 10.0)
        assert 10.0 * len(np.unique(side)) >= 0.5 * stem.seen_deg - 20.0
        if stem in hidden:
            count = np.bincount((side + 18).astype(int) % 36, minlength=36)
            assert np.sort(count)[:8].sum() < 0.05 * count.sum()
        assert 200.0 * np.median(np.hypot(ring[:, 0], ring[:, 1])) == pytest.approx(stem.dbh_cm, rel=0.08, abs=2.5)


def test_a_torn_walk_leaves_double_walls_and_far_stems_are_told() -> None:
    torn = simulate_walk(2, WalkSpec(trees=8, torn=1.0, **SPARSE))
    assert any("double wall" in stem.tags for stem in torn.stems)
    whole = [stem for seed in range(6) for stem in simulate_walk(seed, WalkSpec(trees=10, torn=0.0, **SPARSE)).stems]
    assert not any("double wall" in stem.tags for stem in whole)
    for tag in ("all round", "half hidden", "thin", "leaning", "far"):
        assert any(tag in stem.tags for stem in whole), tag


def test_unknown_kind() -> None:
    with pytest.raises(ValueError, match="sonar"):
        simulate_walk(0, WalkSpec(kind="sonar"))

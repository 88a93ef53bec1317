"""The simulator of stem clouds: its truth is what its points say."""

from typing import Any

import numpy as np
import pytest

from training.simulate.stem_cloud import CloudSpec, simulate

PLAIN: dict[str, Any] = {
    "trees": 4, "slope_deg": (0.0, 0.0), "bumps_m": (0.0, 0.0), "shrubs_per_tree": 0.0, "branchy": 0.0,
    "forked_low": 0.0, "forked_high": 0.0, "double_wall": 0.0, "spacing_m": (0.01, 0.01),
}  # fmt: skip


def test_same_seed_same_cloud() -> None:
    a, b, c = (simulate(seed, CloudSpec(**PLAIN)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(a.points, b.points)
    assert a.stems == b.stems
    assert len(c.points) != len(a.points)


@pytest.mark.parametrize(("kind", "sigma_m"), [("lidar", 0.003), ("photo", 0.015)])
def test_points_lie_about_the_girth_that_the_truth_says(kind: str, sigma_m: float) -> None:
    cloud = simulate(0, CloudSpec(kind=kind, **PLAIN))
    for number, stem in enumerate(cloud.stems):
        if stem.seen_deg < 359:
            continue
        own = cloud.points[cloud.owner == number]
        ring = own[np.abs(own[:, 2] - stem.z_ground_m - 1.3) < 0.05]
        distance = np.hypot(ring[:, 0] - stem.x_m, ring[:, 1] - stem.y_m)
        assert 200.0 * np.median(distance) == pytest.approx(stem.dbh_cm, abs=0.6 + 30.0 * sigma_m)
        # Shape and lean add to the noise, but little.
        assert sigma_m * 0.8 < np.percentile(distance, 50) - np.percentile(distance, 15.87) < sigma_m + 0.01


def test_a_third_of_photographed_stems_shows_one_side_only() -> None:
    seen = [s.seen_deg for seed in range(12) for s in simulate(seed, CloudSpec(kind="photo", **PLAIN)).stems]
    hidden = np.array(seen) < 359
    assert 0.15 < hidden.mean() < 0.55
    assert np.array(seen)[hidden].max() <= 190.0


def test_low_forks_are_two_stems_and_double_walls_are_tagged() -> None:
    forked = simulate(1, CloudSpec(**PLAIN | {"forked_low": 1.0, "dbh_m": (0.3, 0.4)}))
    assert len(forked.stems) == 8
    double = simulate(1, CloudSpec(**PLAIN | {"double_wall": 1.0}))
    assert all("double wall" in stem.tags for stem in double.stems)


def test_unknown_kind() -> None:
    with pytest.raises(ValueError, match="sonar"):
        simulate(0, CloudSpec(kind="sonar"))

"""What is a stem and what is none: hollow, round, persistent, standing out, and no post."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.notices.stems import StemCode
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.search.verify import Candidate, verify
from tests.support.stem_clouds import board, post, wall

CELL_M = 0.015
Points = NDArray[np.float64]


def judged(
    points: Points, *, xy: tuple[float, float] = (0.01, -0.01), s: StemSettings | None = None
) -> tuple[Stem | None, StemCode | None]:
    s = s or StemSettings()
    slab = points[(points[:, 2] >= s.heights_m[0]) & (points[:, 2] <= s.heights_m[1])]
    (found,) = verify([Candidate(near=slab, xy=np.array(xy), height_m=1.3)], CELL_M, s)
    return (found, None) if isinstance(found, Stem) else (None, found)


def noisy(points: Points, sigma_m: float = 0.004) -> Points:
    return points + np.random.default_rng(9).normal(0.0, sigma_m, points.shape)


@pytest.mark.parametrize(("radius", "arc_deg"), [(0.05, 360.0), (0.15, 360.0), (0.15, 120.0), (0.4, 200.0)])
def test_a_stem_is_one_with_its_axis_its_arc_and_its_length(radius: float, arc_deg: float) -> None:
    points = noisy(wall(np.random.default_rng(0), radius=radius, arc_deg=arc_deg, spacing_m=0.012))
    points[:, 1] += 0.05 * (points[:, 2] - 1.3)
    stem, why = judged(points)
    assert why is None
    assert stem is not None
    assert stem.axis.radius_m == pytest.approx(radius, abs=0.006)
    np.testing.assert_allclose(stem.axis.center_at(1.3), [0.0, 0.0], atol=0.008)
    np.testing.assert_allclose(stem.axis.parameters[2:4], [0.0, 0.05], atol=0.015)
    assert stem.arc_coverage == pytest.approx(arc_deg / 360, abs=0.09)
    # Seen over all of the heights that are looked at.
    assert (stem.bottom_m, stem.top_m) == pytest.approx((0.5, 2.5))
    assert stem.length_m == pytest.approx(2.0)


def test_a_stem_hidden_above_and_below_is_known_to_be_short() -> None:
    points = noisy(wall(np.random.default_rng(0), radius=0.15, spacing_m=0.012))
    stem, _ = judged(points[(points[:, 2] > 0.9) & (points[:, 2] < 1.9)])
    assert stem is not None
    assert (stem.bottom_m, stem.top_m) == pytest.approx((0.9, 1.9), abs=0.11)
    assert judged(points[(points[:, 2] > 1.1) & (points[:, 2] < 1.6)]) == (None, StemCode.candidate_short)


def test_what_is_full_inside_is_a_shrub() -> None:
    rng = np.random.default_rng(1)
    shell = noisy(wall(rng, radius=0.15, spacing_m=0.012))
    count = int(0.75 * len(shell))
    inner, angle = rng.uniform(0, 0.08, count), rng.uniform(0, 2 * np.pi, count)
    filling = np.column_stack([inner * np.cos(angle), inner * np.sin(angle), rng.uniform(0, 4, count)])
    assert judged(np.concatenate([shell, filling])) == (None, StemCode.candidate_filled)
    assert judged(np.concatenate([shell, filling[::5]]))[0] is not None


def test_a_wall_in_a_thicket_stands_out_less() -> None:
    rng = np.random.default_rng(2)
    shell = noisy(wall(rng, radius=0.15, spacing_m=0.012))
    shell = shell[np.abs(shell[:, 2] - 1.5) < 1.0]
    count = 2 * len(shell)
    angle, reach = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.uniform(0.155**2, 0.3**2, count))
    haze = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), rng.uniform(0.5, 2.5, count)])
    thicket, strict = np.concatenate([shell, haze]), StemSettings(min_contrast=6.0)
    assert judged(thicket)[0] is not None
    assert judged(thicket, s=strict) == (None, StemCode.candidate_flush)
    assert judged(shell, s=strict)[0] is not None


def test_posts_and_boards_are_told_from_stems_by_their_end_below_two_metres() -> None:
    rng = np.random.default_rng(3)
    assert judged(board(rng, at=(0.0, 0.0), sigma_m=0.003), xy=(0.0, 0.1))[0] is None
    assert judged(post(rng, at=(0.0, 0.0), width_m=0.05, top_m=1.6, sigma_m=0.003)) == (None, StemCode.candidate_post)
    thin = noisy(wall(rng, radius=0.025, spacing_m=0.01, taper=0.0), 0.003)
    assert judged(thin[thin[:, 2] < 1.6]) == (None, StemCode.candidate_post)
    assert judged(thin)[0] is not None


def test_a_stem_that_lies_rather_than_stands_is_none() -> None:
    points = noisy(wall(np.random.default_rng(4), radius=0.15, spacing_m=0.012))
    points[:, 0] += 1.3 * (points[:, 2] - 1.3)
    stem, why = judged(points)
    assert stem is None
    assert why in (
        StemCode.candidate_leans,
        StemCode.candidate_not_round,
        StemCode.candidate_radius,
        StemCode.candidate_no_ring,
    )


def test_candidates_do_not_know_of_each_other() -> None:
    s = StemSettings()
    rng = np.random.default_rng(5)
    clouds = [noisy(wall(rng, radius=radius, spacing_m=0.015)) for radius in (0.08, 0.2)]
    clouds += [rng.uniform([-0.4, -0.4, 0.5], [0.4, 0.4, 2.5], (600, 3)), clouds[0][:5]]
    candidates = [Candidate(near=cloud, xy=np.array([0.01, 0.0]), height_m=1.3) for cloud in clouds]
    together = verify(candidates, CELL_M, s)
    assert [isinstance(found, Stem) for found in together] == [True, True, False, False]
    assert together[3] == StemCode.candidate_few_points
    for candidate, stem in zip(candidates, together, strict=True):
        (alone,) = verify([candidate], CELL_M, s)
        if not isinstance(alone, Stem) or not isinstance(stem, Stem):
            assert alone == stem
        else:
            np.testing.assert_allclose(alone.axis.parameters, stem.axis.parameters, atol=2e-5)
    assert verify([], CELL_M, s) == []

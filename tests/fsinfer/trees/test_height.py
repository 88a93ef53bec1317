"""Tree height where the top was seen, and none where the cloud was cut off below it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.height import TopSettings, axis_path, top_may_be_seen, tree_height
from fsinfer.trees.points.cells import PlanIndex
from fsinfer.trees.search.stem import Stem

RADIUS = 0.1


def stem_at(x: float, y: float, *, lean: float = 0.0) -> Stem:
    axis = Axis(parameters=np.array([x, y, lean, 0.0, RADIUS, 0.0]), height_m=1.3, sigma_m=0.005)
    return Stem(axis=axis, bottom_m=0.5, top_m=2.5, length_m=2.0, arc_coverage=1.0, quality=1.0)


def tree(x: float, y: float, height_m: float, *, seed: int = 0) -> NDArray[np.float64]:
    """A stem and a crown that narrows to the top."""
    rng = np.random.default_rng(seed)
    angle, z = rng.uniform(0, 2 * np.pi, 2000), rng.uniform(0, height_m - 0.1, 2000)
    trunk = np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), z])
    share = np.sqrt(rng.uniform(0, 1, 6000))
    reach, angle = 1.2 * share * np.sqrt(rng.uniform(0, 1, 6000)), rng.uniform(0, 2 * np.pi, 6000)
    crown = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), height_m - 0.5 * height_m * share])
    top = [[0.01 * i, 0.0, height_m - 0.01 * i] for i in range(6)]
    points: NDArray[np.float64] = np.concatenate([trunk, crown, top])
    points += np.array([x, y, 0.0])
    return points


def height_of(
    points: NDArray[np.float64], stems: list[Stem], number: int = 0, dbh_m: float | None = 0.2
) -> float | None:
    centers = np.array([stem.axis.center_at(1.3) for stem in stems])
    index = PlanIndex(points, 0.5)
    return tree_height(index, stems[number], centers, number, dbh_m, highest_m=float(points[:, 2].max()))


@pytest.mark.parametrize("height_m", [9.0, 14.0, 22.0])
def test_a_whole_tree_is_as_high_as_its_top(height_m: float) -> None:
    points = tree(0.0, 0.0, height_m)
    assert height_of(points, [stem_at(0.0, 0.0)]) == pytest.approx(height_m, abs=0.06)
    assert height_of(points, [stem_at(0.0, 0.0)], dbh_m=None) == pytest.approx(height_m, abs=0.06)


def test_a_cloud_that_ends_in_the_crown_shows_no_top() -> None:
    points = tree(0.0, 0.0, 22.0)
    assert height_of(points[points[:, 2] < 15.0], [stem_at(0.0, 0.0)]) is None
    # A bare pole is no tree with its top, however high.
    pole = tree(0.0, 0.0, 22.0)
    assert height_of(pole[np.hypot(pole[:, 0], pole[:, 1]) < 0.11], [stem_at(0.0, 0.0)]) is None


@pytest.mark.parametrize(("top_m", "gap_m"), [(10.0, 3.0), (10.0, 2.2), (9.4, 2.2)])
def test_what_hangs_above_a_gap_belongs_to_another_tree(top_m: float, gap_m: float) -> None:
    points = tree(0.0, 0.0, top_m)
    low = top_m + gap_m
    above = np.random.default_rng(1).uniform([-0.5, -0.5, low], [0.5, 0.5, low + 1.0], (300, 3))
    assert height_of(np.concatenate([points, above]), [stem_at(0.0, 0.0)]) == pytest.approx(top_m, abs=0.06)


def hidden_above(height_m: float, hidden_m: float) -> NDArray[np.float64]:
    """A tree of 22 m of which ever less is seen up to ``height_m``, nothing for ``hidden_m``, and then the rest."""
    points = tree(0.0, 0.0, 22.0)
    z = points[:, 2]
    seen = np.random.default_rng(2).random(len(points)) < np.clip((height_m - z) / 2.0, 0.0, 1.0)
    return np.asarray(points[seen | (z > height_m + hidden_m)])


@pytest.mark.parametrize("hidden_m", [2.5, 4.0])
def test_where_a_tree_is_hidden_it_does_not_end(hidden_m: float) -> None:
    """Twigs hide the middle of a crown: below a gap it thins out like a top, and was believed to end there."""
    points = hidden_above(14.0, hidden_m)
    assert height_of(points, [stem_at(0.0, 0.0)]) is None
    # Where nothing is above, that is all that can be told.
    assert height_of(points[points[:, 2] < 14.0], [stem_at(0.0, 0.0)]) == pytest.approx(14.0, abs=0.4)
    # Nor do a few stray points tell that it goes on.
    few = np.concatenate([points[points[:, 2] < 14.0], points[points[:, 2] > 19.0][:10]])
    assert height_of(few, [stem_at(0.0, 0.0)]) == pytest.approx(14.0, abs=0.4)


def test_a_bare_stem_above_its_lower_branches_is_no_tip() -> None:
    rng = np.random.default_rng(4)
    angle, z = rng.uniform(0.0, 2.0 * np.pi, 1500), rng.uniform(0.0, 8.0, 1500)
    bark = np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), z])
    branches = rng.uniform([-0.6, -0.6, 4.0], [0.6, 0.6, 6.8], (3000, 3))
    below = np.concatenate([bark, branches])
    whole = tree(0.0, 0.0, 20.0)
    assert height_of(below, [stem_at(0.0, 0.0)]) == pytest.approx(8.0, abs=0.1)
    assert height_of(np.concatenate([below, whole[whole[:, 2] > 11.0]]), [stem_at(0.0, 0.0)]) is None


def test_what_is_above_a_gap_at_the_side_or_too_high_for_the_stem_is_another_trees() -> None:
    points = hidden_above(14.0, 3.0)
    own, above = points[points[:, 2] < 14.0], points[points[:, 2] > 14.0]
    aside = np.random.default_rng(1).uniform([0.3, -0.4, 17.0], [0.7, 0.4, 19.0], (300, 3))
    assert height_of(np.concatenate([own, aside]), [stem_at(0.0, 0.0)]) == pytest.approx(14.0, abs=0.4)
    # A stem of 12 cm does not carry a crown at 20 m.
    assert height_of(np.concatenate([own, above]), [stem_at(0.0, 0.0)], dbh_m=0.12) == pytest.approx(14.0, abs=0.4)


def test_a_thin_stem_is_not_as_high_as_the_crown_that_it_grows_into() -> None:
    # No stem is known of what is above; 16 m are none of a stem of 9 cm, and may be of one of 12 cm.
    points = np.concatenate([tree(0.0, 0.0, 16.0), tree(0.0, 0.0, 8.0, seed=1)])
    assert height_of(points, [stem_at(0.0, 0.0)], dbh_m=0.09) is None
    assert height_of(points, [stem_at(0.0, 0.0)], dbh_m=0.12) == pytest.approx(16.0, abs=0.06)
    assert height_of(points, [stem_at(0.0, 0.0)], dbh_m=None) == pytest.approx(16.0, abs=0.06)


def test_what_goes_on_without_a_gap_belongs_to_the_tree() -> None:
    points = tree(0.0, 0.0, 10.0)
    joined = np.random.default_rng(1).uniform([-0.3, -0.3, 10.0], [0.3, 0.3, 11.2], (300, 3))
    taller = height_of(np.concatenate([points, joined]), [stem_at(0.0, 0.0)])
    assert taller is None or taller > 11.0


def test_a_taller_neighbours_crown_is_left_to_it() -> None:
    both = np.concatenate([tree(0.0, 0.0, 9.0), tree(1.2, 0.0, 16.0, seed=1)])
    stems = [stem_at(0.0, 0.0), stem_at(1.2, 0.0)]
    assert height_of(both, stems, 1) == pytest.approx(16.0, abs=0.06)
    alone, beside = height_of(both, stems[:1]), height_of(both, stems)
    assert beside is None or beside < 12.0
    assert alone is None or alone > 12.0


def test_a_leaning_tree_is_followed_half_way() -> None:
    # Measured over two metres, a lean of 0.1 is believed by half over the other twenty.
    points = tree(0.0, 0.0, 18.0)
    points[:, 0] += 0.05 * (points[:, 2] - 1.3)
    assert height_of(points, [stem_at(0.0, 0.0, lean=0.1)]) == pytest.approx(18.0, abs=0.06)
    low, high = axis_path(stem_at(2.0, 3.0, lean=0.1), 18.3)
    np.testing.assert_allclose(low, [2.0 - 0.05 * 0.3, 3.0])
    np.testing.assert_allclose(high, [2.0 + 0.05 * 17.0, 3.0])
    # It ends where it leaves the reach.
    _, far = axis_path(stem_at(0.0, 0.0, lean=1.0), 100.0)
    s = TopSettings()
    np.testing.assert_allclose(far, [s.reach_m + s.crown_radius_m, 0.0])


@pytest.mark.parametrize(("height_m", "lean_deg"), [(10.0, 20.0), (18.0, 6.0), (18.0, 10.0), (18.0, 12.0), (25.0, 8.0)])
def test_a_straight_tree_that_leans_is_as_high_as_its_top(height_m: float, lean_deg: float) -> None:
    """About half of its lean the top was cut off at the side, and what was left looked like one."""
    lean = float(np.tan(np.radians(lean_deg)))
    points = tree(0.0, 0.0, height_m)
    points[:, 0] += lean * (points[:, 2] - 1.3)
    assert height_of(points, [stem_at(0.0, 0.0, lean=lean)]) == pytest.approx(height_m, abs=0.06)


def test_what_stands_beside_a_leaning_stem_is_not_its_top() -> None:
    points = tree(0.0, 0.0, 18.0)
    points[:, 0] += 0.05 * (points[:, 2] - 1.3)
    # A tip of which no stem is known: a metre and more behind what leans away from it.
    beside = np.random.default_rng(3).uniform([-0.6, -0.2, 17.0], [-0.3, 0.2, 20.0], (400, 3))
    assert height_of(np.concatenate([points, beside]), [stem_at(0.0, 0.0, lean=0.1)]) == pytest.approx(18.0, abs=0.06)


@pytest.mark.parametrize(("widths", "seen"), [(0.2, False), (0.6, True)])
def test_a_crown_is_clearly_wider_than_its_stem(widths: float, seen: bool) -> None:
    points = tree(0.0, 0.0, 18.0)
    crown = np.arange(len(points)) >= 2000
    points[crown, :2] *= widths  # of 1.2 m at its foot
    assert (height_of(points, [stem_at(0.0, 0.0)]) is not None) == seen


def test_of_a_top_at_the_side_of_both_no_height_is_told() -> None:
    points = tree(0.0, 0.0, 18.0)
    points[:, 1] += 0.07 * (points[:, 2] - 1.3)  # leans another way than its stem says
    assert height_of(points, [stem_at(0.0, 0.0, lean=0.08)]) is None


def test_a_low_cloud_is_not_even_looked_at() -> None:
    stem = stem_at(0.0, 0.0)
    assert not top_may_be_seen(stem, 0.05, 2.9)
    assert top_may_be_seen(stem, 0.05, 3.1)
    assert not top_may_be_seen(stem, 0.4, 13.9)
    assert top_may_be_seen(stem, 0.4, 14.1)
    # Without a diameter that of the axis counts: 20 cm.
    assert not top_may_be_seen(stem, None, 6.9)
    assert top_may_be_seen(stem, None, 7.1)

"""When a diameter is given, doubted and refused, on stems whose one trouble is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.notices.stems import StemCode
from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.diameter.dbh import measure_together
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.diameter.verdict import too_uncertain, wide_interval
from fsinfer.trees.search.stem import Stem
from tests.support.stem_clouds import wall

Floats = NDArray[np.float64]
BH = 1.3


def points_of(
    radius: float = 0.16, *, sigma_m: float = 0.002, spacing_m: float = 0.012, seed: int = 0, **kwargs: float
) -> Floats:
    """Bark from 0.3 m to 2.3 m."""
    rng = np.random.default_rng(seed)
    points = wall(rng, radius=radius, spacing_m=spacing_m, **kwargs)
    points = points[np.abs(points[:, 2] - BH) < 1.0]
    return np.asarray(points + rng.normal(0.0, sigma_m, points.shape))


def measure(
    points: Floats,
    radius: float = 0.16,
    *,
    bottom_m: float = 0.3,
    top_m: float = 2.3,
    lean: float = 0.0,
    sigma_m: float = 0.004,
) -> Section:
    """The section of one stem that the search has with ``radius`` where the points are."""
    axis = Axis(parameters=np.array([0.0, 0.0, lean, 0.0, radius, -0.005]), height_m=BH, sigma_m=sigma_m)
    stem = Stem(axis=axis, bottom_m=bottom_m, top_m=top_m, length_m=top_m - bottom_m, arc_coverage=1.0, quality=1.0)
    (section,) = measure_together([points], [stem])
    return section


def codes(section: Section) -> set[str]:
    return {why.code for why in section.reasons}


@pytest.mark.parametrize(
    ("arc_deg", "says"),
    [(52.0, StemCode.too_little_seen), (82.0, StemCode.little_seen), (125.0, None), (360.0, None)],
)
def test_a_sliver_has_no_diameter_and_a_quarter_a_doubtful_one(arc_deg: float, says: StemCode | None) -> None:
    section = measure(points_of(arc_deg=arc_deg))
    assert codes(section) & {StemCode.too_little_seen, StemCode.little_seen} == ({says} if says else set())
    assert section.coverage == pytest.approx(arc_deg / 360.0, abs=0.03)
    assert (section.dbh_m is None) == (says == StemCode.too_little_seen)
    assert (section.status == "ok") == (says is None)
    # A side that nobody saw is worth a hundredth of the radius and more.
    assert section.parts_m["hidden"] == pytest.approx(0.042 * (1 - arc_deg / 360) * section.circle_m[2], abs=3e-4)


@pytest.mark.parametrize(
    ("bottom_m", "top_m", "bh_m", "says"),
    [
        (1.23, 2.3, 1.33, None),
        (1.28, 2.3, 1.38, StemCode.above_breast_height),
        (0.3, 1.37, 1.27, None),
        (0.3, 1.32, 1.22, StemCode.below_breast_height),
    ],
)
def test_a_stem_that_is_not_seen_at_breast_height_is_measured_where_it_is(
    bottom_m: float, top_m: float, bh_m: float, says: StemCode | None
) -> None:
    section = measure(points_of(taper=-0.02), bottom_m=bottom_m, top_m=top_m)
    assert section.bh_m == pytest.approx(bh_m)
    assert codes(section) == ({says} if says else set())
    # At breast height all the same, by the taper; the section is that of where it was measured.
    assert section.dbh_m == pytest.approx(2 * 0.16, abs=0.001)
    assert section.circle_m[2] == pytest.approx(0.16 - 0.02 * (bh_m - BH), abs=0.001)
    for why in section.reasons:
        assert why.values["off_cm"] == pytest.approx(100 * abs(bh_m - BH))


def test_the_interval_has_the_taper_in_it_where_a_stem_is_measured_higher_up() -> None:
    points = points_of(taper=-0.02)
    here, above = measure(points), measure(points, bottom_m=1.7)
    assert above.bh_m == pytest.approx(1.8)
    assert above.dbh_m == pytest.approx(2 * 0.16, abs=0.002)
    # Half a metre of a taper that is known to 2 mm a metre.
    assert above.parts_m["level"] > 0.5 * 0.002 > 2 * here.parts_m["level"]


def test_ground_that_is_not_sure_makes_a_stem_doubtful_and_its_interval_wide() -> None:
    axis = Axis(parameters=np.array([0.0, 0.0, 0.0, 0.0, 0.16, -0.02]), height_m=1.3, sigma_m=0.004)
    stem = Stem(axis=axis, bottom_m=0.5, top_m=2.5, length_m=2.0, arc_coverage=1.0, quality=1.0)
    sure, unsure = measure_together([points_of(taper=-0.02)] * 2, [stem] * 2, ground_noise_m=[0.0, 0.3])
    assert (sure.status, unsure.status) == ("ok", "doubtful")
    assert codes(unsure) == {StemCode.ground_unsure}
    assert unsure.parts_m["level"] == pytest.approx(0.3 * 0.022, rel=0.1)
    # Of what has no diameter, too: its edges in photographs may give it one at that height.
    few, side = measure_together([points_of()[:5], points_of(arc_deg=50.0)], [stem] * 2, ground_noise_m=[0.3, 0.3])
    assert [why.code for why in few.reasons] == [StemCode.too_few_at_breast_height, StemCode.ground_unsure]
    assert [why.code for why in side.reasons] == [StemCode.too_little_seen, StemCode.ground_unsure]


def test_a_leaning_stem_is_looked_for_where_it_is_at_that_height() -> None:
    points = points_of()
    points[:, 0] += 0.2 * (points[:, 2] - BH)
    section = measure(points, lean=0.2, bottom_m=1.5)
    assert section.bh_m == pytest.approx(1.6)
    np.testing.assert_allclose(section.center, [0.06, 0.0], atol=0.002)
    assert section.slope[0] == pytest.approx(0.2, abs=0.01)
    assert section.lean_deg == pytest.approx(11.3, abs=0.5)


@pytest.mark.parametrize(
    ("radius", "sigma_m", "rough"), [(0.2, 0.019, False), (0.2, 0.06, True), (0.05, 0.012, False), (0.05, 0.023, True)]
)
def test_bark_that_is_no_surface_any_more_has_no_diameter(radius: float, sigma_m: float, rough: bool) -> None:
    section = measure(points_of(radius, sigma_m=sigma_m, spacing_m=0.01), radius)
    assert (StemCode.too_rough in codes(section)) == rough
    assert (section.dbh_m is None) == rough


@pytest.mark.parametrize(("radius", "searched", "noise"), [(0.17, 0.17, 0.033), (0.12, 0.082, 0.031)])
def test_a_stem_seen_all_round_through_much_noise_is_measured_and_doubtful(
    radius: float, searched: float, noise: float
) -> None:
    points = points_of(radius, sigma_m=noise, spacing_m=0.01)
    section = measure(points, searched, sigma_m=0.028)
    assert codes(section) == {StemCode.blurred_points}
    assert section.status == "doubtful"
    assert 0.026 < section.residual_m < 0.034
    assert section.dbh_m == pytest.approx(2 * radius, abs=0.008)
    assert 0.008 < section.half95_m < 0.02
    # From one side nothing tells where the middle of such a haze lies.
    assert codes(measure(points[points[:, 0] > -0.05], searched, sigma_m=0.028)) == {StemCode.too_rough}


def test_noise_is_taken_for_that_of_a_scan_where_it_is_large() -> None:
    along = points_of(0.12, sigma_m=0.0, spacing_m=0.006)
    angle = np.arctan2(along[:, 1], along[:, 0])
    rng = np.random.default_rng(5)
    across = along.copy()
    along[:, :2] += np.column_stack([np.cos(angle), np.sin(angle)]) * rng.normal(0.0, 0.026, (len(along), 1))
    across[:, :2] += rng.normal(0.0, 0.026, (len(across), 2))
    thin, thick = measure(along, 0.12, sigma_m=0.026).dbh_m, measure(across, 0.12, sigma_m=0.026).dbh_m
    assert thin is not None
    assert thick is not None
    # sigma^2 / R of the diameter is 0.56 cm: two thirds of it are taken off both.
    assert 0.24 - thin == pytest.approx(0.0038, abs=0.0012)
    assert thick - 0.24 == pytest.approx(0.0019, abs=0.0012)


@pytest.mark.parametrize(
    ("radius", "searched", "round_"), [(0.1, 0.13, True), (0.2, 0.17, True), (0.2, 0.12, False), (0.09, 0.2, False)]
)
def test_a_fit_far_from_what_the_search_had_is_another_thing(radius: float, searched: float, round_: bool) -> None:
    section = measure(points_of(radius), searched, sigma_m=0.03)
    assert codes(section) == (set() if round_ else {StemCode.not_round})
    assert (section.outline is not None) == round_


def test_a_fit_that_finds_no_bark_is_refused() -> None:
    # All points lie where the search has the inside of the stem.
    section = measure(points_of(0.1), 0.22)
    assert section.dbh_m is None
    assert codes(section) == {StemCode.too_few_on_bark}
    assert np.isfinite(section.circle_m).all()


def test_bark_beyond_forty_centimetres_up_and_down_does_not_count_where_there_is_enough() -> None:
    near, other = points_of(), points_of(0.175, seed=1)
    thicker = np.concatenate([near[np.abs(near[:, 2] - BH) < 0.41], other[np.abs(other[:, 2] - BH) > 0.41]])
    assert measure(thicker).dbh_m == pytest.approx(measure(near).dbh_m, abs=1e-3)


def test_the_outline_is_that_at_breast_height() -> None:
    # Nearly all that is seen lies above, where the stem is up to 3 cm thinner in diameter.
    points = points_of(taper=-0.04, ovality=0.06)
    rng = np.random.default_rng(3)
    points = points[(points[:, 2] > BH) | (rng.random(len(points)) < 0.1)]
    outline = measure(points).outline
    assert outline is not None
    assert outline.min_diameter_m == pytest.approx(0.32 * 0.94, abs=0.003)
    assert outline.max_diameter_m == pytest.approx(0.32 * 1.06, abs=0.003)
    assert outline.girth_diameter_m == pytest.approx(0.32, abs=0.004)


def test_tape_and_callipers_read_an_oval_stem_as_it_is() -> None:
    """The outline went about the girth's radius with harmonics on top: girth that was counted twice, 1 % at 12 %."""
    section = measure(points_of(ovality=0.12))
    assert section.outline is not None
    assert section.dbh_m is not None
    girth = 0.32 * (1.0 + 0.12**2)  # to the fourth power of the ovality
    assert section.dbh_m == pytest.approx(girth, abs=0.001)
    assert section.outline.girth_diameter_m == pytest.approx(girth, abs=0.001)
    assert section.outline.min_diameter_m == pytest.approx(0.32 * 0.88, abs=0.002)
    assert section.outline.max_diameter_m == pytest.approx(0.32 * 1.12, abs=0.002)


@pytest.mark.parametrize(("arc_deg", "drawn"), [(250.0, False), (310.0, True)])
def test_an_outline_is_drawn_where_nearly_all_of_it_was_seen(arc_deg: float, drawn: bool) -> None:
    assert (measure(points_of(arc_deg=arc_deg)).outline is not None) == drawn


def test_taper_alone_is_no_second_wall() -> None:
    section = measure(points_of(taper=-0.12, sigma_m=0.004))
    assert StemCode.double_wall not in codes(section)
    assert section.dbh_m == pytest.approx(0.32, abs=0.002)


def test_an_interval_of_more_than_a_fifth_is_doubted_and_one_of_more_than_three_fifths_refused() -> None:
    s = DbhSettings()
    dbh_m = 0.3
    assert [bool(wide_interval(dbh_m, width * dbh_m / 2, s)) for width in (0.18, 0.26)] == [False, True]
    assert [bool(too_uncertain(dbh_m, width * dbh_m / 2, s)) for width in (0.5, 0.7)] == [False, True]
    (why,) = too_uncertain(dbh_m, 0.12, s)
    assert (why.code, dict(why.values)) == (StemCode.too_uncertain, {"dbh_cm": 30.0, "half_width_cm": 12.0})
    (why,) = wide_interval(dbh_m, 0.06, s)
    assert (why.code, dict(why.values)) == (StemCode.wide_interval, {"half_width_cm": 6.0})


def test_of_a_fit_that_left_what_was_searched_for_the_place_and_size_of_the_search_stay() -> None:
    """Far views had an arc of 20 cm round the place of a stem of 8 cm; its edges were looked for 20 cm beside it."""
    axis = Axis(parameters=np.array([0.03, -0.02, 0.01, 0.0, 0.12, -0.01]), height_m=1.5, sigma_m=0.03)
    stem = Stem(axis=axis, bottom_m=0.5, top_m=2.5, length_m=2.0, arc_coverage=1.0, quality=1.0)
    points = points_of(0.2)
    (section,) = measure_together([points], [stem])
    assert codes(section) == {StemCode.not_round}
    np.testing.assert_allclose(section.center, [0.03 - 0.2 * 0.01, -0.02])
    assert float(section.circle_m[2]) == pytest.approx(0.122)
    assert section.taper == -0.01
    # What is drawn of it stays where the points are.
    drawn = section.offsets_m + section.center
    assert np.hypot(*drawn.T).mean() == pytest.approx(0.2, abs=0.003)

"""Halves of stems that lie apart, the same way in a whole plot: told once, and held by the intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.silhouettes.points_alone import by_points_alone
from fsinfer.trees import DbhSettings, Section, Tree, TreeSettings, analyse_plot
from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.diameter.dbh import measure_together
from fsinfer.trees.diameter.two_halves import evidence_of_halves
from fsinfer.trees.search.stem import Stem
from fsinfer.trees.stem_measurement import tree_of
from fsinfer.trees.torn import doubt_the_torn
from tests.support.stem_clouds import stem_plot, wall

Floats = NDArray[np.float64]
BH = 1.3
RADII_M = (0.15, 0.16, 0.17, 0.19, 0.21, 0.23, 0.25, 0.27)
#: By how much and in which direction, degrees from x, one half lies beside where it is.
SHIFT_M, TOWARDS_DEG = 0.04, 30.0
#: In which direction from the axis that half is, degrees from x, one for each stem.
HALF_DEG = (30.0, 60.0, 150.0, 200.0, 240.0, 330.0, 350.0, 90.0)


def bark(rng: np.random.Generator, radius: float, *, oval: float = 0.0, long_deg: float = 0.0) -> Floats:
    """Points (N, 3) on a metre of stem; ``oval`` is the second harmonic over the radius."""
    angle, height = rng.uniform(-np.pi, np.pi, 2000), rng.uniform(BH - 0.5, BH + 0.5, 2000)
    rho = radius * (1.0 + oval * np.cos(2.0 * (angle - np.radians(long_deg)))) + rng.normal(0.0, 0.003, 2000)
    return np.column_stack([rho * np.cos(angle), rho * np.sin(angle), height])


def tear(points: Floats, half_deg: float) -> Floats:
    """The same with the half that lies towards ``half_deg`` from the z axis moved."""
    half, towards = np.radians(half_deg), np.radians(TOWARDS_DEG)
    moved = points.copy()
    there = points[:, :2] @ np.array([np.cos(half), np.sin(half)]) > 0.0
    moved[there, :2] += SHIFT_M * np.array([np.cos(towards), np.sin(towards)])
    return moved


def measured(clouds: Sequence[Floats], radii: Sequence[float] = RADII_M) -> list[tuple[Tree, Section]]:
    """What each stem by itself gives."""
    stems = [
        Stem(
            axis=Axis(parameters=np.array([0.0, 0.0, 0.0, 0.0, radius, -0.006]), height_m=BH, sigma_m=0.004),
            bottom_m=0.4, top_m=3.0, length_m=2.6, arc_coverage=1.0, quality=1.0,
        )
        for radius, _ in zip(radii, clouds, strict=False)
    ]  # fmt: skip
    sections = measure_together(clouds, stems)
    assert all(section.dbh_m is not None for section in sections)
    return [(tree_of(section, 0.0, None, np.zeros(3)), section) for section in sections]


@cache
def eight_torn() -> tuple[tuple[Tree, Section], ...]:
    rng = np.random.default_rng(1)
    return tuple(measured([tear(bark(rng, radius), half) for radius, half in zip(RADII_M, HALF_DEG, strict=True)]))


def torn_plot(stems: int = 8) -> list[tuple[Tree, Section]]:
    """Stems of all sizes whose halves lie apart by the same shift, cut each in its own direction."""
    return list(eight_torn()[:stems])


def half_width_cm(tree: Tree) -> float:
    assert tree.dbh_lo95_cm is not None
    assert tree.dbh_hi95_cm is not None
    return 0.5 * (tree.dbh_hi95_cm - tree.dbh_lo95_cm)


def test_one_shift_in_all_stems_is_told_with_its_size_and_direction() -> None:
    _, (said,) = doubt_the_torn(torn_plot())
    assert said.code == StemCode.halves_apart
    assert said.values["stems"] == 8
    assert said.values["shift_cm"] == pytest.approx(4.0, abs=1.5)
    # Azimuths count from the y axis towards the x axis.
    assert said.values["azimuth_deg"] == pytest.approx(90.0 - TOWARDS_DEG, abs=12.0)
    assert "cm apart" in sentence(said)
    assert "register the scans again" in sentence(said)


def test_the_intervals_of_a_torn_plot_hold_what_it_does_to_the_diameters() -> None:
    before = torn_plot()
    after, _ = doubt_the_torn(before)
    truth = [200.0 * radius for radius in RADII_M]
    missed = [abs(one.dbh_cm - dbh) > half_width_cm(one) for (one, _), dbh in zip(before, truth, strict=True)]  # type: ignore[operator]
    assert sum(missed) >= 4
    for (was, old), (tree, section), dbh in zip(before, after, truth, strict=True):
        assert tree.dbh_cm == was.dbh_cm
        assert tree.dbh_cm is not None
        assert abs(tree.dbh_cm - dbh) <= half_width_cm(tree) < 8.0
        assert section.parts_m == old.parts_m | {"torn": section.parts_m["torn"]}
        assert section.sd_m == pytest.approx(np.hypot(old.sd_m, 2.0 * section.parts_m["torn"]))
        assert section.shared_sd_m == pytest.approx(np.hypot(old.shared_sd_m, 2.0 * section.parts_m["torn"]))
        # The variance of what is uncertain stays, that of all of it grows: JCGM 100:2008, G.2b.
        assert section.dof / section.sd_m**4 == pytest.approx(old.dof / old.sd_m**4)


def test_halves_pulled_apart_count_by_d_over_pi_and_halves_that_slide_by_nothing() -> None:
    rng = np.random.default_rng(2)
    # All cut along the shift, and half of them across it.
    along = measured([tear(bark(rng, radius), TOWARDS_DEG) for radius in RADII_M])
    errors = [section.dbh_m / 2.0 - radius for (_, section), radius in zip(along, RADII_M, strict=True)]  # type: ignore[operator]
    assert np.mean(errors) == pytest.approx(SHIFT_M / np.pi, abs=0.002)
    after, said = doubt_the_torn(along)
    assert len(said) == 1
    assert [section.parts_m["torn"] for _, section in after] == pytest.approx([SHIFT_M / np.pi] * 8, rel=0.4)
    across = measured([tear(bark(rng, radius), TOWARDS_DEG + 90.0) for radius in RADII_M])
    errors = [section.dbh_m / 2.0 - radius for (_, section), radius in zip(across, RADII_M, strict=True)]  # type: ignore[operator]
    assert np.abs(errors).mean() < 0.2 * SHIFT_M / np.pi


@pytest.mark.parametrize("oval", [0.02, 0.06, 0.10])
def test_ovals_of_random_directions_say_nothing_and_stay_as_they_are(oval: float) -> None:
    rng = np.random.default_rng(3)
    pairs = measured([bark(rng, radius, oval=oval, long_deg=rng.uniform(0.0, 180.0)) for radius in RADII_M])
    after, said = doubt_the_torn(pairs)
    assert said == ()
    assert after is pairs
    assert all("torn" not in section.parts_m for _, section in after)


def test_few_stems_or_one_odd_stem_say_nothing() -> None:
    assert doubt_the_torn(torn_plot(6))[1] != ()
    assert doubt_the_torn(torn_plot(5))[1] == ()
    assert doubt_the_torn(torn_plot(1))[1] == ()
    rng = np.random.default_rng(4)
    round_ones = measured([bark(rng, radius) for radius in RADII_M[:7]])
    assert doubt_the_torn([*round_ones, torn_plot()[7]])[1] == ()
    # Not even five that are hardly seen elsewhere make it six.
    hidden = [(tree, replace(section, profile=None)) for tree, section in round_ones]
    assert doubt_the_torn([*hidden, *torn_plot(5)])[1] == ()


def test_refused_stems_are_no_witnesses_but_their_points_are_doubted_too() -> None:
    why = (notice(StemCode.too_uncertain, dbh_cm=20.0, half_width_cm=9.0),)
    pairs = [
        (replace(tree, dbh_cm=None), replace(section, dbh_m=None, status="unmeasured", reasons=why))
        for tree, section in torn_plot(3)
    ]
    assert doubt_the_torn([*pairs, *torn_plot(5)])[1] == ()
    after, said = doubt_the_torn([*pairs, *torn_plot(7)])
    assert said[0].values["stems"] == 7
    for (tree, section), (was, _) in zip(after[:3], pairs, strict=True):
        assert tree == was
        assert (section.dbh_m, section.reasons) == (None, why)
        assert section.parts_m["torn"] > 0.0


def test_wide_intervals_are_doubted_and_wider_ones_refused() -> None:
    pairs = torn_plot()
    free, _ = doubt_the_torn(pairs)
    shares = [section.half95_m / (section.dbh_m or 1.0) for _, section in free]
    # Those that were doubted for their width already are so once.
    was = (notice(StemCode.wide_interval, half_width_cm=1.0),)
    pairs = [(replace(tree, reasons=was), replace(section, reasons=was)) for tree, section in pairs]
    strict = TreeSettings(dbh=DbhSettings(max_interval=2.0 * float(np.median(shares)), doubtful_interval=1e-3))
    after, _ = doubt_the_torn(pairs, settings=strict)
    statuses = {section.status for _, section in after}
    assert statuses == {"doubtful", "unmeasured"}
    for tree, section in after:
        (why,) = tree.reasons
        assert tree.reasons == section.reasons
        assert (tree.dbh_cm is None) == (section.dbh_m is None) == (why.code == StemCode.too_uncertain)
        assert why.code in {StemCode.too_uncertain, StemCode.wide_interval}
        assert section.outline is None or section.dbh_m is not None


def test_a_stem_that_one_part_alone_saw_is_hardly_doubted() -> None:
    rng = np.random.default_rng(5)
    half = bark(rng, 0.15)
    half = half[half[:, 0] > 0.0]
    half[:, :2] += SHIFT_M * np.array([np.cos(np.radians(TOWARDS_DEG)), np.sin(np.radians(TOWARDS_DEG))])
    pairs = [*torn_plot(), *measured([half], [0.15])]
    after, (said,) = doubt_the_torn(pairs)
    assert said.values["stems"] == 9
    parts = [section.parts_m["torn"] for _, section in after]
    assert parts[-1] < 0.5 * np.median(parts[:-1])


def test_a_side_of_the_stem_that_is_not_seen_tells_nothing() -> None:
    ((_, section),) = measured([bark(np.random.default_rng(7), 0.15)], [0.15])
    profile = section.profile
    assert profile is not None
    assert profile.seen == 36
    assert np.abs(profile.mean_m).max() < 0.002
    few = np.where(np.arange(36) < 7, profile.precision, 0.0)
    assert evidence_of_halves(replace(profile, precision=few)) is None
    enough = np.where(np.arange(36) < 8, profile.precision, 0.0)
    assert evidence_of_halves(replace(profile, precision=enough)) is not None


def test_a_haze_does_not_make_the_shift_larger() -> None:
    ((tree, section), *_), _ = doubt_the_torn(torn_plot())
    _, wider = by_points_alone(tree, section, 2.0, dbh=DbhSettings(max_interval=9.0))
    assert wider.parts_m["torn"] == section.parts_m["torn"]
    assert wider.parts_m["fit"] == pytest.approx(2.0 * section.parts_m["fit"])


def torn_cloud() -> Floats:
    """Eight stems on level ground, torn; (N, 3)."""
    rng = np.random.default_rng(6)
    parts = []
    for number, (radius, half) in enumerate(zip(RADII_M, HALF_DEG, strict=True)):
        points = tear(wall(rng, radius=radius, spacing_m=0.02, top_m=3.0), half)
        place = np.array([2.0 * (number % 3), 2.0 * (number // 3), 0.0])
        points += rng.normal(0.0, 0.003, points.shape) + place
        parts.append(points)
    ground = rng.uniform([-1.0, -1.0, 0.0], [5.0, 5.0, 0.01], (15_000, 3))
    return np.concatenate([*parts, ground])


def test_a_torn_cloud_is_told_and_a_whole_one_is_as_it_was() -> None:
    cloud = torn_cloud()
    torn = analyse_plot(cloud)
    assert StemCode.halves_apart in {said.code for said in torn.warnings}
    assert any("torn" in section.parts_m for section in torn.sections)
    # Centimetres of a scale that was guessed are none.
    guessed = analyse_plot(cloud, metric=False)
    assert StemCode.halves_apart not in {said.code for said in guessed.warnings}
    whole = analyse_plot(stem_plot(seed=5, trees=8, spacing_m=0.02, top_m=3.0).points)
    assert StemCode.halves_apart not in {said.code for said in whole.warnings}
    assert len(whole.sections) == 8
    assert all("torn" not in section.parts_m for section in whole.sections)

"""How wide is what stands below breast height: a sapling's stem below its twigs, a tree's trunk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.silhouettes.across import across_m, with_sizes_below
from fsinfer.trees import Section, Tree
from fsinfer.trees.diameter.section import unmeasured_section
from fsinfer.trees.rough_dbh import rough_dbh_cm
from tests.support.stem_maps import tree_of

Floats = NDArray[np.float64]
LITTLE = notice(StemCode.too_little_seen, seen_deg=40.0)
GROUND_M = 7.0


def bark(
    diameter_m: float, *, seen_deg: float = 360.0, top_m: float = 2.5, slope: float = 0.0, seed: int = 0
) -> Floats:
    """A leaning stem about its foot, 4,000 points a square metre that scatter by 3 mm."""
    rng = np.random.default_rng(seed)
    count = int(4000 * np.pi * diameter_m * top_m * seen_deg / 360.0)
    angle, height = np.radians(rng.uniform(0.0, seen_deg, count)), rng.uniform(0.0, top_m, count)
    across = 0.5 * diameter_m * np.column_stack([np.cos(angle), np.sin(angle)]) + rng.normal(0.0, 0.003, (count, 2))
    across[:, 0] += slope * height
    return np.column_stack([across, height])


def twigs(low_m: float) -> Floats:
    """A haze 50 cm wide from a height upwards."""
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-0.25, 0.25, (15000, 2)), rng.uniform(low_m, 2.5, 15000)])


@pytest.mark.parametrize("low_m", [0.7, 1.0, 1.2])
def test_a_sapling_is_as_wide_as_below_its_twigs(low_m: float) -> None:
    width = across_m(np.concatenate([bark(0.03, slope=0.05), twigs(low_m)]))
    assert width is not None
    assert 0.02 < width < 0.06
    everywhere = across_m(np.concatenate([bark(0.03), twigs(0.0)]))
    assert everywhere is not None
    assert everywhere > 0.4


@pytest.mark.parametrize(("seen_deg", "least"), [(360.0, 0.95), (180.0, 0.9), (90.0, 0.6)])
def test_a_trunk_is_about_as_wide_as_it_is(seen_deg: float, least: float) -> None:
    width = across_m(bark(0.3, seen_deg=seen_deg))
    assert width is not None
    assert least * 0.3 < width < 1.1 * 0.3


def test_scraps_and_nothing_have_no_width() -> None:
    rng = np.random.default_rng(2)
    assert across_m(np.zeros((0, 3))) is None
    assert across_m(bark(0.3)[::400]) is None  # too few
    scraps = np.column_stack([rng.uniform(-0.3, 0.3, (300, 2)), rng.uniform(0.4, 1.3, 300)])
    assert across_m(scraps) is None
    twig = np.column_stack([rng.normal(0.0, 0.002, (75, 2)), rng.uniform(0.4, 1.3, 75)])
    assert across_m(twig) is not None
    assert across_m(np.concatenate([scraps, twig])) is None  # hardly any of what is there
    assert across_m(bark(0.3, top_m=0.4)) is None  # a stump or herbs


def pair(number: int, x_m: float, dbh_m: float | None, *reasons: Notice) -> tuple[Tree, Section]:
    section = unmeasured_section(np.array([x_m, 0.0]), 1.3, reasons, radius_m=0.1)
    tree = tree_of(number, (x_m, 0.0, GROUND_M), None if dbh_m is None else 100.0 * dbh_m)
    return replace(tree, reasons=reasons), replace(section, dbh_m=dbh_m)


def test_only_who_has_no_size_is_told_one() -> None:
    known = notice(StemCode.too_uncertain, dbh_cm=6.0, half_width_cm=2.0)
    pairs = [pair(1, 0.0, None, LITTLE), pair(2, 5.0, 0.3), pair(3, 10.0, None, known), pair(4, 15.0, None, LITTLE)]
    sapling = np.concatenate([bark(0.03), twigs(1.0)])
    xyz = np.concatenate([sapling + np.array([x, 0.0, GROUND_M]) for x in (0.0, 5.0, 10.0)])
    told = with_sizes_below(pairs, xyz)
    assert told[1:] == pairs[1:]
    (tree, section), (_, before) = told[0], pairs[0]
    assert tree.reasons == section.reasons
    first, second = tree.reasons
    assert (first, second.code) == (LITTLE, StemCode.stands_across)
    assert second.values["across_cm"] == pytest.approx(3.0, abs=2.0)
    assert (rough_dbh_cm(tree) or (0.0, 0.0))[0] <= 5.0
    assert before.reasons == (LITTLE,)


def test_a_trunk_beside_it_is_another_stems() -> None:
    """A shrub in front of a trunk of 30 cm is not 30 cm thick."""
    trunk = bark(0.3, slope=0.1) + np.array([0.25, 0.0, GROUND_M])
    shrub, beside = pair(1, 0.0, None, LITTLE), pair(2, 0.25 + 0.13, 0.3)
    leaning = (beside[0], replace(beside[1], slope=np.array([0.1, 0.0])))
    assert with_sizes_below([shrub, leaning], trunk) == [shrub, leaning]
    ((alone, _),) = with_sizes_below([shrub], trunk)
    assert [why.code for why in alone.reasons] == [LITTLE.code, StemCode.stands_across]

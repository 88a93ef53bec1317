"""The order of a file tells how far the stations of a scanner show a stem beside each other (seeds 44200 to 44239)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.diameter.dbh import measure_together
from fsinfer.trees.diameter.file_order import stations_apart_m
from tests.support.bark import stem_of

Floats = NDArray[np.float64]
NOISE_M = 0.003


def surface(rng: np.random.Generator, points: int, radius: float = 0.15) -> tuple[Floats, Floats, Floats]:
    """Places (N, 3) on a metre of stem, line of scan by line of scan; their angle and height (N,)."""
    height = np.sort(np.round(rng.uniform(0.8, 1.8, points), 2))
    angle = rng.uniform(0.0, 2.0 * np.pi, points)
    order = np.lexsort((angle, height))
    angle, height = angle[order], height[order]
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height]), angle, height


def scan(seed: int, offsets_m: list[float], *, points: int = 1500) -> tuple[Floats, Floats]:
    """Places and residuals of stations one after the other, each all round and off by so much across the bark."""
    rng = np.random.default_rng(seed)
    parts = [(surface(rng, points)[0], rng.normal(offset, NOISE_M, points)) for offset in offsets_m]
    return np.concatenate([places for places, _ in parts]), np.concatenate([residuals for _, residuals in parts])


def apart(places: Floats, residuals: Floats) -> float:
    return stations_apart_m(places, residuals, np.ones(len(places), dtype=bool))


@pytest.mark.parametrize("offset_m", [0.004, 0.01])
def test_two_stations_beside_each_other(offset_m: float) -> None:
    assert apart(*scan(44200, [offset_m, -offset_m])) == pytest.approx(offset_m, rel=0.15)


def test_stations_that_fit_and_files_in_no_order_tell_nothing() -> None:
    assert [apart(*scan(44210 + seed, [0.0, 0.0])) for seed in range(10)] == [0.0] * 10
    places, residuals = scan(44220, [0.01, -0.01])
    shuffled = np.random.default_rng(0).permutation(len(places))
    assert apart(places[shuffled], residuals[shuffled]) == 0.0


def test_bark_with_a_relief_is_no_offset() -> None:
    rng = np.random.default_rng(44221)
    places, angle, height = surface(rng, 3000)
    relief = 0.008 * np.sin(9.0 * angle) * np.sin(40.0 * height)
    assert apart(places, relief + rng.normal(0.0, NOISE_M, len(places))) < 0.001


def test_what_is_no_bark_has_no_say_and_few_points_tell_nothing() -> None:
    places, residuals = scan(44222, [0.0, 0.0])
    strays = np.arange(len(places)) < 300
    residuals[strays] += 0.05
    assert stations_apart_m(places, residuals, ~strays) == 0.0
    few = np.zeros(len(places), dtype=bool)
    few[:50] = True
    assert stations_apart_m(places, residuals, few) == 0.0


def station(rng: np.random.Generator, radius: float, side: float, shift: Floats) -> Floats:
    """Points of the half of a stem that faces ``side``, as far beside their place as the station is."""
    places, angle, _ = surface(rng, 3000, radius)
    places = places[np.cos(angle - side) > 0.1]
    moved = places + rng.normal(0.0, NOISE_M, places.shape) + [*shift, 0.0]
    return np.asarray(moved)


def test_the_interval_holds_a_stem_of_stations_a_centimetre_beside_each_other() -> None:
    clouds, radii = [], []
    rng = np.random.default_rng(44230)
    for _ in range(40):
        radius = float(rng.uniform(0.1, 0.25))
        sides = rng.uniform(0.0, 2.0 * np.pi) + np.arange(4) * np.pi / 2.0
        clouds.append(np.concatenate([station(rng, radius, side, rng.normal(0.0, 0.01, 2)) for side in sides]))
        radii.append(radius)

    def held(points: list[Floats]) -> int:
        found = measure_together(points, [stem_of(radius) for radius in radii])
        # One without a diameter claims nothing.
        return sum(
            section.dbh_m is None or abs(section.dbh_m - 2.0 * radius) <= section.half95_m
            for section, radius in zip(found, radii, strict=True)
        )

    in_order, shuffled = held(clouds), held([cloud[rng.permutation(len(cloud))] for cloud in clouds])
    assert in_order >= 36  # nine in ten
    assert in_order >= shuffled + 4

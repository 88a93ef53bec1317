"""The diameter of a stem from edges: round, oval, and seen from some sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees.diameter.edge_problem import Solution
from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.sides import NOISE_SECTORS
from fsinfer.trees.diameter.silhouette import _spread_of_fits, _surer, edge_contrast, fit_silhouette
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings
from training.simulate.stem_edges import edges_from_rows

TAPER = -0.008


def walked(
    radius: float, oval: float, long_deg: float, directions_deg: NDArray[np.float64], rng: np.random.Generator
) -> Edges:
    """Edges of an oval stem in six bands from each direction, each with a weaker one that is not the stem's.

    A third of the junk lies a little outside of the stem, as shrubs and other stems behind do.
    """
    rows = []
    for number, direction in enumerate(np.radians(directions_deg)):
        for side in (0, 1):
            angle = float(direction + (np.pi / 2 if side else -np.pi / 2))
            for band in range(6):
                height = -0.15 + 0.06 * band
                ray = (number * 2 + side) * 6 + band
                own = radius * (1 + oval * np.cos(2 * (angle - np.radians(long_deg)))) + TAPER * height
                rows.append((own + rng.normal(0, 0.002), angle, height, rng.uniform(3, 9), 0.007, ray, number))
                junk = radius * rng.uniform(0.4, 1.5)
                rows.append((junk, angle, height, rng.uniform(1.2, 6), 0.007, ray, number))
    return edges_from_rows(rows)


def test_a_round_stem_is_not_made_oval() -> None:
    rng = np.random.default_rng(0)
    fit = fit_silhouette(walked(0.2, 0.0, 0.0, np.arange(0.0, 170.0, 10), rng), 0.2, taper=TAPER)
    assert fit is not None
    assert fit.radius_m == pytest.approx(0.2, abs=0.0015)
    assert np.hypot(*fit.shape_m[:2]) < 0.01 * fit.radius_m


@pytest.mark.parametrize(("asked_m", "true_m"), [(0.16, 0.25), (0.10, 0.20)])
def test_edges_far_from_where_they_were_looked_for_are_found(asked_m: float, true_m: float) -> None:
    """From there every edge is as good as impossible, and something has to show the way."""
    rows = []
    for number, direction in enumerate(np.arange(0.0, np.pi, np.pi / 8)):
        for side in (0, 1):
            angle = float(direction + (np.pi / 2 if side else -np.pi / 2))
            rows.append((true_m, angle, 0.0, 8.0, 0.001, number * 2 + side, number))
    fit = fit_silhouette(edges_from_rows(rows), asked_m, taper=TAPER)
    assert fit is not None
    assert fit.radius_m == pytest.approx(true_m, abs=0.001)


@pytest.mark.parametrize("long_deg", [0.0, 40.0, 75.0, 130.0])
def test_an_oval_stem_seen_from_some_sides_has_its_girth(long_deg: float) -> None:
    """A large beech, a tenth longer one way: where a fit begins with a circle, its long sides are 2 to 3 cm away."""
    rng = np.random.default_rng(int(long_deg))
    directions = np.r_[np.arange(0.0, 60.0, 6), np.arange(90.0, 130.0, 4)]
    fit = fit_silhouette(walked(0.28, 0.09, long_deg, directions, rng), 0.27, taper=TAPER)
    assert fit is not None
    assert fit.radius_m == pytest.approx(0.28, abs=0.004)
    assert abs(fit.radius_m - 0.28) < 3 * fit.std_m
    assert np.hypot(*fit.shape_m[:2]) == pytest.approx(0.09 * 0.28, rel=0.2)
    assert fit.share > 0.9


def aside(edges: Edges, photos: list[int], offset_m: float) -> Edges:
    """Photographs placed ``offset_m`` aside: both their sides are moved the same way across the line of sight."""
    moved = np.isin(edges.photo, photos)
    sign = np.where(edges.ray // 6 % 2 == 0, 1.0, -1.0)
    return replace(edges, support_m=edges.support_m + moved * sign * offset_m)


@pytest.mark.parametrize("offset_m", [0.015, -0.008])
def test_photographs_placed_aside_do_not_bend_the_stem(offset_m: float) -> None:
    """Some photographs in a row stand aside of the others, which see the stem from other directions."""
    rng = np.random.default_rng(3)
    edges = walked(0.127, 0.0, 0.0, np.arange(0.0, 170.0, 5), rng)
    near = replace(edges, pixel_m=np.where(edges.photo < 8, 0.002, 0.009))
    fit = fit_silhouette(aside(near, list(range(8)), offset_m), 0.124, taper=TAPER)
    assert fit is not None
    assert fit.radius_m == pytest.approx(0.127, abs=0.0015)
    assert np.hypot(*fit.shape_m[:2]) < 0.015 * fit.radius_m
    # The stem is where most of the photographs have it, and the edges of those aside count.
    assert np.hypot(*fit.shift_m) < 0.006
    assert fit.share > 0.9
    # And what they stand aside is no scatter of the edges.
    assert fit.noise_m < 0.003


def test_what_a_photograph_tells_is_the_width_where_its_place_is_unsure() -> None:
    """One side alone says little of the radius; with the other side it says as much as ever."""
    edges = walked(0.15, 0.0, 0.0, np.arange(0.0, 170.0, 10), np.random.default_rng(4))
    both = fit_silhouette(edges, 0.15, taper=TAPER)
    one = edges.ray // 6 % 2 == 0
    half = fit_silhouette(Edges(**{name: getattr(edges, name)[one] for name in vars(edges)}), 0.15, taper=TAPER)
    surer = fit_silhouette(edges, 0.15, taper=TAPER, settings=SilhouetteSettings(offset_m=1e-6))
    assert both is not None
    assert half is not None
    assert surer is not None
    assert both.std_m < 1.3 * surer.std_m
    assert half.std_m > 1.5 * both.std_m


def test_a_thin_stem_stands_out_too() -> None:
    """The votes of its radius are held against radii centimetres away, not only against its own neighbours."""
    edges = walked(0.04, 0.0, 0.0, np.arange(0.0, 60.0, 4), np.random.default_rng(0))
    # 1.56 where one and a half times the radius is the greatest that is looked at
    assert edge_contrast(edges, 0.04, taper=TAPER) > 1.8


def test_the_scatter_of_an_edge_is_found_by_few_of_them() -> None:
    rng = np.random.default_rng(20)
    found = []
    for _ in range(30):
        rows = []
        for number, direction in enumerate(np.arange(0.0, np.pi, np.pi / 12)):
            for side in (0, 1):
                angle = float(direction + (np.pi / 2 if side else -np.pi / 2))
                rows.append((0.15 + rng.normal(0, 0.004), angle, 0.0, 8.0, 0.001, number * 2 + side, number))
        fit = fit_silhouette(edges_from_rows(rows), 0.15, taper=TAPER)
        assert fit is not None
        found.append(fit.noise_m**2)
    assert 0.82 < np.sqrt(np.mean(found)) / 0.004 < 1.15


def solution(radius_m: float, log_likelihood: float, log_prior: float = 0.0) -> Solution:
    none = np.zeros(0)
    return Solution(
        x=np.array([radius_m]), by_offsets=none, weight=none, residual=none, information=none, noise_m=0.001,
        precision=none, log_likelihood=log_likelihood, log_prior=log_prior,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("gain", "points_m", "believed"),
    [
        (10.0, None, False),
        (60.0, None, True),
        (10.0, 0.255, True),
        (10.0, 0.264, False),
        (40.0, 0.264, False),
        (60.0, 0.264, True),
    ],
)
def test_where_edges_allow_a_round_stem_and_an_oval_one_the_points_tell(
    gain: float, points_m: float | None, believed: bool
) -> None:
    """As 51.3 cm in an oval and 52.9 in a circle, where the points said 51.0."""
    circle, oval = solution(0.2646, 900.0), solution(0.2569, 900.0 + gain)
    assert (_surer(circle, oval, None if points_m is None else (points_m, 0.0025)) is oval) is believed


def test_a_shape_that_no_stem_has_costs_what_it_costs_however_many_edges_there_are() -> None:
    """A beech of 45 cm seen from a third of its sides: an oval of 13 % gained 44 by its edges and had 38.9 cm."""
    circle, oval = solution(0.2205, 165.5, -0.3), solution(0.1946, 165.5 + 58.0, -14.7)
    assert _surer(circle, oval, None) is circle
    common = replace(oval, log_prior=-0.3)
    assert _surer(circle, common, None) is common


def test_other_summits_that_are_as_likely_are_in_the_interval() -> None:
    """As 30.7 cm beside 32 cm and less likely 28 and 35 cm, where 14 photographs show a stem."""
    best = solution(0.1535, 25.1)
    alike = [best, solution(0.1592, 25.1)]
    assert _spread_of_fits(best, alike) == pytest.approx(0.005 / np.sqrt(2.0), rel=0.1)
    # A summit counts once, however many starts led there, and none that is far less likely.
    assert _spread_of_fits(best, [*alike, *alike, solution(0.1593, 25.0)]) == pytest.approx(
        _spread_of_fits(best, alike), rel=0.1
    )
    assert _spread_of_fits(best, [best, solution(0.20, -100.0)]) < 1e-4
    # Nor fits that ended a hair beside.
    assert _spread_of_fits(best, [best, solution(0.1541, 25.1), solution(0.1529, 25.1)]) == 0.0


def test_a_few_edges_that_err_together_bend_no_shape() -> None:
    """What shifts all edges that are seen from one side by 2 mm is told as that, not as a second harmonic."""
    rng = np.random.default_rng(31)
    off: dict[float, list[tuple[float, float]]] = {0.002: [], 1e-6: []}
    for _ in range(12):
        rows, shift = [], rng.normal(0, 0.002, NOISE_SECTORS)
        for number, direction in enumerate(np.radians(np.arange(0.0, 80.0, 4.0))):
            for side in (0, 1):
                angle = float(direction + (np.pi / 2 if side else -np.pi / 2)) % (2 * np.pi)
                for band in range(4):
                    place = 0.18 + shift[int(angle / (2 * np.pi) * NOISE_SECTORS)] + rng.normal(0, 0.001)
                    rows.append((place, angle, 0.1 * band - 0.15, 8.0, 0.001, (2 * number + side) * 4 + band, number))
        for sector_m, errors in off.items():
            settings = SilhouetteSettings(sector_m=sector_m)
            fit = fit_silhouette(edges_from_rows(rows), 0.18, taper=0.0, settings=settings)
            assert fit is not None
            errors.append((fit.radius_m - 0.18, fit.std_m))
    with_them, without = np.array(off[0.002]), np.array(off[1e-6])
    assert np.sqrt((with_them[:, 0] ** 2).mean()) < 0.8 * np.sqrt((without[:, 0] ** 2).mean())
    assert (np.abs(with_them[:, 0]) < 2.5 * with_them[:, 1]).all()

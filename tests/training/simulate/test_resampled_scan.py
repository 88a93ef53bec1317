"""Pieces of a scan: the reference is the tape of a known stem, a view keeps what it sees, a plot is measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.trees import analyse_plot
from training.simulate.resampled_scan import (
    VIEWS,
    Piece,
    ResampledTruth,
    ResampleSpec,
    ScanSpec,
    View,
    pieces_of,
    resample,
    seen_by,
)
from training.simulate.scanned_section import BINS, MIDDLES, SectionLimits, across, find_layers, section_at, tape_of

Floats = NDArray[np.float64]
RADIUS_M = 0.12
SLOPE = np.array([0.06, -0.03])
ONE = ScanSpec(heights_m=(1.5, 1.5))


def scan(
    *, noise_m: float = 0.004, wave: float = 0.0, gap_deg: float = 0.0, second_m: float = 0.0, seed: int = 0
) -> Floats:
    """A leaning stem of 24 cm, oval by ``wave``, tapering 5 mm a metre from z = 1.5 m; half of it seen twice or not."""
    rng = np.random.default_rng(seed)
    count = 8000
    angle, z = rng.uniform(np.radians(gap_deg), 2.0 * np.pi, count), rng.uniform(0.0, 4.0, count)
    radius = RADIUS_M * (1.0 + wave * np.cos(2.0 * angle)) - 0.005 * (z - 1.5) + rng.normal(0.0, noise_m, count)
    axis = np.array([*SLOPE, 1.0]) / np.sqrt(1.0 + SLOPE @ SLOPE)
    first = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    first /= np.linalg.norm(first)
    points = np.column_stack([z[:, None] * SLOPE, z])
    points = points + radius[:, None] * (
        np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(axis, first)
    )
    points[np.cos(angle) > 0.6, 0] -= second_m * (rng.random((np.cos(angle) > 0.6).sum()) < 0.4)
    return np.asarray(points)


def pieces(points: Floats, spec: ScanSpec = ONE) -> list[Piece]:
    return pieces_of(points, [(1.3 * SLOPE[0], 1.3 * SLOPE[1], 0.0)], [0.13], spec)


@pytest.mark.parametrize("noise_m", [0.0005, 0.004, 0.008])
def test_the_reference_of_a_known_stem_is_its_diameter(noise_m: float) -> None:
    (piece,) = pieces(scan(noise_m=noise_m))
    assert piece.section.tape_m == pytest.approx(2.0 * RADIUS_M, abs=max(3.0 * piece.section.std_m, 0.0004))
    assert piece.section.std_m < 0.0015
    np.testing.assert_allclose(piece.section.slope, SLOPE, atol=0.005)
    np.testing.assert_allclose(piece.section.middle, [*(1.5 * SLOPE), 1.5], atol=0.002)


def test_the_standard_error_is_what_references_differ_by() -> None:
    found = [pieces(scan(noise_m=0.008, seed=seed))[0].section for seed in range(5)]
    spread = float(np.std([section.tape_m for section in found], ddof=1))
    assert 0.4 < spread / np.median([section.std_m for section in found]) < 1.8


def test_a_tape_spans_hollows_and_reads_the_girth() -> None:
    assert tape_of(np.full(BINS, 0.1)) == pytest.approx(0.2, rel=1e-4)
    assert tape_of(0.1 - 0.02 * (np.arange(BINS) == 5)) > 0.199
    oval = 0.1 * (1.0 + 0.05 * np.cos(2.0 * MIDDLES))
    fine = np.linspace(0.0, 2.0 * np.pi, 2000)
    outline = 0.1 * (1.0 + 0.05 * np.cos(2.0 * fine)) * np.array([np.cos(fine), np.sin(fine)])
    assert tape_of(oval) == pytest.approx(np.hypot(*np.diff(outline, axis=1)).sum() / np.pi, rel=1e-3)


def test_the_way_in_which_a_section_is_oval() -> None:
    (piece,) = pieces(scan(wave=0.05))
    assert piece.section.oval == pytest.approx(0.05, abs=0.004)  # along x, from where angles count


def test_two_walls_and_gaps_are_no_reference() -> None:
    assert pieces(scan(second_m=0.0))
    assert not pieces(scan(second_m=0.035))
    assert pieces(scan(gap_deg=40.0))
    assert not pieces(scan(gap_deg=100.0))
    (gap,) = pieces(scan(gap_deg=60.0, wave=0.04), replace(ONE, limits=SectionLimits(std_m=0.01)))
    (whole,) = pieces(scan(wave=0.04))
    assert gap.section.std_m > 2.0 * whole.section.std_m


def test_a_stem_is_lost_where_there_is_none() -> None:
    points = scan()
    assert find_layers(points, np.array([2.0, 2.0, 1.3]), 0.13, (0.3, 3.0)) is None
    layers = find_layers(points, np.array([0.08, -0.04, 1.3]), 0.13, (0.3, 3.0))
    assert layers is not None
    assert section_at(points, layers, 9.0, half_m=0.15) is None


def test_a_view_shows_the_side_it_faces() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 3600, endpoint=False)

    def shown(view: View) -> tuple[float, float]:
        """Degrees between the outermost points shown, and the share shown in their middle."""
        turned = angle[seen_by(view, angle, np.random.default_rng(3), (90.0, 90.0))]
        off = np.angle(np.exp(1j * turned) / np.exp(1j * turned).sum())
        return float(np.degrees(np.ptp(off))), float((np.abs(off) < 0.1).sum() / (3600 * 0.2 / (2.0 * np.pi)))

    for view in VIEWS:
        if not view.stations and view.sector_deg < 360.0:
            assert shown(view) == pytest.approx((view.sector_deg, 1.0), abs=0.5)
    assert seen_by(VIEWS[0], angle, np.random.default_rng(0), (90.0, 90.0)).all()
    # A station sees less than a half, two at a right angle three quarters.
    assert 150.0 < shown(View(name="", stations=1))[0] < 170.0
    assert 240.0 < shown(View(name="", stations=2))[0] < 260.0


def test_a_plot_of_pieces_has_their_diameters_at_breast_height() -> None:
    found = pieces(scan(), replace(ONE, heights_m=(1.5, 2.25), step_m=0.75))
    assert [piece.height_m for piece in found] == [1.5, 2.25]
    spec = ResampleSpec(trees=4, views=(View(name="seen 360"), View(name="seen 180", sector_deg=180.0)), shares=(0.5,))
    cloud = resample(1, found, spec)
    np.testing.assert_array_equal(cloud.points, resample(1, found, spec).points)
    assert [stem.tags for stem in cloud.stems] == 2 * [
        ("seen 360", "thinned to 50 %"),
        ("seen 180", "thinned to 50 %"),
    ]
    for stem in cloud.stems:
        assert isinstance(stem, ResampledTruth)
        own = cloud.points[cloud.owner == stem.tree_id - 1] - [stem.x_m, stem.y_m, 1.3]
        piece = next(p for p in found if p.height_m == stem.height_m)
        assert stem.dbh_cm == 100.0 * piece.section.tape_m
        assert len(own) == pytest.approx(0.5 * stem.seen_deg / 360.0 * len(piece.points), rel=0.1)
        offset, along = across(own, np.zeros(3), np.zeros(2))
        at_breast = np.hypot(*offset[np.abs(along) < 0.1].T)
        assert 200.0 * np.median(at_breast) == pytest.approx(stem.dbh_cm, abs=0.3)
    trees = analyse_plot(cloud.points).trees
    assert len(trees) == 4
    for tree in trees:
        stem = min(cloud.stems, key=lambda s: np.hypot(s.x_m - tree.x_m, s.y_m - tree.y_m))
        assert tree.dbh_cm == pytest.approx(stem.dbh_cm, abs=0.8)

"""A smooth taper through the diameters of a stem: what each tells of the others."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.trees.taper_curve import TaperSettings, smooth_taper

Floats = NDArray[np.float64]
HEIGHTS = np.arange(0.5, 5.1, 0.5)
DBH = 30.0


def straight(slope: float = -1.2) -> Floats:
    return DBH + slope * (HEIGHTS - 1.3)


def smooth(diameters: Floats, std: float | Floats, dbh_std: float = 0.3, dbh: float = DBH) -> tuple[Floats, Floats]:
    stds = np.broadcast_to(np.asarray(std, np.float64), len(diameters))
    return smooth_taper(HEIGHTS[: len(diameters)], diameters, stds, breast_height=(1.3, dbh, dbh_std))


def test_what_is_measured_well_stays() -> None:
    for slope in (-2.0, -0.5):
        diameters, stds = smooth(straight(slope), 0.02)
        np.testing.assert_allclose(diameters, straight(slope), atol=0.05)
        assert (stds < 0.06).all()


def test_an_error_that_all_heights_share_is_told_by_the_diameter_at_breast_height() -> None:
    diameters, stds = smooth(straight() + 2.0, 1.0)
    off = diameters - straight()
    # Near breast height most of it goes; nothing tells what is right far above.
    assert 0.0 < off[1] < 0.4
    assert 0.0 < off[2] < 0.4
    assert 0.7 < off[-1] < 2.0
    assert (np.diff(stds[2:]) > 0).all()
    assert stds[1] < 0.6 < stds[-1]


def test_an_outlier_counts_little_where_the_others_agree() -> None:
    bent = straight()
    bent[5] += 4.0
    diameters, _ = smooth(bent, 0.3)
    assert diameters[5] - straight()[5] < 1.0
    np.testing.assert_allclose(np.delete(diameters, [4, 5, 6]), np.delete(straight(), [4, 5, 6]), atol=0.35)


def test_the_butt_may_swell() -> None:
    swollen, stds = straight(), np.full(len(HEIGHTS), 0.6)
    swollen[0] += 3.0
    with_swell, without = (
        smooth_taper(HEIGHTS, swollen, stds, breast_height=(1.3, DBH, 0.3), settings=TaperSettings(foot=foot))[0]
        for foot in (TaperSettings().foot, 0.0)
    )
    np.testing.assert_array_equal(with_swell, smooth(swollen, 0.6)[0])
    assert with_swell[0] - straight()[0] > 1.5
    assert with_swell[1] - straight()[1] < 0.6
    # As a mere bend it would be spread over the heights above.
    assert with_swell[0] > without[0] + 0.2


def test_one_height_or_none() -> None:
    diameters, stds = smooth(np.array([34.0]), 1.0)
    assert 30.5 < diameters[0] < 34.0
    assert stds[0] < 1.6
    assert [len(part) for part in smooth(np.zeros(0), 1.0)] == [0, 0]


@given(
    st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=10),
    st.floats(0.1, 3.0),
    st.floats(0.2, 5.0),
)
def test_all_diameters_scale_together(off: list[float], std: float, scale: float) -> None:
    rows = straight()[: len(off)] + np.array(off)
    diameters, stds = smooth(rows, std)
    larger, wider = smooth(scale * rows, scale * std, scale * 0.3, scale * DBH)
    np.testing.assert_allclose(larger, scale * diameters, rtol=1e-6)
    np.testing.assert_allclose(wider, scale * stds, rtol=1e-5)


def test_intervals_hold_for_stems_of_its_kind() -> None:
    rng = np.random.default_rng(4)
    inside, plain, better = [], [], []
    for _ in range(200):
        bends = np.cumsum(np.cumsum(rng.normal(0.0, 0.1 * np.sqrt(0.5) * DBH, len(HEIGHTS)) * 0.5))
        true = DBH + rng.normal(-1.2, 1.2) * (HEIGHTS - 1.3) + bends + rng.normal(0.0, 0.15, len(HEIGHTS))
        true += DBH - np.interp(1.3, HEIGHTS, true)
        std = 0.6
        error = 1.6 * std * (np.sqrt(0.3) * rng.normal() + np.sqrt(0.7) * rng.normal(size=len(HEIGHTS)))
        diameters, stds = smooth(true + error, std, dbh=DBH + rng.normal(0.0, 0.3))
        inside.append(np.abs(diameters - true) <= 1.96 * stds)
        plain.append(error)
        better.append(diameters - true)
    assert 0.9 < np.mean(inside) < 0.99
    assert np.std(better) < 0.8 * np.std(plain)

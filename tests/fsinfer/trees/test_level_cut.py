"""Heights where a cloud was cut off level in the crowns."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.notices.stems import StemCode
from fsinfer.trees import analyse_plot

HEIGHTS_M = (12.0, 13.1, 14.4, 12.6, 13.7)
PLACES = ((-4.0, -4.0), (4.0, -4.0), (0.0, 0.0), (-4.0, 4.0), (4.0, 4.0))


def stand(heights_m: tuple[float, ...] = HEIGHTS_M) -> NDArray[np.float64]:
    """Trees with round crowns on level ground, as high as they are said to be."""
    rng = np.random.default_rng(3)
    parts = [np.column_stack([rng.uniform(-7, 7, (80_000, 2)), rng.normal(0, 0.005, 80_000)])]
    for (x, y), height in zip(PLACES, heights_m, strict=False):
        angle, z = rng.uniform(0, 2 * np.pi, 30_000), rng.uniform(0, height - 3.0, 30_000)
        radius = 0.12 - 0.008 * z + rng.normal(0, 0.003, 30_000)
        parts.append(np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle), z]))
        ball = rng.normal(size=(9_000, 3))
        ball *= (np.cbrt(rng.uniform(0, 1, 9_000)) / np.linalg.norm(ball, axis=1))[:, None]
        parts.append(np.array([x, y, height - 3.5]) + ball * [2.0, 2.0, 3.5])
    return np.concatenate(parts)


def test_heights_of_a_cloud_that_was_cut_are_not_those_of_its_trees() -> None:
    """Two real scans cut at 12 m gave 9 of 14 and 15 of 17 trees as 11 to 13 m high, without a word."""
    points = stand()
    whole = analyse_plot(points)
    assert sorted(tree.height_m or 0.0 for tree in whole.trees) == pytest.approx(sorted(HEIGHTS_M), abs=0.1)
    assert StemCode.cut_off_level not in {told.code for told in whole.warnings}
    cut = analyse_plot(points[points[:, 2] < 10.5])
    assert [tree.height_m for tree in cut.trees] == [None] * 5
    (told,) = (warning for warning in cut.warnings if warning.code == StemCode.cut_off_level)
    assert told.values["stems"] in (3, 4, 5)
    assert sorted(tree.dbh_cm or 0.0 for tree in cut.trees) == pytest.approx(
        sorted(tree.dbh_cm or 0.0 for tree in whole.trees), abs=0.05
    )


def test_trees_below_the_cut_keep_their_heights() -> None:
    points = stand((9.0, 14.0, 14.0, 14.0, 14.0))
    cut = analyse_plot(points[points[:, 2] < 11.0])
    assert [tree.height_m for tree in cut.trees if tree.height_m] == pytest.approx([9.0], abs=0.1)


def test_trees_of_the_same_height_are_not_cut() -> None:
    """Their crowns end at one level as well, but thin out towards it."""
    alike = analyse_plot(stand((13.0,) * 5))
    assert [tree.height_m for tree in alike.trees] == pytest.approx([13.0] * 5, abs=0.1)

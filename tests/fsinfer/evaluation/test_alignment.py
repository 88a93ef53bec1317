"""Two stem maps that have nothing to do with each other are not laid on each other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.cli.tables import evaluation_rows
from fsinfer.evaluation.alignment import AlignmentDoubt, align_maps
from fsinfer.evaluation.measured import MeasuredTree
from fsinfer.evaluation.metrics import evaluate


def plot(count: int, seed: int) -> NDArray[np.float64]:
    return np.random.default_rng([61, seed]).uniform(0, 20, (count, 2))


def trees(xy: NDArray[np.float64]) -> list[MeasuredTree]:
    return [MeasuredTree(tree_id=str(n), x_m=x, y_m=y, dbh_cm=20.0 + n) for n, (x, y) in enumerate(xy)]


@pytest.mark.parametrize("seed", range(6))
def test_other_trees_match_by_chance_alone(seed: int) -> None:
    found = align_maps(plot(30, 2 * seed), plot(35, 2 * seed + 1) + 900.0, 0.5, "auto")
    assert (found.motion, found.links) == (None, [])
    assert found.doubt in (AlignmentDoubt.chance, AlignmentDoubt.none)
    # Who asks for it gets it, and is told.
    forced = align_maps(plot(30, 2 * seed), plot(35, 2 * seed + 1) + 900.0, 0.5, "always")
    assert forced.motion is not None
    assert forced.doubt == AlignmentDoubt.chance


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("count", [5, 12, 35])
def test_the_same_trees_in_another_frame_are_laid_on_each_other(count: int, seed: int) -> None:
    xy = plot(count, seed)
    turned = xy @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + np.array([300.0, -80.0])
    turned += np.random.default_rng(seed).normal(0, 0.05, turned.shape)
    found = align_maps(xy, turned, 0.5, "auto")
    assert len(found.links) == count
    # Five trees within half a metre may lie on their mirror image as well.
    assert found.doubt == AlignmentDoubt.none or (count == 5 and found.doubt == AlignmentDoubt.symmetric)
    # A fifth was missed, and as many stand there that nobody measured.
    extra = plot(count // 5, seed + 50) + np.array([300.0, -80.0])
    found = align_maps(xy, np.concatenate([turned[count // 5 :], extra]), 0.5, "auto")
    assert len(found.links) >= count - count // 5


@pytest.mark.parametrize(("away", "limit"), [(40.0, 0.5), (0.0, 5.0)])
@pytest.mark.parametrize("seed", range(4))
def test_interchanged_axes_are_told(seed: int, away: float, limit: float) -> None:
    xy = plot(20, seed)
    found = evaluate(trees(xy), trees(xy[:, ::-1] + away), max_distance_m=limit)
    assert (found.alignment_doubt, found.measured_from_extracted) == ("mirrored", None)
    assert any("x_m (east) and y_m (north) interchanged" in row for row in evaluation_rows(found))


@pytest.mark.parametrize("limit", [0.5, 1.0, 2.0, 5.0, 10.0])
@pytest.mark.parametrize("seed", range(3))
def test_within_a_wide_distance_that_has_partners_in_any_frame_the_maps_are_still_laid_on_each_other(
    seed: int, limit: float
) -> None:
    xy = plot(14, seed) / 2.0
    middle = xy.mean(axis=0)
    turned = (xy - middle) @ np.array([[0.5, -(0.75**0.5)], [0.75**0.5, 0.5]]) + middle + 0.3
    found = align_maps(xy, np.concatenate([turned, plot(6, seed + 40) - 4.0]), limit, "auto")
    assert found.motion is not None
    assert found.motion["rotation_deg"] == pytest.approx(60.0, abs=1e-6)
    assert [(i, i) for i in range(14)] == sorted(found.links)
    assert found.doubt == AlignmentDoubt.none


@pytest.mark.parametrize("seed", range(4))
def test_places_paced_out_in_another_frame_are_laid_on_each_other_within_a_wide_distance(seed: int) -> None:
    """Each is off by half a metre either way; as given most trees have a partner, but metres away."""
    xy = 2.0 * plot(30, seed)
    middle, turn = xy.mean(axis=0), np.radians(12.0)
    cosine, sine = np.cos(turn), np.sin(turn)
    turned = (xy - middle) @ np.array([[cosine, -sine], [sine, cosine]]) + middle
    found = align_maps(xy, turned + np.random.default_rng(seed).normal(0, 0.5, xy.shape), 4.0, "auto")
    assert found.motion is not None
    assert found.motion["rotation_deg"] == pytest.approx(12.0, abs=2.0)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("seed", range(3))
def test_maps_of_one_frame_are_left_as_they_are_within_a_wide_distance(seed: int, noise: float) -> None:
    xy = plot(15, seed)
    found = xy[2:] + np.random.default_rng(seed).normal(0, noise, (13, 2))
    assert align_maps(xy, found, 3.0, "auto").motion is None


def test_a_row_of_trees_is_laid_on_itself_and_told_to_be_symmetric() -> None:
    row = np.column_stack([np.cumsum([0.0, 3.0, 4.1, 2.7, 5.2, 3.3]), np.zeros(6)])
    turned = row @ np.array([[0.6, 0.8], [-0.8, 0.6]]) + 70.0
    found = evaluate(trees(row), trees(turned))
    assert (found.matched, found.alignment_doubt) == (6, "symmetric")
    assert any("the mirror image fits as well" in line for line in evaluation_rows(found))
    # Of one frame there is nothing to doubt, whatever is asked for.
    assert evaluate(trees(row), trees(row), align="always").alignment_doubt == ""


def test_a_doubt_is_said_in_the_table() -> None:
    found = evaluate(trees(plot(30, 0)), trees(plot(35, 1) + 900.0), align="always")
    assert found.alignment_doubt == "chance"
    assert any("no motion lays the two maps on each other better than chance" in row for row in evaluation_rows(found))
    assert evaluate(trees(plot(9, 3)), trees(plot(9, 3))).alignment_doubt == ""

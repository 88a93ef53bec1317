"""Heights where a cloud was cut off level in the crowns."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.notices.stems import StemCode
from fsinfer.trees import analyse_plot
from fsinfer.trees.edit_rows import TreeEdit
from fsinfer.trees.edits import apply_edits
from fsinfer.trees.settings import TreeSettings

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
    points = stand((12.0, 13.1, 9.0, 12.6, 13.7))
    cut = analyse_plot(points[points[:, 2] < 10.8])
    assert StemCode.cut_off_level in {told.code for told in cut.warnings}
    assert [tree.height_m for tree in cut.trees if tree.height_m] == pytest.approx([9.0], abs=0.1)


def test_trees_of_the_same_height_are_not_cut() -> None:
    """Their crowns end at one level as well, but thin out towards it."""
    alike = analyse_plot(stand((13.0,) * 5))
    assert [tree.height_m for tree in alike.trees] == pytest.approx([13.0] * 5, abs=0.1)


@pytest.mark.parametrize("how", ["added", "merged"])
def test_a_tree_that_is_measured_by_hand_has_no_height_of_a_cut_either(how: str) -> None:
    """A tree that was deleted and added anew had the height of the cut, beside the warning that it is not given."""
    points = stand()
    cut = points[points[:, 2] < 10.5]
    found = analyse_plot(cut)
    tree = found.trees[0]
    first = TreeEdit(row=2, action="delete", tree_id=tree.tree_id)
    again = TreeEdit(row=3, action="add", tree_id=tree.tree_id, x_m=tree.x_m, y_m=tree.y_m)
    edits = [first, again]
    if how == "merged":
        beside = TreeEdit(row=2, action="add", x_m=tree.x_m + 0.3, y_m=tree.y_m)
        number = max(other.tree_id for other in found.trees) + 1
        edits = [beside, TreeEdit(row=3, action="merge", tree_id=tree.tree_id, other_id=number)]
    edited = apply_edits(found, cut, edits, settings=TreeSettings())
    by_hand = next(other for other in edited.trees if other.tree_id == tree.tree_id)
    assert by_hand.dbh_cm == pytest.approx(tree.dbh_cm, abs=0.05)
    assert [other.height_m for other in edited.trees] == [None] * 5


def test_a_low_tree_that_is_added_below_a_cut_has_its_height() -> None:
    points = stand((12.0, 13.1, 9.0, 12.6, 13.7))
    cut = points[points[:, 2] < 10.8]
    found = analyse_plot(cut)
    low = next(tree for tree in found.trees if tree.height_m)
    edits = [
        TreeEdit(row=2, action="delete", tree_id=low.tree_id),
        TreeEdit(row=3, action="add", x_m=low.x_m, y_m=low.y_m),
    ]
    edited = apply_edits(found, cut, edits, settings=TreeSettings())
    assert [tree.height_m for tree in edited.trees if tree.height_m] == pytest.approx([9.0], abs=0.1)


def test_a_cloud_that_goes_on_above_was_not_cut() -> None:
    """Stems of one crown have one height, which was taken away where thick trees stood whose tops were not seen."""
    rng = np.random.default_rng(3)
    parts = [np.column_stack([rng.uniform(-9, 9, (120_000, 2)), rng.normal(0, 0.005, 120_000)])]

    def add_stem(x: float, y: float, height: float, radius_m: float) -> None:
        angle, z = rng.uniform(0, 2 * np.pi, 20_000), rng.uniform(0, height, 20_000)
        radius = radius_m * (1.0 - 0.03 * z) + rng.normal(0, 0.003, 20_000)
        parts.append(np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle), z]))

    for x, y, seen_to in ((-5.0, -5.0, 16.45), (5.0, -5.0, 17.45), (-5.0, 5.0, 15.95), (5.0, 5.0, 18.45)):
        add_stem(x, y, 15.0, 0.3)
        angle, far = rng.uniform(0, 2 * np.pi, 30_000), 2.5 * np.sqrt(rng.uniform(0, 1, 30_000))
        z = rng.uniform(9, seen_to, 30_000)
        parts.append(np.column_stack([x + far * np.cos(angle), y + far * np.sin(angle), z]))
    for x, y in ((0.35, 0.0), (-0.18, 0.3), (-0.18, -0.3)):
        add_stem(x, y, 10.0, 0.08)
    ball = rng.normal(size=(9_000, 3))
    ball *= (np.cbrt(rng.uniform(0, 1, 9_000)) / np.linalg.norm(ball, axis=1))[:, None]
    parts.append(np.array([0.0, 0.0, 9.5]) + ball * [2.0, 2.0, 3.5])
    result = analyse_plot(np.concatenate(parts))
    assert [tree.height_m for tree in result.trees if tree.height_m] == pytest.approx([12.9] * 3, abs=0.1)
    assert StemCode.cut_off_level not in {told.code for told in result.warnings}

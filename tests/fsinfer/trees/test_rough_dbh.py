"""What a stem without a DBH says of its size, and when too much rests on those that say nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.notices.notice import Notice, notice, notice_json, notice_of_json
from fsinfer.notices.sentences import joined, sentence
from fsinfer.notices.stems import StemCode
from fsinfer.trees.measure import analyse_plot
from fsinfer.trees.rough_dbh import rough_dbh_cm, rough_of_text
from fsinfer.trees.stand import SeenCells, sizes_unknown, stand_table
from fsinfer.trees.tree import Tree
from fsinfer.workflow.tree_stage import _sizes_unknown
from tests.support.stem_clouds import stem_plot
from tests.support.stem_maps import tree_of


def tree(number: int, dbh_cm: float | None, *reasons: Notice) -> Tree:
    return replace(tree_of(number, (0.0, 0.0, 0.0), dbh_cm), reasons=reasons)


def uncertain(dbh_cm: float, half_width_cm: float) -> Notice:
    return notice(StemCode.too_uncertain, dbh_cm=dbh_cm, half_width_cm=half_width_cm)


@pytest.mark.parametrize(
    ("reasons", "expected"),
    [
        ((uncertain(6.2, 1.8),), (6.0, 2.0 / 1.96)),
        ((notice(StemCode.double_wall, gap_cm=3.0), uncertain(8.0, 4.0)), (8.0, 4.0 / 1.96)),
        ((uncertain(7.0, 3.92),), (7.0, 4.0 / 1.96)),
        ((uncertain(30.0, 15.0),), (30.0, 15.0 / 1.96)),
        ((uncertain(5.0, 6.0),), None),
        ((uncertain(30.0, 16.0),), None),
        ((uncertain(47.0, 47.0),), None),
        ((notice(StemCode.too_few_on_bark, points=9),), None),
        ((), None),
    ],
)
def test_a_size_is_told_where_it_is_known_at_all(
    reasons: tuple[Notice, ...], expected: tuple[float, float] | None
) -> None:
    assert rough_dbh_cm(tree(1, None, *reasons)) == (None if expected is None else pytest.approx(expected, rel=1e-3))
    assert rough_dbh_cm(tree(1, 20.0, *reasons)) is None


def test_a_table_tells_the_same_as_the_measurement() -> None:
    """Sentences come back as they were written."""
    written = notice(StemCode.as_written, text=f"{sentence(uncertain(6.0, 2.0))}; wide interval (+- 2.0 cm)")
    assert rough_dbh_cm(tree(1, None, written)) == rough_dbh_cm(tree(1, None, uncertain(6.0, 2.0)))
    assert rough_dbh_cm(tree(1, None, notice(StemCode.as_written, text="double wall"))) is None


@pytest.mark.parametrize("code", [StemCode.edges_unsupported, StemCode.edges_unsure, StemCode.edges_ragged])
def test_edges_that_are_no_measurement_leave_what_the_points_say(code: StemCode) -> None:
    """The run counted such a sapling as a mean tree, and the report, by the same sentence, as a sapling."""
    edges = notice(code, photos=9, edges_cm=7.0, refused=uncertain(7.0, 3.0))
    known = rough_dbh_cm(tree(1, None, uncertain(7.0, 3.0)))
    assert known is not None
    assert rough_dbh_cm(tree(1, None, edges)) == known
    assert rough_dbh_cm(tree(1, None, notice_of_json(notice_json(edges)))) == known
    assert rough_dbh_cm(tree(1, None, notice(StemCode.as_written, text=sentence(edges)))) == known
    assert sizes_unknown([tree(1, 20.0), tree(2, 20.0), tree(3, None, edges)]) == ()


@pytest.mark.parametrize("code", [StemCode.edges_unsure, StemCode.edges_ragged])
def test_edges_that_may_be_of_twigs_tell_no_size(code: StemCode) -> None:
    refused = notice(StemCode.too_few_on_bark, points=9)
    assert rough_dbh_cm(tree(1, None, notice(code, photos=9, edges_cm=7.0, refused=refused))) is None


@pytest.mark.parametrize("refused", [notice(StemCode.too_few_on_bark, points=9), uncertain(52.0, 60.0)])
def test_where_the_points_say_nothing_a_width_does(refused: Notice) -> None:
    """A sapling of 2 cm whose twigs have edges 43 cm apart counted as a mean tree; a tree 15 m away has edges."""
    sure, unsure = (
        notice(code, photos=photos, edges_cm=42.8, refused=refused)
        for code, photos in ((StemCode.edges_unsupported, 1), (StemCode.edges_unsure, 13))
    )
    below = notice(StemCode.stands_across, across_cm=8.2)
    for reasons, expected in (
        ((sure,), (43.0, 21.5)),
        ((unsure,), None),
        ((unsure, below), (8.0, 8.0)),
        ((refused, below), (8.0, 8.0)),
        ((uncertain(6.0, 2.0), below), (6.0, 2.0 / 1.96)),
    ):
        known = None if expected is None else pytest.approx(expected, rel=1e-3)
        assert rough_dbh_cm(tree(1, None, *reasons)) == known
        assert rough_dbh_cm(tree(1, None, *(notice_of_json(notice_json(reason)) for reason in reasons))) == known
        assert rough_of_text(joined(reasons)) == known
        written = notice(StemCode.as_written, text=joined(reasons))
        assert rough_dbh_cm(tree(1, None, written)) == known
    assert rough_dbh_cm(tree(1, None, notice(StemCode.stands_across, across_cm=0.4))) is None
    thick = [tree(1, 40.0), tree(2, 40.0)]
    basal = stand_table([*thick, tree(3, None, unsure, below)], 1e4).basal_area_m2_per_ha
    assert basal == pytest.approx((2.0 + (8 / 40) ** 2) * np.pi / 4 * 0.16)
    assert sizes_unknown([*thick, tree(3, None, unsure, below)]) == ()
    # What a figure rests on without a measurement is told where it is much.
    for reasons in ((unsure,), (sure,)):
        (told,) = sizes_unknown([*thick, tree(3, None, *reasons)])
        assert told.values["trees"] == ("3",)


def test_a_sapling_is_no_mean_tree_in_the_stand() -> None:
    trees = [tree(1, 40.0), tree(2, 40.0), tree(3, None, uncertain(6.0, 2.0))]
    section = 3.14159265 / 4 * 0.16
    basal = stand_table(trees, 1e4).basal_area_m2_per_ha
    assert basal == pytest.approx(2 * section + section * (6 / 40) ** 2)
    assert stand_table([*trees[:2], tree(3, None)], 1e4).basal_area_m2_per_ha == pytest.approx(3 * section)


def test_a_tenth_of_the_basal_area_by_nothing_known_is_told() -> None:
    measured = [tree(n, 30.0) for n in range(9)]
    (told,) = sizes_unknown([*measured, tree(20, None, uncertain(50.0, 60.0))])
    assert told.values["percent"] == pytest.approx(10.0)
    assert "of the basal area 10 % are taken to be that of stems without a diameter" in sentence(told)
    assert "without a diameter (20), by a width or the mean section" in sentence(told)
    # Of those that are roughly known nothing is unsaid, and one is no mean.
    assert sizes_unknown([*measured, tree(20, None, uncertain(8.0, 2.0))]) == ()
    assert sizes_unknown([*measured, tree(21, 30.0), tree(22, None)]) == ()
    assert sizes_unknown([measured[0], tree(24, None)]) == ()


def test_only_what_a_figure_a_hectare_counts_is_told() -> None:
    """Stems off the ground that was seen are in no figure, and without a figure nothing is too large."""
    found = analyse_plot(stem_plot(seed=1, trees=4, spacing_m=0.03, top_m=3.5).points)
    found = replace(found, trees=(*found.trees[:3], replace(found.trees[3], dbh_cm=None, reasons=())))
    assert [told.code for told in _sizes_unknown(found, None)] == [StemCode.sizes_unknown]
    nowhere = SeenCells(seen=np.zeros((2, 2), dtype=bool), corner=np.zeros(2))
    assert _sizes_unknown(replace(found, seen_ground=nowhere), None) == ()
    assert _sizes_unknown(replace(found, plot_area_m2=0.0), None) == ()


def test_what_is_told_of_a_figure_is_its_own_share() -> None:
    """Measured stems off the ground that was seen stand for those of unknown size on it, in the figure."""
    on_ground, off = [tree(1, 10.0), tree(2, None)], [tree(3, 50.0), tree(4, 50.0), tree(5, 50.0)]
    stand = stand_table([*on_ground, *off], 100.0, on_area=np.array([True, True, False, False, False]))
    of_known = np.pi / 4 * 0.1**2 / 0.01
    basal = stand.basal_area_m2_per_ha
    assert basal is not None
    (told,) = sizes_unknown([*on_ground, *off], stand.off_area)
    assert told.values["percent"] == pytest.approx(100.0 * (1.0 - of_known / basal))
    assert told.values["trees"] == ("2",)
    assert sizes_unknown([on_ground[0], *off, tree(6, None)], (*stand.off_area, 6)) == ()

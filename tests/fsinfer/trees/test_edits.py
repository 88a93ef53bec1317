"""A stem map corrected by hand: what each action does, that other trees stay, and what is told when a row is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from fsinfer.errors import InputError
from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.trees import TreeSettings, analyse_plot
from fsinfer.trees.edit_rows import TreeEdit, find_edits, read_edits
from fsinfer.trees.edits import apply_edits
from fsinfer.trees.measure import PlotResult
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.tree import Tree
from tests.support.stem_clouds import StemPlot, stem_plot, wall

SETTINGS = TreeSettings()
# As in a national grid: far from the origin.
MOVED = np.array([420_000.0, 5_300_000.0, 0.0])


@pytest.fixture(scope="module")
def plot() -> StemPlot:
    return stem_plot(seed=4, trees=4, spacing_m=0.02)


@pytest.fixture(scope="module")
def result(plot: StemPlot) -> PlotResult:
    found = analyse_plot(plot.points, settings=SETTINGS)
    assert len(found.trees) == 4
    return found


def edits_of(tmp_path: Path, text: str) -> tuple[TreeEdit, ...]:
    path = tmp_path / "edits.csv"
    path.write_text(text, encoding="utf-8")
    return read_edits(path)


def extent_moved(result: PlotResult, moved: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """The extent of a plot's cloud after it was moved."""
    x_min, y_min, x_max, y_max = (np.array(result.extent_m) + np.tile(moved[:2], 2)).tolist()
    return x_min, y_min, x_max, y_max


def found_at(result: PlotResult, x_m: float, y_m: float) -> int:
    """Which of the trees stands nearest to a place."""
    return int(np.argmin([np.hypot(tree.x_m - x_m, tree.y_m - y_m) for tree in result.trees]))


def test_a_deleted_tree_is_gone_and_the_others_keep_their_numbers(plot: StemPlot, result: PlotResult) -> None:
    edited = apply_edits(result, plot.points, [TreeEdit(action="delete", row=2, tree_id=2)], settings=SETTINGS)
    assert edited.trees == tuple(tree for tree in result.trees if tree.tree_id != 2)
    assert len(edited.sections) == 3
    deleted = notice(StemCode.corrected_by_hand, changes=(notice(StemCode.tree_deleted, tree_id=2),))
    assert edited.warnings[-1] == deleted
    assert sentence(deleted) == "stem map corrected by hand: tree 2 deleted"
    assert edited.diagnosis == notice(StemCode.trees_corrected, trees=3, measured=3)


@pytest.mark.parametrize("moved", [np.zeros(3), MOVED])
def test_a_tree_the_search_missed_is_measured_where_it_was_set(
    plot: StemPlot, result: PlotResult, moved: NDArray[np.float64]
) -> None:
    missing, ground = result.trees[1], result.ground
    assert ground is not None
    rest = replace(
        result,
        trees=tuple(replace(t, x_m=t.x_m + moved[0], y_m=t.y_m + moved[1]) for t in result.trees if t != missing),
        sections=tuple(s for t, s in zip(result.trees, result.sections, strict=True) if t != missing),
        ground=ground.moved(moved[:2]),
        extent_m=extent_moved(result, moved),
    )
    add = TreeEdit(action="add", row=2, x_m=missing.x_m + 0.2 + moved[0], y_m=missing.y_m - 0.1 + moved[1])
    edited = apply_edits(rest, plot.points + moved, [add], settings=SETTINGS)
    assert edited.trees[:-1] == rest.trees
    tree = edited.trees[-1]
    assert tree.tree_id == 5
    assert tree.reasons[0] == notice(StemCode.added_by_hand)
    assert np.hypot(tree.x_m - missing.x_m - moved[0], tree.y_m - missing.y_m - moved[1]) < 0.01
    assert tree.dbh_cm == pytest.approx(missing.dbh_cm, abs=0.5)
    assert tree.z_ground_m == pytest.approx(missing.z_ground_m, abs=0.03)


def test_a_tree_set_where_nothing_is_seen_has_a_place_and_no_diameter(plot: StemPlot, result: PlotResult) -> None:
    edits = [TreeEdit(action="add", row=2, x_m=50.0, y_m=50.0), TreeEdit(action="add", row=3, tree_id=9, x_m=51, y_m=5)]
    edited = apply_edits(result, plot.points, edits, settings=SETTINGS)
    assert [tree.tree_id for tree in edited.trees] == [1, 2, 3, 4, 9, 10]
    assert [(tree.status, tree.dbh_cm) for tree in edited.trees[4:]] == [("unmeasured", None)] * 2
    assert (edited.trees[5].x_m, edited.trees[5].y_m) == (50.0, 50.0)
    assert edited.trees[5].reasons == (notice(StemCode.added_by_hand), notice(StemCode.no_stem_here))
    assert sentence(edited.warnings[-1]) == "stem map corrected by hand: tree 10 added, 9 added"


def test_the_doubt_about_the_ground_is_that_of_the_place() -> None:
    """The ground is seen at one end of the plot; a stem at the other was +- 0.3 cm, though nobody knows its foot."""
    rng, places = np.random.default_rng(5), [(2.0, 2.0), (2.0, 5.0), (14.0, 14.0), (12.0, 16.0)]
    stems = [wall(rng, radius=0.15, spacing_m=0.015, taper=-0.012) + np.array([x, y, 0.0]) for x, y in places]
    floor = np.column_stack([rng.uniform(0.0, 8.0, (40_000, 2)), np.zeros(40_000)])
    points = np.concatenate([*stems, floor])
    points += rng.normal(0.0, 0.003, points.shape)
    found = analyse_plot(points, settings=SETTINGS)
    for tree in found.trees:
        delete = TreeEdit(action="delete", row=2, tree_id=tree.tree_id)
        add = TreeEdit(action="add", row=3, tree_id=tree.tree_id, x_m=tree.x_m, y_m=tree.y_m)
        edited = apply_edits(found, points, [delete, add], settings=SETTINGS)
        (again,) = (other for other in edited.trees if other.tree_id == tree.tree_id)
        assert again.half95_cm == pytest.approx(tree.half95_cm, rel=0.05)
        assert again.status == tree.status
        assert [why.code for why in again.reasons[1:]] == [why.code for why in tree.reasons]
    assert [tree.half95_cm > 1.0 for tree in sorted(found.trees, key=lambda tree: tree.x_m)] == [False] * 2 + [True] * 2


def test_what_is_usual_in_the_plot_tells_of_a_tree_that_is_added() -> None:
    """Half a stem among oval ones had its interval without what they tell of its hidden side, a fifth too narrow."""
    rng, places = np.random.default_rng(7), [(2.5 * i, 2.5 * j) for i in range(3) for j in range(3)]
    floor = np.column_stack([rng.uniform(-2.0, 7.0, (40_000, 2)), rng.normal(0.0, 0.005, 40_000)])
    parts = [floor]
    for number, (x, y) in enumerate(places):
        arc_deg, std = 170.0 if number == 4 else 360.0, 0.012 if number == 7 else 0.003
        stem = wall(rng, radius=0.16, spacing_m=0.015, ovality=0.055, arc_deg=arc_deg)
        parts.append(stem + np.array([x, y, 0.0]) + rng.normal(0.0, std, stem.shape))
    points = np.concatenate(parts)
    found = analyse_plot(points, settings=SETTINGS)
    half, rough = (found.trees[found_at(found, *places[number])] for number in (4, 7))
    assert found.sections[found.trees.index(half)].parts_m["shape"] > 0.003
    assert StemCode.rougher_than_others in [why.code for why in rough.reasons]
    for tree in (half, rough):
        delete = TreeEdit(action="delete", row=2, tree_id=tree.tree_id)
        add = TreeEdit(action="add", row=3, tree_id=tree.tree_id, x_m=tree.x_m, y_m=tree.y_m)
        edited = apply_edits(found, points, [delete, add], settings=SETTINGS)
        again = edited.trees[found_at(edited, tree.x_m, tree.y_m)]
        assert again.half95_cm == pytest.approx(tree.half95_cm, rel=0.05)
        assert [why.code for why in again.reasons[1:]] == [why.code for why in tree.reasons]
        # The others have theirs once.
        assert set(edited.trees) - {again} == set(found.trees) - {tree}


def tall(rng: np.random.Generator, x: float, y: float, dbh_m: float, top_m: float, lean: float) -> NDArray[np.float64]:
    """A tree of ``top_m`` metres whose axis moves ``lean`` metres along x a metre of height, with a pointed crown."""
    stem = wall(rng, radius=dbh_m / 2, spacing_m=0.02, taper=-dbh_m / 2 / top_m, top_m=0.95 * top_m)
    share, turn = rng.uniform(0.0, 1.0, 5000), rng.uniform(0.0, 2.0 * np.pi, 5000)
    reach = 1.4 * np.sqrt(share * rng.uniform(0.0, 1.0, 5000))
    crown = np.column_stack([reach * np.cos(turn), reach * np.sin(turn), top_m * (1.0 - 0.5 * share)])
    points = np.concatenate([stem, crown])
    points[:, 0] += lean * points[:, 2]
    moved: NDArray[np.float64] = points + np.array([x, y, 0.0]) + rng.normal(0.0, 0.003, points.shape)
    return moved


@pytest.fixture(scope="module")
def wood() -> NDArray[np.float64]:
    """A slope with a pair that touches, a thin tree under a tall one, and two that lean, by 13 and by 31 degrees."""
    rng = np.random.default_rng(11)
    trees = [
        (2.0, 2.0, 0.3, 14.0, 0.0), (2.255, 2.0, 0.2, 12.0, 0.0), (6.0, 2.0, 0.22, 16.0, -0.1),
        (6.9, 2.1, 0.12, 8.0, 0.0), (3.0, 6.0, 0.25, 17.0, 0.22), (7.0, 6.5, 0.2, 4.0, 0.6),
    ]  # fmt: skip
    floor = np.column_stack([rng.uniform(-1.0, 10.0, (60_000, 2)), rng.normal(0.0, 0.005, 60_000)])
    points = np.concatenate([*(tall(rng, *tree) for tree in trees), floor])
    points[:, 2] += 0.3 * points[:, 0]
    return points


def added(tree: Tree) -> TreeEdit:
    return TreeEdit(action="add", row=3, tree_id=tree.tree_id, x_m=tree.x_m, y_m=tree.y_m)


def test_trees_that_are_deleted_and_added_again_are_as_they_were_found(wood: NDArray[np.float64]) -> None:
    """Measured as if nothing stood beside it, a tree of 8 m under one of 16 was 10 m high.

    The stem is the one that the search had found, and so are its neighbours; the origin is another, which rounds
    otherwise, so that a point more or less belongs to a slice, and blocks of bark are others: that tells in the
    interval.
    """
    found = analyse_plot(wood, settings=SETTINGS)
    assert len(found.trees) == 6
    assert sum(tree.height_m is not None for tree in found.trees) >= 4
    deleted = [TreeEdit(action="delete", row=2, tree_id=tree.tree_id) for tree in found.trees]
    for edits in (
        *((delete, added(tree)) for delete, tree in zip(deleted, found.trees, strict=True)),
        # All of them, in another order.
        (*deleted, *map(added, reversed(found.trees))),
    ):
        edited = apply_edits(found, wood, edits, settings=SETTINGS)
        for again, tree in zip(edited.trees, found.trees, strict=True):
            assert again.dbh_cm == pytest.approx(tree.dbh_cm, abs=0.02)
            assert again.half95_cm == pytest.approx(tree.half95_cm, rel=0.05)
            assert again.height_m == pytest.approx(tree.height_m, abs=0.02)
            assert again.z_ground_m == pytest.approx(tree.z_ground_m, abs=0.001)
            assert again.status == tree.status


def test_a_stem_that_is_no_tree_hides_its_part_of_a_tree_that_is_added_again() -> None:
    """Too thin for the table, it stands before the bark of a thick one as before."""
    rng = np.random.default_rng(5)
    floor = np.column_stack([rng.uniform(-2.0, 4.0, (30_000, 2)), rng.normal(0.0, 0.005, 30_000)])
    thick = wall(rng, radius=0.15, spacing_m=0.015, top_m=4.0)
    thin = wall(rng, radius=0.06, spacing_m=0.01, top_m=4.0) + np.array([0.26, 0.0, 0.0])
    points = np.concatenate([thick, thin, floor])
    settings = replace(SETTINGS, min_dbh_cm=15.0)
    found = analyse_plot(points, settings=settings)
    (tree,) = found.trees
    assert len(found.stems) == 2
    edits = (TreeEdit(action="delete", row=2, tree_id=tree.tree_id), added(tree))
    edited = apply_edits(found, points, edits, settings=settings)
    assert edited.trees[0].dbh_cm == pytest.approx(tree.dbh_cm, abs=0.02)
    # Half of the gap between the two, and no bark of the thin one beyond it.
    for section in (*found.sections, *edited.sections):
        assert np.linalg.norm(section.offsets_m, axis=1).max() < 0.15 + 0.03


def test_a_deleted_tree_hides_nothing(wood: NDArray[np.float64]) -> None:
    found = analyse_plot(wood, settings=SETTINGS)
    low, high = (found.trees[found_at(found, *place)] for place in ((7.0, 2.1), (5.87, 2.0)))
    assert low.height_m == pytest.approx(8.0, abs=0.5)
    deleted = [TreeEdit(action="delete", row=2, tree_id=tree.tree_id) for tree in (low, high)]
    edited = apply_edits(found, wood, [*deleted, added(low)], settings=SETTINGS)
    again = edited.trees[found_at(edited, low.x_m, low.y_m)]
    assert again.height_m is None or again.height_m > 9.0


def test_a_tree_where_nothing_is_seen_stands_on_the_ground(result: PlotResult) -> None:
    # A slope at 700 m above the sea, in a national grid.
    assert result.ground is not None
    flat = replace(result.ground, raster_m=None, plane=np.array([0.1, -0.2, 700.0]))
    high = replace(
        result,
        ground=flat.moved(MOVED[:2]),
        trees=tuple(replace(tree, x_m=tree.x_m + MOVED[0], y_m=tree.y_m + MOVED[1]) for tree in result.trees),
        extent_m=extent_moved(result, MOVED),
    )
    first, second, *others = high.trees
    high = replace(high, trees=(first, replace(second, x_m=first.x_m + 0.3, y_m=first.y_m - 0.4), *others))
    x_m, y_m = float(MOVED[0] + 50.0), float(MOVED[1] + 20.0)
    edits = [
        TreeEdit(action="merge", row=2, tree_id=1, other_id=2),
        TreeEdit(action="add", row=3, x_m=x_m, y_m=y_m, tree_id=9),
    ]
    merged, *_, added = apply_edits(high, np.zeros((0, 3)), edits, settings=SETTINGS).trees
    assert added.z_ground_m == pytest.approx(700.0 + 5.0 - 4.0, abs=1e-6)
    between = np.array([result.trees[0].x_m + 0.15, result.trees[0].y_m - 0.2])
    assert merged.z_ground_m == pytest.approx(700.0 + between @ [0.1, -0.2], abs=1e-6)
    # The ground is in metres by a guess where the scale is not known; the places are in units.
    edited = apply_edits(replace(high, units_per_m=4.0), np.zeros((0, 3)), edits, settings=SETTINGS, metric=False)
    assert edited.trees[-1].z_ground_m == pytest.approx(
        4.0 * high.ground.height_at(np.array([[x_m, y_m]]) / 4.0)[0] if high.ground else None
    )


def test_a_tree_beside_one_that_is_known_is_not_that_one_again(plot: StemPlot, result: PlotResult) -> None:
    """A stem of 41 cm was found again 27 cm beside it, and counted twice in the basal area."""
    known = result.trees[1]
    assert known.dbh_cm is not None
    beside = TreeEdit(action="add", row=2, x_m=known.x_m + 0.25, y_m=known.y_m + 0.1)
    edited = apply_edits(result, plot.points, [beside], settings=SETTINGS)
    assert edited.trees[:4] == result.trees
    assert edited.trees[4].dbh_cm is None
    assert edited.trees[4].reasons == (notice(StemCode.added_by_hand), notice(StemCode.no_stem_here))
    inside = TreeEdit(action="add", row=3, x_m=known.x_m + 0.1, y_m=known.y_m)
    way_out = (
        rf"row 3 of the edits adds a tree at .*, which lies in tree {known.tree_id}; .* delete {known.tree_id} in a"
    )
    with pytest.raises(InputError, match=way_out):
        apply_edits(result, plot.points, [inside], settings=SETTINGS)
    deleted = TreeEdit(action="delete", row=2, tree_id=known.tree_id)
    again = apply_edits(result, plot.points, [deleted, inside], settings=SETTINGS)
    assert again.trees[-1].dbh_cm == pytest.approx(known.dbh_cm, abs=0.5)


@pytest.mark.parametrize(("x_m", "y_m"), [(300.0, 2.0), (2.0, -1e12)])
def test_a_tree_is_not_added_far_outside_of_the_cloud(
    plot: StemPlot, result: PlotResult, x_m: float, y_m: float
) -> None:
    edit = TreeEdit(action="add", row=4, x_m=x_m, y_m=y_m)
    with pytest.raises(InputError, match=r"row 4 of the edits adds a tree at .* far outside of the cloud"):
        apply_edits(result, plot.points, [edit], settings=SETTINGS)


def test_a_tree_without_a_diameter_is_not_added_twice(plot: StemPlot, result: PlotResult) -> None:
    edits = [TreeEdit(action="add", row=row, x_m=50.0, y_m=50.0 + 0.05 * row) for row in (2, 3)]
    with pytest.raises(InputError, match=r"row 3 of the edits adds a tree at .* lies in tree 5"):
        apply_edits(result, plot.points, edits, settings=SETTINGS)


def test_stems_metres_apart_are_not_merged(plot: StemPlot, result: PlotResult) -> None:
    """One mistyped number took a stem of 42 cm off the map, and gave its number to another tree."""
    with pytest.raises(InputError, match=r"row 2 of the edits merges the trees 1 and 3, which stand 2\.\d+ m apart"):
        apply_edits(result, plot.points, [TreeEdit(action="merge", row=2, tree_id=1, other_id=3)], settings=SETTINGS)


def test_two_halves_of_one_stem_are_merged(plot: StemPlot, result: PlotResult) -> None:
    whole = result.trees[0]
    twin = replace(whole, tree_id=7, x_m=whole.x_m + 0.15)
    double = replace(result, trees=(*result.trees, twin), sections=(*result.sections, result.sections[0]))
    merge = TreeEdit(action="merge", row=2, tree_id=1, other_id=7)
    edited = apply_edits(double, plot.points, [merge], settings=SETTINGS)
    assert [tree.tree_id for tree in edited.trees] == [1, 2, 3, 4]
    assert edited.trees[1:] == result.trees[1:]
    assert edited.trees[0].reasons[0] == notice(StemCode.merged_by_hand, tree_id=1, other_id=7)
    assert edited.trees[0].dbh_cm == pytest.approx(whole.dbh_cm, abs=0.5)


def test_a_merged_tree_is_none_of_the_others() -> None:
    """Two thin stems beside a thick one were merged into a second entry of that one, with twice its basal area."""
    rng, places, radii = np.random.default_rng(3), [(0.0, 0.0), (0.3, 0.0), (0.15, 0.6)], [0.05, 0.05, 0.25]
    stems = []
    # The thick one has the sharper wall, and more to show for itself.
    for (x, y), radius, std in zip(places, radii, [0.006, 0.006, 0.002], strict=True):
        stem = wall(rng, radius=radius, spacing_m=0.012) + np.array([x, y, 0.0])
        stems.append(stem + rng.normal(0.0, std, stem.shape))
    floor = np.column_stack([rng.uniform(-4.0, 4.0, (30_000, 2)), rng.normal(0.0, 0.005, 30_000)])
    points = np.concatenate([*stems, floor])
    found = analyse_plot(points, settings=SETTINGS)
    thick = max(found.trees, key=lambda tree: tree.radius_m)
    one, other = (tree.tree_id for tree in found.trees if tree != thick)
    merge = TreeEdit(action="merge", row=2, tree_id=one, other_id=other)
    edited = apply_edits(found, points, [merge], settings=SETTINGS)
    assert thick in edited.trees
    (merged,) = (tree for tree in edited.trees if tree != thick)
    assert merged.dbh_cm == pytest.approx(10.0, abs=0.5)
    assert np.hypot(merged.x_m - thick.x_m, merged.y_m - thick.y_m) > thick.radius_m


def test_without_a_scale_trees_are_moved_about_but_not_measured(plot: StemPlot) -> None:
    bare = analyse_plot(plot.points, settings=SETTINGS, metric=False)
    edits = [
        TreeEdit(action="delete", row=2, tree_id=1),
        TreeEdit(action="merge", row=3, tree_id=2, other_id=3),
        TreeEdit(action="add", row=4, x_m=1.0, y_m=2.0),
    ]
    edited = apply_edits(bare, plot.points, edits, settings=SETTINGS, metric=False)
    assert [(tree.tree_id, tree.dbh_cm) for tree in edited.trees] == [(2, None), (4, None), (5, None)]
    assert edited.trees[0].x_m == pytest.approx((bare.trees[1].x_m + bare.trees[2].x_m) / 2)


def test_rows_are_applied_in_their_order(plot: StemPlot, result: PlotResult) -> None:
    delete = TreeEdit(action="delete", row=2, tree_id=3)
    with pytest.raises(InputError, match=r"row 3 of the edits names tree 3, which is not there .* are: 1, 2, 4"):
        apply_edits(result, plot.points, [delete, replace(delete, row=3)], settings=SETTINGS)
    again = TreeEdit(action="add", row=3, tree_id=3, x_m=50.0, y_m=50.0)
    assert apply_edits(result, plot.points, [delete, again], settings=SETTINGS).trees[2].x_m == 50.0
    with pytest.raises(InputError, match="row 3 of the edits adds a tree 3, but there is one"):
        apply_edits(result, plot.points, [again], settings=SETTINGS)


def test_reading(tmp_path: Path) -> None:
    text = "\ufeffaction, tree_id, other_id, x_m, y_m, note\nDelete,3,,,,shrub\n\nadd,,,1.5,-2,\nmerge,4,5,,,\n"
    assert edits_of(tmp_path, text) == (
        TreeEdit(action="delete", row=2, tree_id=3),
        TreeEdit(action="add", row=4, x_m=1.5, y_m=-2.0),
        TreeEdit(action="merge", row=5, tree_id=4, other_id=5),
    )
    spreadsheet = "action;tree_id;x_m;y_m;note\nadd;;1,5;-2;a, b\n"
    assert edits_of(tmp_path, spreadsheet) == (TreeEdit(action="add", row=2, x_m=1.5, y_m=-2.0),)
    assert edits_of(tmp_path, "action\n") == ()
    assert find_edits(tmp_path, None) == ()
    assert find_edits(tmp_path / "none", None) == ()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("tree_id\n3\n", "has no column action"),
        ("", "has no column action"),
        ("action,tree_id\nremove,3\n", "row 2: the action is 'remove'; it must be delete, add, merge"),
        ("action,tree_id\nmerge,3\n", "row 2: 'merge' needs the column other_id"),
        ("action,tree_id\nadd,3\n", "row 2: 'add' needs the column x_m and y_m"),
        ("action,tree_id\ndelete,\n", "needs the number of a tree, 1 to 999999999, in the column tree_id, not ''"),
        ("action,tree_id\ndelete,2.5\n", "not '2.5'"),
        ("action,tree_id\ndelete,0\n", "not '0'"),
        ("action,tree_id,x_m,y_m\nadd,1000000000,1,1\n", "not '1000000000'"),
        ("action,x_m,y_m,note\nadd,5,35,4,80,behind tree 7\n", "row 2: it has 6 cells, and the file 4 columns"),
        ("action,x_m,y_m\nadd,1,nan\n", "row 2: 'add' needs a number in the column y_m, not 'nan'"),
        ("action,tree_id,other_id\nmerge,3,3\n", "cannot be merged with itself"),
        ("action,tree_id,x_m,y_m\nadd,8,1,1\nadd,8,2,2\n", "2 added trees have the tree_id 8"),
    ],
)
def test_a_wrong_row_is_told_with_its_place(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(InputError) as caught:
        edits_of(tmp_path, text)
    assert told in str(caught.value)
    assert "edits.csv" in str(caught.value)


def test_a_file_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read the edits .*none\.csv: there is no such file"):
        read_edits(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="cannot read the edits"):
        read_edits(tmp_path / "binary.csv")


def test_on_the_command_line(plot: StemPlot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fsinfer.cli.app import app

    # Drawing takes most of the time, and is tested elsewhere.
    monkeypatch.setattr(
        "fsinfer.trees.outputs.figures.write_figures", lambda folder, *_, **__: folder.mkdir(exist_ok=True)
    )
    cloud, out = tmp_path / "cloud.ply", tmp_path / "out"
    write_cloud(cloud, PointCloud(xyz=plot.points))
    call = ["trees", str(cloud), str(out), "-q"]
    assert CliRunner().invoke(app, call).exit_code == 0
    before = read_trees(out / "trees.csv")
    (out / "edits.csv").write_text("action,tree_id\ndelete,1\n", encoding="utf-8")
    assert CliRunner().invoke(app, call).exit_code == 0
    assert read_trees(out / "trees.csv") == before[1:]
    (tmp_path / "other.csv").write_text("action,tree_id\ndelete,77\n", encoding="utf-8")
    wrong = CliRunner().invoke(app, [*call, "--edits", str(tmp_path / "other.csv")])
    assert wrong.exit_code == 2
    assert "names tree 77, which is not there" in wrong.output
    assert "Traceback" not in wrong.output
    assert read_trees(out / "trees.csv") == before[1:]

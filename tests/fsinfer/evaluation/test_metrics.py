import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.cli.tables import evaluation_rows
from fsinfer.errors import InputError
from fsinfer.evaluation.figure import plot_evaluation
from fsinfer.evaluation.measured import MeasuredTree, read_measured
from fsinfer.evaluation.metrics import evaluate


@dataclass(frozen=True)
class Found:
    tree_id: int | str
    x_m: float
    y_m: float
    dbh_cm: float | None


MEASURED = [
    MeasuredTree(tree_id="a", x_m=0.0, y_m=0.0, dbh_cm=20.0),
    MeasuredTree(tree_id="b", x_m=3.0, y_m=0.0, dbh_cm=30.0),
    MeasuredTree(tree_id="c", x_m=0.0, y_m=4.0, dbh_cm=40.0),
    MeasuredTree(tree_id="d", x_m=5.0, y_m=5.0, dbh_cm=10.0),
]
FOUND = [Found(1, 0.1, 0.0, 21.0), Found(2, 3.0, 0.2, 28.0), Found(3, 0.0, 4.1, None), Found(4, 9.0, 9.0, 15.0)]


def _plot(count: int = 20, seed: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64], list[MeasuredTree]]:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 18.0, (count, 2))
    dbh = rng.uniform(10.0, 45.0, count)
    return xy, dbh, [MeasuredTree(tree_id=str(k), x_m=xy[k, 0], y_m=xy[k, 1], dbh_cm=dbh[k]) for k in range(count)]


def _moved(
    xy: NDArray[np.float64],
    dbh: NDArray[np.float64],
    angle_deg: float,
    shift: NDArray[np.float64],
    scale: float = 1.0,
    noise: float = 0.05,
    seed: int = 1,
) -> list[Found]:
    rng = np.random.default_rng(seed)
    a = np.radians(angle_deg)
    rotation = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
    moved = scale * xy @ rotation + shift + rng.normal(0.0, noise, xy.shape)
    return [Found(100 + k, x, y, dbh[k] + rng.normal(0.0, 0.8)) for k, (x, y) in enumerate(moved)]


def test_stems_outside_of_the_walk_are_not_judged(tmp_path: Path) -> None:
    rows = ["tree_id,x_m,y_m,dbh_cm,status", "1,0.1,0,21,ok", "2,3,0.2,,outside", "3,1,30,,outside", "4,9,9,15,ok"]
    (tmp_path / "trees.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    found = read_measured(tmp_path / "trees.csv", need_dbh=False)
    # One of the two outside is a tree that was measured; of the others the one that counts in the stand is false.
    for margin, outside, false in ((None, 1, 1), (1.0, 2, 0), (100.0, 1, 1)):
        e = evaluate(MEASURED, found, align="never", area_margin_m=margin)
        assert (e.detected, e.matched, e.outside, e.false) == (2, 1, outside, false)
    by_id = evaluate([replace(MEASURED[0], tree_id="1")], found, by_id=True)
    assert (by_id.detected, by_id.outside, by_id.false) == (1, 2, 1)


def test_stems_outside_of_the_border_are_not_judged(tmp_path: Path) -> None:
    """Who measures a plot does not measure beyond its border: every stem there was counted as a false one."""
    rows = ["tree_id,x_m,y_m,dbh_cm,in_plot", "1,0.1,0,21,0", "2,3,0.2,28,1", "3,8,0,30,0", "4,1,2,15,1", "5,2,2,15,"]
    rows += ["6,9,0,15,FALSE"]  # trees.xlsx, saved as CSV
    (tmp_path / "trees.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    found = read_measured(tmp_path / "trees.csv", need_dbh=False)
    # One that was measured all the same counts; one that stands within, or of which nothing is said, is false.
    e = evaluate(MEASURED, found, align="never")
    assert (e.matched, e.outside, e.false) == (2, 2, 2)


@pytest.mark.parametrize(
    ("inside", "outside"), [("1,0", "0,0"), ("1.0", "0.0"), ("True", "False"), ("WAHR", "FALSCH"), ("PRAWDA", "FAŁSZ")]
)
def test_other_programs_say_what_is_outside_of_the_border_in_their_way(
    tmp_path: Path, inside: str, outside: str
) -> None:
    """A spreadsheet in German saves FALSCH, a table whose column has gaps comes back with 0.0: both counted as in."""
    rows = ["tree_id;x_m;y_m;dbh_cm;in_plot", f"1;9;0;21;{inside}", f"2;9;3;28;{outside}"]
    (tmp_path / "trees.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    e = evaluate(MEASURED, read_measured(tmp_path / "trees.csv", need_dbh=False), align="never")
    assert (e.outside, e.false) == (1, 1)


@pytest.mark.parametrize(("written", "matched"), [("0{}", 3), ("{}.0", 3), ("{},00", 3), ("T{}", 0), ("{}.5", 0)])
def test_numbers_are_the_same_however_a_table_writes_them(written: str, matched: int) -> None:
    """A field sheet has 01 to 12: the first nine were omitted, and as many stems false, without a word."""
    trees = [replace(tree, tree_id=written.format(k)) for k, tree in enumerate(MEASURED, start=1)]
    assert evaluate(trees, FOUND, by_id=True).matched == matched
    # Where that would make two trees one they are what is written.
    more = [*trees, MeasuredTree(tree_id="1", x_m=0.0, y_m=0.0, dbh_cm=21.0)]
    assert evaluate(more, FOUND, by_id=True).matched == 1


@pytest.mark.parametrize("margin", [-1.0, float("inf"), float("nan")])
def test_an_area_does_not_end_within_its_trees_nor_nowhere(margin: float) -> None:
    with pytest.raises(InputError, match="area margin must be a number of metres"):
        evaluate(MEASURED, FOUND, area_margin_m=margin)


def test_metrics_by_hand() -> None:
    e = evaluate(MEASURED, FOUND)
    assert (e.n, e.extracted, e.detected, e.matched, e.omitted, e.false) == (4, 4, 3, 2, 1, 1)
    assert e.r == 0.5
    assert e.rmse_cm == pytest.approx(np.sqrt((1 + 4) / 2))
    assert e.rmse_cm is not None
    assert e.rrmse is not None
    assert e.rrmse == pytest.approx(e.rmse_cm / 25.0)
    assert e.ae == pytest.approx(1.0 - e.rrmse)
    assert e.bias_cm == pytest.approx(-0.5)
    assert e.mae_cm == pytest.approx(1.5)
    assert e.measured_from_extracted is None


def test_matching_is_one_to_one_and_complete() -> None:
    # Greedy nearest matching would give the middle stem to the first tree and lose the second.
    measured = [replace(MEASURED[0], x_m=0.0), replace(MEASURED[1], x_m=0.5)]
    found = [Found(1, 0.3, 0.0, 20.0), Found(2, 0.9, 0.0, 30.0)]
    links = {(p.measured_id, p.extracted_id) for p in evaluate(measured, found, max_distance_m=0.45).pairs}
    assert links == {("a", "1"), ("b", "2")}


def test_numbers_of_other_trees_are_told_whatever_the_frame() -> None:
    rng = np.random.default_rng(4)
    trees = [
        MeasuredTree(tree_id=str(n), x_m=x, y_m=y, dbh_cm=30.0) for n, (x, y) in enumerate(rng.uniform(0, 20, (8, 2)))
    ]
    # Another frame: turned by a right angle and moved, each place a little off.
    same = [replace(t, x_m=100 - t.y_m + 0.2, y_m=t.x_m + 7) for t in trees]
    assert evaluate(trees, same, by_id=True).alignment_doubt == ""
    other = [replace(t, tree_id=str((int(t.tree_id) + 3) % 8)) for t in same]
    assert evaluate(trees, other, by_id=True).alignment_doubt == "other_numbers"
    # Of two trees, and without positions, nothing is known.
    assert evaluate(trees[:2], other, by_id=True).alignment_doubt == ""
    nowhere = [replace(t, x_m=float("nan"), y_m=float("nan")) for t in trees]
    assert evaluate(nowhere, other, by_id=True).alignment_doubt == ""


def test_matching_by_id_ignores_positions() -> None:
    found = [Found("b", 90.0, 0.0, 33.0), Found("x", 0.0, 0.0, 20.0)]
    e = evaluate(MEASURED, found, by_id=True)
    assert (e.detected, e.matched, e.false) == (1, 1, 1)
    assert e.bias_cm == pytest.approx(3.0)


def test_frames_are_registered_when_they_differ() -> None:
    xy, dbh, measured = _plot()
    found = [*_moved(xy, dbh, 137.0, np.array([40.0, -7.0]))[3:], Found(7, 100.0, 0.0, 20.0)]
    e = evaluate(measured, found)
    assert e.matched == 17
    assert e.omitted == 3
    assert e.false == 1
    assert all(int(p.extracted_id) - 100 == int(p.measured_id) for p in e.pairs)
    assert e.measured_from_extracted is not None
    assert abs(e.measured_from_extracted["rotation_deg"]) == pytest.approx(137.0, abs=1.0)
    assert evaluate(measured, found, align="never").matched < 5


@pytest.mark.parametrize("shape", ["square", "random"])
def test_no_tree_is_matched_by_its_diameter(shape: str) -> None:
    """Other diameters, other errors; but the same pairs, at the same distances, after the same motion."""
    xy, dbh, _ = _plot(8)
    if shape == "square":  # four ways of laying it that are equally good by position
        xy = np.array([(0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (0.0, 6.0)])
        dbh = np.array([15.0, 25.0, 35.0, 45.0])
    measured = [
        MeasuredTree(tree_id=str(k), x_m=x, y_m=y, dbh_cm=d) for k, (x, y, d) in enumerate(zip(*xy.T, dbh, strict=True))
    ]
    found = _moved(xy, dbh, 137.0, np.array([40.0, -7.0]), noise=0.0 if shape == "square" else 0.05)
    told = []
    for turn in range(4):
        others = [replace(tree, dbh_cm=found[(k + turn) % len(found)].dbh_cm) for k, tree in enumerate(found)]
        if turn == 3:
            others = [replace(tree, dbh_cm=None) for tree in found]
        e = evaluate(measured, others, align="always")
        assert e.detected == len(xy)
        told.append(([(p.measured_id, p.extracted_id, p.distance_m) for p in e.pairs], e.measured_from_extracted))
    assert told[1:] == told[:1] * 3
    # As given, two stems within reach: the nearer one, though the other has the diameter.
    near = [Found("like", 0.4, 0.0, 20.0), Found("near", 0.1, 0.0, 31.0)]
    (pair,) = evaluate(MEASURED[:1], near).pairs
    assert pair.extracted_id == "near"


def test_registration_never_scales() -> None:
    xy, dbh, measured = _plot()
    e = evaluate(measured, _moved(xy, dbh, 30.0, np.array([5.0, 5.0]), scale=1.3), align="always")
    assert e.matched < 12


def test_good_frames_are_left_alone() -> None:
    xy, dbh, measured = _plot()
    e = evaluate(measured, _moved(xy, dbh, 0.0, np.zeros(2)))
    assert e.measured_from_extracted is None
    assert e.matched == 20


def test_nothing_extracted_is_a_result() -> None:
    e = evaluate(MEASURED, [])
    assert (e.r, e.omitted, e.false, e.rmse_cm, e.ae) == (0.0, 4, 0, None, None)
    assert json.loads(json.dumps(e.to_dict()))["rmse_cm"] is None


def test_reading_measured(tmp_path: Path) -> None:
    path = tmp_path / "m.csv"
    path.write_text("tree_id,x_m,y_m,dbh_cm,note\nA1,1.5,2,30.2,oak\n\nA2,0,0,12,\n")
    assert read_measured(path) == [
        MeasuredTree(tree_id="A1", x_m=1.5, y_m=2.0, dbh_cm=30.2),
        MeasuredTree(tree_id="A2", x_m=0.0, y_m=0.0, dbh_cm=12.0),
    ]
    path.write_text("\ufefftree_id;x_m;y_m;dbh_cm\nA1;1,5;2;30,2\n")
    assert read_measured(path)[0].dbh_cm == 30.2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tree_id,x_m,y_m\n1,0,0\n", "no column dbh_cm"),
        ("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n2,0,0,thick\n", r"row 3, column dbh_cm: 'thick'"),
        ("tree_id,x_m,y_m,dbh_cm\n1,0,,30\n", r"row 2, column y_m"),
        ("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n1,1,1,31\n", r"row 3: tree_id 1 was used in row 2"),
        ("tree_id,x_m,y_m,dbh_cm\n1,0,0,0\n", r"row 2: dbh_cm is 0"),
        ("tree_id,x_m,y_m,dbh_cm\n1,0,0,nan\n", r"row 2, column dbh_cm"),
        ("tree_id,x_m,y_m,dbh_cm\n,0,0,3\n", r"row 2: the tree_id is empty"),
        ("", "no column"),
    ],
)
def test_bad_measured_files_name_the_row(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "m.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_measured(path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        read_measured(tmp_path / "none.csv")


@pytest.mark.parametrize("options", [{"align": "maybe"}, {"max_distance_m": 0.0}])
def test_bad_options(options: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        evaluate(MEASURED, FOUND, **options)


def test_no_measured_trees_is_an_error() -> None:
    with pytest.raises(InputError, match="no measured trees"):
        evaluate([], FOUND)


def test_scatter_figure(tmp_path: Path) -> None:
    plot_evaluation(evaluate(MEASURED, FOUND), tmp_path / "scatter.png")
    assert (tmp_path / "scatter.png").stat().st_size > 5000
    plot_evaluation(evaluate(MEASURED, []), tmp_path / "empty.png")
    assert (tmp_path / "empty.png").stat().st_size > 5000


def test_stems_beyond_the_measured_area_are_not_judged() -> None:
    corners = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
    measured = [MeasuredTree(tree_id=str(i), x_m=x, y_m=y, dbh_cm=20.0) for i, (x, y) in enumerate(corners)]
    strangers = [(5.0, 5.0), (10.9, 5.0), (11.1, 5.0), (30.0, -4.0)]
    extra = [MeasuredTree(tree_id=f"e{i}", x_m=x, y_m=y, dbh_cm=20.0) for i, (x, y) in enumerate(strangers)]
    result = evaluate(measured, [*measured, *extra], align="never", area_margin_m=1.0)
    assert (result.matched, result.false, result.outside) == (4, 2, 2)
    assert evaluate(measured, [*measured, *extra], align="never").false == 4


def test_a_table_in_metres_is_told(tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    path.write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,0.205\n2,5,0,1.302\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"no dbh_cm is above 1\.302 cm; give centimetres"):
        read_measured(path)
    # A trees.csv is of ours.
    assert len(read_measured(path, need_dbh=False)) == 2


@pytest.mark.parametrize(("times", "what"), [(np.pi, "girths"), (1 / 2.54, "inches")])
def test_girths_and_inches_are_told(times: float, what: str) -> None:
    dbh = np.array([12.0, 20.0, 31.0, 44.0])
    theirs = [Found(n, float(n), 0.0, found) for n, found in enumerate(dbh + np.array([0.4, -0.5, 0.6, 0.0]))]

    def measured(values: NDArray[np.float64]) -> list[Found]:
        return [Found(n, float(n), 0.0, value) for n, value in enumerate(values)]

    with pytest.raises(InputError, match=f"they look like {what}; give diameters in centimetres"):
        evaluate(measured(times * dbh), theirs)
    # A wrong scale, and stems each of which is wrong in its own way, are for the figures.
    assert evaluate(measured(2.0 * dbh), theirs).matched == 4
    assert evaluate(measured(times * dbh * [0.7, 1.0, 1.5, 0.75]), theirs).matched == 4
    assert evaluate(measured(times * dbh)[:2], theirs[:2]).matched == 2


def test_measured_trees_without_a_diameter_are_places_of_trees(tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    path.write_text("tree_id,x_m,y_m,dbh_cm\na,0,0,20\nb,3,0,\nc,0,4,40\nd,5,5,\n", encoding="utf-8")
    result = evaluate(read_measured(path), FOUND, align="never")
    # The stem at b is no false one, d is not omitted: of both nobody knows more than their places.
    assert (result.n, result.without_dbh, result.detected, result.matched, result.omitted) == (2, 2, 2, 1, 0)
    assert (result.false, result.r, result.rmse_cm) == (1, 0.5, 1.0)
    assert [pair.measured_id for pair in result.pairs] == ["a", "c"]
    path.write_text("tree_id,x_m,y_m,dbh_cm\na,0,0,\n", encoding="utf-8")
    with pytest.raises(InputError, match="the column dbh_cm is empty"):
        read_measured(path)
    with pytest.raises(InputError, match="no measured tree has a DBH"):
        evaluate(read_measured(path, need_dbh=False), FOUND)


def test_how_many_lie_in_their_interval(tmp_path: Path) -> None:
    rows = [
        "tree_id,x_m,y_m,dbh_cm,dbh_lo95_cm,dbh_hi95_cm",
        "1,0,0,21,20,22",
        "2,3,0,28,27,29",
        "3,0,4,41,,",
        "4,9,9,9,8,9",
    ]
    (tmp_path / "trees.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    result = evaluate(MEASURED, read_measured(tmp_path / "trees.csv", need_dbh=False), align="never")
    assert (result.matched, result.with_interval, result.in_interval) == (3, 2, 1)
    assert [pair.in_interval for pair in result.pairs] == [True, False, None]
    assert "In their interval   1 of 2  (95 % of many)" in evaluation_rows(result)
    assert not any("interval" in row for row in evaluation_rows(evaluate(MEASURED, FOUND)))


@pytest.mark.parametrize(("times", "name"), [(10.0, "measured"), (0.1, "extracted")])
def test_a_table_in_millimetres_is_told(times: float, name: str) -> None:
    ours = [Found(n, float(n), 0.0, times * dbh) for n, dbh in enumerate((12.0, 20.0, 31.0))]
    theirs = [Found(n, float(n), 0.0, dbh) for n, dbh in enumerate((12.5, 21.0, 30.0))]
    with pytest.raises(InputError, match=f"the {name} diameters are 10 times the others: give centimetres"):
        evaluate(ours, theirs)
    # Stems that are wrong by so much may be wrong, and two tables may hold other trees.
    assert evaluate(ours[:2], theirs[:2]).matched == 2
    saplings = [Found(9 + n, 3.0 + n, 5.0, 7.0) for n in range(8)]
    giants = [Found(n, float(n), 0.0, 65.0) for n in range(3)]
    assert evaluate(giants, [*giants, *saplings]).matched == 3

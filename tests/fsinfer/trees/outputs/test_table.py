import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from numpy.typing import NDArray
from PIL import Image

from fsinfer.errors import CloudError, InputError
from fsinfer.notices.notice import notice, notice_of_json
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.trees import Tree, analyse_plot, measure_trees
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.measure import PlotResult
from fsinfer.trees.outputs.figures import SectionSheets, plot_section, write_figures
from fsinfer.trees.outputs.reasons import write_reasons
from fsinfer.trees.outputs.table import COLUMNS, read_trees, write_trees
from fsinfer.trees.stem_curve import CurvePoint
from tests.support.places import DATA
from tests.support.stem_clouds import StemPlot, stem_plot

CLOUDS = DATA / "clouds"


@pytest.fixture(scope="module")
def plot() -> StemPlot:
    return stem_plot(seed=8, trees=4, spacing_m=0.015, sigma_m=0.006, hidden=0.5, slope=0.1)


@pytest.fixture(scope="module")
def result(plot: StemPlot) -> PlotResult:
    return analyse_plot(plot.points)


def test_columns_are_those_of_the_contract() -> None:
    assert ",".join(COLUMNS) == (
        "tree_id,x_m,y_m,z_ground_m,dbh_cm,dbh_lo95_cm,dbh_hi95_cm,dbh_perimeter_cm,dbh_min_cm,dbh_max_cm,"
        "bh_m,arc_coverage,points,residual_cm,lean_deg,height_m,status,reason,in_plot,border_m,at_border,part"
    )


def test_table_round_trip(tmp_path: Path, result: PlotResult) -> None:
    unmeasured = Tree(
        **{name: None for name in COLUMNS if name.startswith(("dbh", "residual", "height", "border"))},
        tree_id=9,
        x_m=-1.0,
        y_m=2.5,
        z_ground_m=0.0,
        bh_m=1.3,
        arc_coverage=0.1,
        points=0,
        lean_deg=0.0,
        status="unmeasured",
        reasons=(notice(StemCode.as_written, text="only 40 degrees, of the stem; walk round it"),),
    )
    write_trees(tmp_path / "trees.csv", [*result.trees, unmeasured])
    back = read_trees(tmp_path / "trees.csv")
    assert back[-1] == unmeasured
    assert all(tree.in_plot is tree.border_m is tree.at_border is None and tree.part is None for tree in back)
    assert [tree.dbh_cm for tree in back[:-1]] == pytest.approx([tree.dbh_cm for tree in result.trees], abs=0.006)
    assert [tree.x_m for tree in back[:-1]] == pytest.approx([tree.x_m for tree in result.trees], abs=0.0006)


def test_columns_of_the_border_round_trip_and_an_older_table_lacks_them(tmp_path: Path, result: PlotResult) -> None:
    path = tmp_path / "trees.csv"
    inside = replace(result.trees[0], in_plot=True, border_m=0.25, at_border=True, part="part-2")
    outside = replace(result.trees[1], in_plot=False, border_m=-3.125, at_border=False)
    write_trees(path, [inside, outside])
    assert [(tree.in_plot, tree.border_m, tree.at_border, tree.part) for tree in read_trees(path)] == [
        (True, 0.25, True, "part-2"),
        (False, -3.125, False, None),
    ]
    assert [line.rsplit(",", 4)[1:] for line in path.read_text().splitlines()[1:]] == [
        ["1", "0.250", "1", "part-2"],
        ["0", "-3.125", "0", ""],
    ]
    older = [",".join(line.split(",")[:-4]) for line in path.read_text().splitlines()]
    path.write_text("\n".join(older))
    read = read_trees(path)
    assert read == [replace(t, in_plot=None, border_m=None, at_border=None, part=None) for t in read]
    assert [tree.tree_id for tree in read] == [inside.tree_id, outside.tree_id]


def test_reasons_are_written_as_codes_with_values_and_words(tmp_path: Path, result: PlotResult) -> None:
    why = notice(StemCode.edges_alone, photos=5, refused=notice(StemCode.double_wall, gap_cm=3.04))
    doubtful = replace(result.trees[0], status="doubtful", reasons=(why, notice(StemCode.too_little_seen, seen_deg=41)))
    sound = replace(result.trees[1], status="ok", reasons=())
    write_reasons(tmp_path / "trees.json", [doubtful, sound])
    first, second = json.loads((tmp_path / "trees.json").read_text(encoding="utf-8"))
    assert second == {"tree_id": 2, "status": "ok", "reasons": []}
    assert (first["tree_id"], first["status"]) == (1, "doubtful")
    assert first["reasons"] == [
        {
            "code": "edges_alone",
            "values": {"photos": 5, "refused": {"code": "double_wall", "values": {"gap_cm": 3.04}}},
            "text": "only from its edges in 5 photos (double wall: two surfaces 3.0 cm apart)",
            "advises_revisit": False,
        },
        {
            "code": "too_little_seen",
            "values": {"seen_deg": 41},
            "text": "only 41 degrees of the stem are seen; walk round it",
            "advises_revisit": True,
        },
    ]
    assert tuple(notice_of_json(entry) for entry in first["reasons"]) == doubtful.reasons


def test_bad_cell_names_row_and_column(tmp_path: Path, result: PlotResult) -> None:
    path = tmp_path / "trees.csv"
    write_trees(path, result.trees[:1])
    lines = path.read_text().splitlines()
    path.write_text(lines[0] + "\n" + lines[1].replace("1,", "1,x", 1) + "\n")
    with pytest.raises(InputError, match=r"row 2, column x_m"):
        read_trees(path)


def test_empty_table_is_its_header(tmp_path: Path) -> None:
    write_trees(tmp_path / "trees.csv", [])
    assert read_trees(tmp_path / "trees.csv") == []
    assert (tmp_path / "trees.csv").read_text().strip() == ",".join(COLUMNS)


def test_ids_count_from_one_and_runs_agree(plot: StemPlot, result: PlotResult) -> None:
    assert [tree.tree_id for tree in result.trees] == [1, 2, 3, 4]
    assert measure_trees(plot.points) == list(result.trees)


def test_far_from_the_origin_nothing_changes(plot: StemPlot, result: PlotResult) -> None:
    shift = np.array([4.5e5, 5.2e6, 300.0])
    moved = analyse_plot(plot.points + shift)
    for a, b in zip(result.trees, moved.trees, strict=True):
        assert b.dbh_cm == pytest.approx(a.dbh_cm, abs=0.05)
        assert [b.x_m - shift[0], b.y_m - shift[1], b.z_ground_m - shift[2]] == pytest.approx(
            [a.x_m, a.y_m, a.z_ground_m], abs=0.01
        )


def test_nan_points_are_left_out_with_a_warning(plot: StemPlot, result: PlotResult) -> None:
    dirty = np.concatenate([plot.points, [[np.nan, 0, 0], [0, np.inf, 0]]])
    found = analyse_plot(dirty)
    assert notice(StemCode.not_finite, points=2) in found.warnings
    assert len(found.trees) == len(result.trees)


def test_masked_points_are_left_out_with_a_warning(plot: StemPlot, result: PlotResult) -> None:
    dirty = np.ma.masked_array(np.concatenate([plot.points, [[0.0, 0.0, 9.0]]]))
    dirty[-1] = np.ma.masked
    found = analyse_plot(dirty)
    assert notice(StemCode.not_finite, points=1) in found.warnings
    assert found.trees == result.trees


def test_a_point_a_mile_away_does_not_matter(plot: StemPlot, result: PlotResult) -> None:
    found = analyse_plot(np.concatenate([plot.points, [[1609.0, 0.0, 0.0]]]))
    assert notice(StemCode.far_outside, points=1) in found.warnings
    assert [tree.dbh_cm for tree in found.trees] == pytest.approx([tree.dbh_cm for tree in result.trees], abs=0.05)


def test_without_scale_there_are_positions_and_no_dbh(plot: StemPlot, result: PlotResult) -> None:
    found = analyse_plot(3.0 * plot.points, metric=False, units_per_m_hint=3.0)
    assert len(found.trees) == len(result.trees)
    assert sentence(found.diagnosis) == f"{len(found.trees)} trees found, 0 with a DBH"
    for tree, reference in zip(found.trees, result.trees, strict=True):
        assert tree.dbh_cm is None
        assert tree.reasons == (notice(StemCode.no_scale),)
        assert tree.x_m == pytest.approx(3.0 * reference.x_m, abs=0.02)


def test_bare_ground_is_a_result_with_a_diagnosis() -> None:
    rng = np.random.default_rng(0)
    found = analyse_plot(np.column_stack([rng.uniform(0, 8, (20000, 2)), rng.normal(0, 0.01, 20000)]))
    assert found.trees == ()
    assert found.diagnosis.code in {StemCode.none_at_stem_height, StemCode.none_holds, StemCode.none_round}
    assert sentence(found.diagnosis).startswith("no trees found")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda points: points[:50], "only 50 usable points"),
        (lambda points: points[:0], "only 0 usable points"),
        (lambda points: points * 0.001, "not in metres"),
        (lambda points: points * 1000.0, "centimetres or millimetres"),
        (lambda points: points[:, :2], "shape"),
        (lambda points: points * np.nan, "only 0 usable points"),
        (lambda points: points * [1.0, -1.0, -1.0], "z points down"),
        (lambda points: points[:, [0, 2, 1]] * [1.0, 1.0, -1.0], "y points up"),
        (lambda points: points[:, [2, 1, 0]] * [-1.0, 1.0, 1.0], "x points down"),
        (lambda points: (points + np.array([5e5, 5.4e6, 0.0])).astype(np.float32), "steps of 50 cm"),
    ],
    ids=[
        "few", "empty", "millimetric", "thousandfold", "flat", "all nan", "upside down", "y up", "x down",
        "map coordinates in single precision",
    ],
)  # fmt: skip
def test_bad_clouds_say_what_is_wrong(
    plot: StemPlot, make: Callable[[NDArray[np.float64]], NDArray[np.float64]], message: str
) -> None:
    with pytest.raises(CloudError, match=message):
        analyse_plot(make(plot.points))


def test_duplicate_points_change_little(plot: StemPlot, result: PlotResult) -> None:
    twice = analyse_plot(np.concatenate([plot.points, plot.points]))
    assert [t.dbh_cm for t in twice.trees] == pytest.approx([t.dbh_cm for t in result.trees], abs=0.1)


def test_stems_without_ground_are_measured_with_a_warning(plot: StemPlot) -> None:
    found = analyse_plot(plot.points[plot.points[:, 2] > 1.0])
    assert notice(StemCode.little_ground) in found.warnings


def test_a_canopy_alone_is_one_clear_message() -> None:
    rng = np.random.default_rng(1)
    with pytest.raises(CloudError, match="no ground"):
        analyse_plot(np.column_stack([rng.uniform(0, 10, (40000, 2)), rng.normal(12, 1.5, 40000)]))


def test_a_building_has_no_diameters() -> None:
    rng = np.random.default_rng(2)
    count = 15000
    along, up = rng.uniform(0, 7, (4, count)), rng.uniform(0, 3, (4, count))
    walls = [np.column_stack([np.full(count, side), along[i], up[i]]) for i, side in enumerate((0.0, 7.0))]
    walls += [np.column_stack([along[i + 2], np.full(count, side), up[i + 2]]) for i, side in enumerate((0.0, 7.0))]
    floor = np.column_stack([rng.uniform(0, 7, (count, 2)), np.zeros(count)])
    found = analyse_plot(np.concatenate([*walls, floor]) + rng.normal(0, 0.005, (5 * count, 3)))
    assert all(tree.dbh_cm is None and tree.reasons for tree in found.trees)


def test_figures_are_written(tmp_path: Path, result: PlotResult) -> None:
    paths = write_figures(tmp_path, result)
    assert [path.name for path in paths] == ["stem_map.png", *[f"tree_{n:03d}.png" for n in range(1, 5)]]
    for path in paths:
        assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        assert path.stat().st_size > 5000


def test_sections_look_the_same_on_a_sheet_that_was_drawn_on(tmp_path: Path, result: PlotResult) -> None:
    tree, section = result.trees[0], result.sections[0]
    curve = [
        CurvePoint(tree_id=1, height_m=h, diameter_cm=20.0 - h, std_cm=0.3, arc_coverage=0.5, points=99)
        for h in (1.0, 2.0, 3.0)
    ]
    none = replace(tree, dbh_cm=None, dbh_lo95_cm=None, dbh_hi95_cm=None, residual_cm=None)
    empty = replace(section, offsets_m=section.offsets_m[:0], kept=section.kept[:0])
    cases: list[tuple[Tree, Section, list[CurvePoint], bool]] = [
        (tree, section, curve, False),
        (result.trees[1], result.sections[1], [], False),
        (none, empty, curve[:2], True),
        (none, empty, [], False),
        (result.trees[2], result.sections[2], curve[1:], False),
        (tree, section, [], True),
    ]
    sheets = SectionSheets()
    for number, (tree, section, points, guessed) in enumerate(cases):
        alone, used = tmp_path / f"alone_{number}.png", tmp_path / f"used_{number}.png"
        plot_section(tree, section, alone, curve=points, guessed=guessed)
        plot_section(tree, section, used, curve=points, guessed=guessed, sheets=sheets)
        assert alone.read_bytes() == used.read_bytes()
        with Image.open(used) as picture:
            picture.load()  # with its sums
            assert picture.info["dpi"] == pytest.approx((130.0, 130.0), abs=0.01)
            assert picture.size == (1222 if points else 832, 897)


def test_sections_share_their_figures(tmp_path: Path, result: PlotResult, monkeypatch: pytest.MonkeyPatch) -> None:
    """Axes of their own for each took a third of the time of drawing a hectare's stems."""
    made: list[Axes] = []
    start = Axes.__init__

    def count(axes: Axes, *args: Any, **kwargs: Any) -> None:
        made.append(axes)
        start(axes, *args, **kwargs)

    monkeypatch.setattr(Axes, "__init__", count)
    trees = tuple(replace(tree, tree_id=4 * n + tree.tree_id) for n in range(10) for tree in result.trees)
    told: list[tuple[int, int]] = []
    paths = write_figures(
        tmp_path,
        replace(result, trees=trees, sections=result.sections * 10),
        progress=lambda done, total, _: told.append((done, total)),
    )
    assert [path.name for path in paths[1:]] == [f"tree_{n:03d}.png" for n in range(1, 41)]
    assert all(path.exists() for path in paths)
    assert told[-1] == (40, 40)
    assert len(made) <= 10


@pytest.mark.skipif(not CLOUDS.exists(), reason="the clouds of ../shared/data are not here")
@pytest.mark.parametrize(("name", "least", "most"), [("pine_plot.laz", 15, 19), ("LPine1_demo.laz", 14, 14)])
def test_real_scans_work_with_defaults(name: str, least: int, most: int) -> None:
    laspy = pytest.importorskip("laspy")
    found = analyse_plot(laspy.read(CLOUDS / name).xyz)
    assert least <= len(found.trees) <= most
    assert all(7.0 < tree.dbh_cm < 40.0 for tree in found.trees if tree.dbh_cm is not None)
    assert sum(tree.height_m is not None and 10 < tree.height_m < 25 for tree in found.trees) >= least - 2

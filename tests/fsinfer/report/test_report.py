import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.errors import InputError
from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.io.images import write_image
from fsinfer.io.pfm import write_pfm
from fsinfer.output.json_values import as_json
from fsinfer.plot_border.border import Border
from fsinfer.plot_border.plot import plot_of
from fsinfer.plot_border.sight import SeenShare
from fsinfer.report import make_report
from fsinfer.report.contents import number, read_contents
from fsinfer.report.stand_figures import diameters_cm, stand_of
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.stand import stand_of_diameters

TREE = {
    "tree_id": 1, "x_m": 1.5, "y_m": -2.0, "z_ground_m": 0.1, "dbh_cm": 30.0, "dbh_lo95_cm": 29.1, "dbh_hi95_cm": 30.9,
    "dbh_perimeter_cm": 30.4, "dbh_min_cm": 29.0, "dbh_max_cm": 31.0, "bh_m": 1.3, "arc_coverage": 0.8, "points": 412,
    "residual_cm": 0.5, "lean_deg": 2.0, "height_m": "", "status": "ok", "reason": "",
}  # fmt: skip
PLOT = {
    "source": "birch <b>plot</b>", "photos": 40, "registered": 25, "units": "m", "scale_m_per_unit": 0.5,
    "scale_source": "aruco", "scale_rel_std": 0.002, "points": 5000, "density_per_m2": 50.0, "diagnosis": "all well",
    "depth_vs_sfm_median_rel": 0.004, "seconds": {"depth": 200.0, "total": 10_000.0}, "peak_rss_mb": 1500.5,
    "versions": {"fsinfer": "0.1.0", "numpy": "2.0"}, "model": "fs", "model_sha256": "abc123",
    "warnings": ["a marker was blurred"], "settings": {"trees": {"a": "</pre><i>"}},
}  # fmt: skip


def write_csv(path: Path, rows: list[dict[str, Any]], columns: list[str] | None = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, columns or list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def small_cloud(count: int = 4000) -> PointCloud:
    rng = np.random.default_rng(0)
    xyz = rng.uniform([-5, -5, 0], [5, 5, 4], (count, 3))
    return PointCloud(xyz=xyz, rgb=rng.integers(0, 255, (count, 3), dtype=np.uint8))


def full_folder(out: Path, *, plot: dict[str, Any] = PLOT, trees: list[dict[str, Any]] | None = None) -> Path:
    trees = trees or [
        TREE,
        TREE | {"tree_id": 2, "dbh_cm": 40.0, "dbh_lo95_cm": 38, "dbh_hi95_cm": 42, "status": "doubtful"},
        TREE | {"tree_id": 3, "dbh_cm": "", "dbh_lo95_cm": "", "dbh_hi95_cm": "", "status": "unmeasured"}
        | {"reason": "seen from one side <only>"},
    ]  # fmt: skip
    write_csv(out / "trees.csv", trees)
    (out / "plot.json").write_text(json.dumps(plot))
    rows = [
        {"file": "a.jpg", "chosen": "true", "reason": ""},
        {"file": "b.jpg", "chosen": "false", "reason": "blurred"},
    ]
    write_csv(out / "frames" / "frames.csv", rows)
    write_cloud(out / "cloud.ply", small_cloud())
    for name in ("stem_map", "tree_001", "tree_003", "tree_099"):
        write_image(out / "figures" / f"{name}.png", np.full((40, 50, 3), 200, np.uint8))
    for i in range(4):
        write_pfm(out / "depth" / f"v{i}.pfm", np.linspace(1, 5, 600, dtype=np.float32).reshape(20, 30))
        write_image(out / "scene" / "images" / f"v{i}.jpg", np.full((400, 1300, 3), 90, np.uint8))
    return out


def test_everything_is_in_one_file_without_any_outside_reference(tmp_path: Path) -> None:
    path = make_report(full_folder(tmp_path))
    page = path.read_text(encoding="utf-8")
    assert path == tmp_path / "report.html"
    outside = r"https?://|src=\"(?!data:)|href=\"(?!#|data:)|@import|url\(|fetch\(|XMLHttpRequest|import\("
    assert not re.findall(outside, page)
    # Two sections; two views of the cloud; three depth maps with their photos. There is no scene: no crops.
    assert page.count('src="data:image/webp;base64,') == 2 + 2 + 3 * 2
    for text in ("30.0", "29.1 to 30.9", "80%", "birch &lt;b&gt;plot&lt;/b&gt;", "abc123", "2 h 47 min", "blurred"):
        assert text in page, text
    assert '<p class="reason">seen from one side &lt;only&gt;</p>' in page
    assert "Only 25 of 40 photos" in page
    assert "100 m²" in page
    assert "model units, not metres" not in page
    assert page.index("What to look out for") < page.index("Stem map and trees") < page.index("How it was made")


def test_a_hectare_of_stems_can_be_read(tmp_path: Path) -> None:
    """Circles of a hectare's map stand apart, as those of a few do, and a warning does not name a thousand trees."""
    places = [(2.5 * i, 2.5 * j) for i in range(40) for j in range(40)]
    rows = [TREE | {"tree_id": k, "x_m": x, "y_m": y} for k, (x, y) in enumerate(places, start=1)]
    doubtful = [row | {"status": "doubtful"} if k < 1000 else row for k, row in enumerate(rows)]
    for trees, crowd in ((doubtful, True), (rows[:6], False)):
        write_csv(tmp_path / "trees.csv", trees)
        (tmp_path / "plot.json").write_text(json.dumps(PLOT))
        page = make_report(tmp_path).read_text(encoding="utf-8")
        circles = re.findall(r'class="stem" cx="([\d.]+)" cy="([\d.]+)" r="([\d.]+)"', page)
        found = np.array(circles, dtype=np.float64)
        assert len(found) == len(trees)
        across = float(np.diff(np.unique(np.round(found[:, 1]))).min())
        assert 2 * found[:, 2].max() < across
        assert (found[:, 2].min() < 6.0) == crowd
        assert ("--crowd: 1.000" in page) != crowd
        if crowd:
            assert ' data-card="60">60</a> and 940 more are doubtful' in page
            assert page.count(" more are doubtful") == 1


def test_lines_of_a_map_in_map_coordinates_tell_where_they_are(tmp_path: Path) -> None:
    """Northings read 5.81234e+06, on two lines the same, most of it beyond the edge."""
    places = ((468_000.0, 5_812_350.0), (468_015.0, 5_812_362.0))
    write_csv(tmp_path / "trees.csv", [TREE | {"tree_id": k, "x_m": x, "y_m": y} for k, (x, y) in enumerate(places)])
    (tmp_path / "plot.json").write_text(json.dumps(PLOT))
    page = make_report(tmp_path).read_text(encoding="utf-8")
    labels = re.findall(r'<text class="axis" x="([\d.]+)" y="[\d.]+"( text-anchor="\w+")?>(\d+)<', page)
    northings = [(float(x), anchor, int(label)) for x, anchor, label in labels if label.startswith("58")]
    assert sorted(northing for _, _, northing in northings) == [5_812_350, 5_812_355, 5_812_360]
    # They begin within the drawing, at its edge.
    assert all(x >= 0.0 and not anchor for x, anchor, _ in northings)
    assert {int(label) for _, _, label in labels if label.startswith("468")} >= {468_005, 468_010}


def test_warnings_name_the_trees_to_visit_again(tmp_path: Path) -> None:
    write_csv(
        tmp_path / "trees.csv",
        [
            TREE,
            TREE | {"tree_id": 2, "status": "doubtful"},
            TREE | {"tree_id": 3, "dbh_cm": "", "status": "unmeasured"},
            TREE | {"tree_id": 4, "dbh_cm": "", "status": "unmeasured"},
            TREE | {"tree_id": 5, "arc_coverage": 0.3},
        ],
    )
    (tmp_path / "plot.json").write_text(json.dumps(PLOT | {"scale_rel_std": 0.02, "warnings": ["a board lies flat"]}))
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert 'Tree <a href="#tree-2" data-card="2">2</a> is doubtful' in page
    assert '<a href="#tree-3" data-card="3">3</a> and <a href="#tree-4" data-card="4">4</a> have no diameter' in page
    assert 'Tree <a href="#tree-5" data-card="5">5</a> was seen from one side only' in page
    assert "a stem of 30 cm may be 1.2 cm thicker or thinner" in page
    assert "<li>A board lies flat.</li>" in page
    assert "Remarks" not in page


def coded(code: str, text: str, *, remark: bool = False, **values: object) -> dict[str, object]:
    return {"code": code, "values": values, "text": text, "remark": remark}


def test_remarks_are_those_that_say_so_whatever_their_words(tmp_path: Path) -> None:
    write_csv(tmp_path / "trees.csv", [TREE])
    codes = [
        coded("board_flat", "a board lies flat beside points far outside the plot"),
        coded("points_far_outside", "3 strays were left out", remark=True, points=3),
        "no object",
        {"code": "no_text"},
    ]
    plot = PLOT | {"registered": 40, "warnings": ["said in another way"], "warning_codes": codes}
    (tmp_path / "plot.json").write_text(json.dumps(plot))
    page = make_report(tmp_path).read_text(encoding="utf-8")
    first, remarks = page.split("<summary>Remarks</summary>")
    assert "<li>A board lies flat beside points far outside the plot.</li>" in first
    assert "<li>3 strays were left out.</li>" in remarks
    assert "strays" not in first
    assert "said in another way" not in page
    # A plot with mere remarks is as it should be.
    (tmp_path / "plot.json").write_text(json.dumps(plot | {"warning_codes": codes[1:]}))
    assert "photos, scale and stems are as they should be" in make_report(tmp_path).read_text(encoding="utf-8")


def test_sentences_without_codes_are_all_warnings(tmp_path: Path) -> None:
    write_csv(tmp_path / "trees.csv", [TREE])
    sentences = ["3 points far outside the plot were left out", "tree 4 was corrected by hand"]
    (tmp_path / "plot.json").write_text(json.dumps(PLOT | {"warnings": sentences}))
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "<li>3 points far outside the plot were left out.</li>" in page
    assert "<li>Tree 4 was corrected by hand.</li>" in page
    assert "Remarks" not in page


def test_a_sentence_that_stands_twice_is_said_once(tmp_path: Path) -> None:
    write_csv(tmp_path / "trees.csv", [], columns=list(TREE))
    codes = [coded("no_trees", "no stem reaches breast height")]
    plot = PLOT | {"diagnosis": "no stem reaches breast height", "warning_codes": codes}
    (tmp_path / "plot.json").write_text(json.dumps(plot))
    assert make_report(tmp_path).read_text(encoding="utf-8").count("<li>No stem reaches breast height.</li>") == 1


def test_a_plot_without_fault_says_so(tmp_path: Path) -> None:
    write_csv(tmp_path / "trees.csv", [TREE])
    (tmp_path / "plot.json").write_text(json.dumps(PLOT | {"registered": 40, "warnings": []}))
    assert "photos, scale and stems are as they should be" in make_report(tmp_path).read_text(encoding="utf-8")


def test_stand_table(tmp_path: Path) -> None:
    full_folder(tmp_path, plot=PLOT | {"plot_area_m2": 500})
    stand = stand_of(read_contents(tmp_path))
    assert (stand.stems, stand.measured) == (3, 2)
    assert stand.mean_dbh_cm == pytest.approx(35)
    assert stand.quadratic_mean_dbh_cm == pytest.approx(35.3553, abs=1e-3)
    # The third counts with the mean of the others.
    assert stand.basal_area_m2_per_ha == pytest.approx(np.pi / 4 * (0.09 + 0.16) * 1.5 / 0.05)
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert '<th scope="row">Stems per hectare</th><td>60</td>' in page
    assert "<td>30 to under 35</td><td>1</td><td>0.071</td><td>20</td><td>1.4</td>" in page
    assert "<td>35 to under 40</td><td>0</td>" in page
    assert "<td>All with a DBH</td><td>2</td><td>0.196</td><td>40</td><td>3.9</td>" in page
    assert "5.9 m²/ha (1 without a DBH counted with what is roughly known of them, or the mean" in page
    # A sapling that is roughly known is one in a table that was changed by hand, too.
    with (tmp_path / "trees.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    lost = next(row for row in rows if not row["dbh_cm"])
    lost["reason"] = "too uncertain: 6 cm +- 2 cm; walk round the stem"
    write_csv(tmp_path / "trees.csv", rows)
    basal = stand_of(read_contents(tmp_path)).basal_area_m2_per_ha
    assert basal == pytest.approx(np.pi / 4 * (0.09 + 0.16 + 0.0036) / 0.05)
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "<td>All with a DBH</td><td>2</td><td>0.196</td><td>40</td><td>3.9</td>" in page


def test_stems_off_the_seen_ground_are_told_and_count_to_no_hectare(tmp_path: Path) -> None:
    given = {"stems": 3, "measured": 2, "plot_area_m2": 500.0, "area_method": "given", "stems_per_ha": 40.0}
    given |= {"basal_area_m2_per_ha": 3.9, "quadratic_mean_dbh_cm": 35.4, "mean_dbh_cm": 35.0, "stems_on_area": 2}
    full_folder(tmp_path, plot=PLOT | {"stand": given, "plot_area_m2": 500.0})
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert '<th scope="row">Stems on that ground</th><td>2 of 3; only they count to the hectare</td>' in page
    assert "<td>All with a DBH</td><td>2</td><td>0.196</td><td>27</td><td>2.6</td>" in page
    # Where it is known which stands elsewhere, its class has nothing to the hectare.
    known = given | {"off_area": [2], "basal_area_m2_per_ha": np.pi / 4 * (0.09 + (0.09 + 0.16) / 2) / 0.05}
    full_folder(tmp_path, plot=PLOT | {"stand": known, "plot_area_m2": 500.0})
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "<td>30 to under 35</td><td>1</td><td>0.071</td><td>20</td><td>1.4</td>" in page
    assert "<td>40 to under 45</td><td>1</td><td>0.126</td><td>0</td><td>0.0</td>" in page
    assert "<td>All with a DBH</td><td>2</td><td>0.196</td><td>20</td><td>1.4</td>" in page
    # Of a table that was changed since, the same share.
    full_folder(tmp_path, plot=PLOT | {"stand": given | {"stems": 6, "stems_on_area": 4}, "plot_area_m2": 500.0})
    assert stand_of(read_contents(tmp_path)).stems_per_ha == pytest.approx(3 / 0.05 * 4 / 6)


def test_a_stem_off_the_ground_that_counts_is_in_no_figure_of_it(tmp_path: Path) -> None:
    """It was said to be counted by the mean of the others; and means of some stems stood there as those of all."""
    given = {"stems": 3, "measured": 2, "plot_area_m2": 500.0, "stems_per_ha": 20.0, "stems_on_area": 1}
    given |= {"basal_area_m2_per_ha": np.pi / 4 * 0.09 / 0.05, "mean_dbh_cm": 30.0, "quadratic_mean_dbh_cm": 30.0}
    full_folder(tmp_path, plot=PLOT | {"stand": given | {"off_area": [2, 3]}})
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert '<th scope="row">Basal area per hectare</th><td>1.4 m²/ha</td>' in page
    assert '<th scope="row">Mean DBH</th><td>30.0 cm, of those on the ground that counts to the hectare</td>' in page
    assert '<th scope="row">Stems with a DBH</th><td>2</td>' in page


@pytest.mark.parametrize("far_stems", [False, True])
def test_stems_outside_of_the_walk_count_in_no_figure(tmp_path: Path, *, far_stems: bool) -> None:
    stems = [TREE, TREE | {"tree_id": 2, "dbh_cm": 40.0}, TREE | {"tree_id": 3, "dbh_cm": "", "status": "outside"}]
    if far_stems:  # then they are measured as any other, and their reason alone tells
        stems[2] = TREE | {"tree_id": 3, "dbh_cm": 50.0}
        reason = {"code": "outside_walk", "values": {"nearest_m": 17.0}}
        (tmp_path / "trees.json").write_text(json.dumps([{"tree_id": 3, "reasons": [reason]}]))
    given = {"stems": 2, "measured": 2, "plot_area_m2": 500.0, "area_method": "given", "stems_per_ha": 41.0}
    full_folder(tmp_path, plot=PLOT | {"stand": given}, trees=stems)
    contents = read_contents(tmp_path)
    stand = stand_of(contents)
    assert (stand.stems, stand.measured, stand.stems_per_ha) == (2, 2, 41.0)
    assert diameters_cm(contents) == [30.0, 40.0]
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert '<th scope="row">Stems found</th><td>2</td>' in page
    assert '<th scope="row">Outside of the walk</th><td>1 more, listed and not counted</td>' in page
    assert "<td>All with a DBH</td><td>2</td>" in page


def test_figures_of_the_stand_are_those_of_the_run(tmp_path: Path) -> None:
    given = {"stems": 3, "measured": 2, "plot_area_m2": 500.0, "area_method": "given", "stems_per_ha": 61.0}
    given |= {"basal_area_m2_per_ha": 7.7, "quadratic_mean_dbh_cm": 35.44, "mean_dbh_cm": 35.0}
    full_folder(tmp_path, plot=PLOT | {"stand": given})
    page = make_report(tmp_path).read_text(encoding="utf-8")
    for text in (
        "<td>35.0 cm</td>",
        "<td>35.4 cm</td>",
        "<td>500 m²</td>",
        "<td>61</td>",
        "<td>7.7 m²/ha (1 without a DBH counted",
    ):
        assert text in page, text
    assert "trees.csv was changed" not in page
    # Somebody took trees out of the table since, or wrote another diameter into it.
    for changed in ({"stems": 4}, {"mean_dbh_cm": 34.9}):
        full_folder(tmp_path, plot=PLOT | {"stand": given | changed, "plot_area_m2": 500.0})
        page = make_report(tmp_path).read_text(encoding="utf-8")
        assert "<td>35.0 cm</td>" in page
        assert '<th scope="row">Stems per hectare</th><td>60</td>' in page
        assert "trees.csv was changed after the measurement" in page


def test_without_a_border_the_figures_are_said_to_be_of_seen_ground_only(tmp_path: Path) -> None:
    full_folder(tmp_path, plot=PLOT | {"plot_area_m2": 500})
    assert "of the ground that was seen only: the plot has no border" in make_report(tmp_path).read_text(
        encoding="utf-8"
    )


def test_a_plot_with_a_border_is_told_and_drawn(tmp_path: Path) -> None:
    border = Border(center=(1.0, -2.0), radius_m=12.62, origin="marker 7", moves_along=True)
    trees = [
        TREE,
        TREE | {"tree_id": 2, "x_m": 13.5, "status": "doubtful"},
        TREE | {"tree_id": 3, "x_m": 20.0, "dbh_cm": "", "dbh_lo95_cm": "", "dbh_hi95_cm": "", "status": "unmeasured"},
    ]
    write_csv(tmp_path / "rows.csv", trees)
    plot = plot_of(read_trees(tmp_path / "rows.csv"), border, SeenShare(share=0.9, method="by eye"), slope_deg=8.0)
    rows = [
        row
        | {"in_plot": int(tree.in_plot or False), "border_m": tree.border_m, "at_border": int(tree.at_border or False)}
        for row, tree in zip(trees, plot.trees, strict=True)
    ]
    given = PLOT | {"plot_border": as_json(plot.figures), "plot_area_m2": 9999.0}
    page = make_report(full_folder(tmp_path, plot=given, trees=rows)).read_text(encoding="utf-8")
    figure = plot.figures.stems_per_ha
    assert figure is not None
    assert figure.value == pytest.approx(2 / 0.9 / (np.pi * 0.01262 * 1.262), rel=1e-3)
    for text in (
        "<td>circle of 12.62 m round marker 7</td>", "<td>500 m² (the ground slopes by 8°)</td>",
        "<td>90 % (by eye)</td>", "<td>2: 1 sure, 1 doubtful, 0 without a DBH; 1 more stand outside</td>",
        "<td>tree 2: measure in the forest whether they are in</td>",
        f"<td>44, 95 % interval {figure.lo95:.0f} to {figure.hi95:.0f} (unseen ground ± ",
        "; 22 of it from doubtful stems", "Stems per hectare, as one sample of the stand",
        "<td>All with a DBH</td><td>2</td><td>0.141</td><td>44</td><td>3.1</td>",
        'class="border"', "border of the plot (pale: outside)", 'class="tree unmeasured outside"',
        "in, 0.12 m from the border, to be measured", "out, 6.38 m from the border", "To its border (m)",
    ):  # fmt: skip
        assert text in page, text
    assert "seen only: the plot has no border" not in page
    assert "trees.csv was changed" not in page
    # Means of the seen ground are not those of what counts to the hectare here, which is the plot.
    of_ground: dict[str, object] = {
        "stems": 3,
        "measured": 2,
        "plot_area_m2": 900.0,
        "stems_per_ha": 11.0,
        "stems_on_area": 1,
    }
    of_ground |= {"basal_area_m2_per_ha": 1.0, "mean_dbh_cm": 30.0, "quadratic_mean_dbh_cm": 30.0, "off_area": [2, 3]}
    whole = [TREE | {"dbh_cm": 30.0}, TREE | {"tree_id": 2, "dbh_cm": 40.0}, TREE | {"tree_id": 3, "dbh_cm": ""}]
    write_csv(tmp_path / "rows.csv", whole)
    found = plot_of(read_trees(tmp_path / "rows.csv"), border, SeenShare(share=0.9, method="by eye"), slope_deg=8.0)
    within = [row | {"in_plot": int(tree.in_plot or False)} for row, tree in zip(whole, found.trees, strict=True)]
    told = PLOT | {"plot_border": as_json(found.figures), "stand": of_ground}
    page = make_report(full_folder(tmp_path, plot=told, trees=within)).read_text(encoding="utf-8")
    assert '<th scope="row">Mean DBH</th><td>30.0 cm, of those on the seen ground, in the plot or not</td>' in page
    assert "on the ground that counts to the hectare" not in page
    # A table that was changed since is not that of the figures.
    for changed in ({"in_plot": 0}, {"dbh_cm": 33.3}):
        now = [rows[0] | changed, *rows[1:]]
        page = make_report(full_folder(tmp_path, plot=given, trees=now)).read_text(encoding="utf-8")
        assert 'class="border"' not in page
        assert "seen only: the plot has no border" not in page
        assert "not of the plot within its border: trees.csv was changed" in page
        assert "Put corrections into edits.csv and measure again" in page


def test_classes_add_up_to_the_figures_of_the_plot(tmp_path: Path) -> None:
    border = Border(center=(1.0, -2.0), radius_m=12.62, origin="marker 7", moves_along=True)
    trees = [TREE, TREE | {"tree_id": 2, "x_m": 5.0}, TREE | {"tree_id": 3, "x_m": 8.0, "dbh_cm": 40.0}]
    write_csv(tmp_path / "rows.csv", trees)
    seen = SeenShare(share=0.5, method="by eye", stems=np.array([True, False, False]))
    plot = plot_of(read_trees(tmp_path / "rows.csv"), border, seen, slope_deg=0.0)
    rows = [row | {"in_plot": 1, "border_m": tree.border_m} for row, tree in zip(trees, plot.trees, strict=True)]
    told = as_json(plot.figures)
    given = PLOT | {"plot_border": told}
    page = make_report(full_folder(tmp_path, plot=given, trees=rows)).read_text(encoding="utf-8")
    assert "<td>All with a DBH</td><td>3</td><td>0.267</td><td>60</td><td>5.3</td>" in page
    assert "2 of these stems: they do not stand for others" in page
    # Earlier runs did not tell on which ground the stems stand.
    del told["on_unseen"]
    assert 'class="border"' in make_report(full_folder(tmp_path, plot=given, trees=rows)).read_text(encoding="utf-8")


def test_markers_and_photos_left_out_are_shown(tmp_path: Path) -> None:
    board = {"id": 21, "views": ["a", "b", "c"], "residual_rel": 0.0012, "leave_one_out_rel": -0.0004, "error_px": 0.3}
    full_folder(tmp_path, plot=PLOT | {"scale_details": {"markers": [board, {"id": 22}]}})
    write_image(tmp_path / "frames" / "frames_contact.jpg", np.full((60, 1200, 3), 90, np.uint8))
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "<td>21</td><td>3</td><td>+0.12 %</td><td>-0.04 %</td><td>0.30</td>" in page
    assert "<td>22</td><td></td>" in page
    assert "Photos that were left out" in page
    (tmp_path / "plot.json").write_text(json.dumps(PLOT | {"scale_details": {"markers": "none"}}))
    (tmp_path / "frames" / "frames_contact.jpg").write_bytes(b"no picture")
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "Scale by markers" not in page
    assert "frames_contact.jpg could not be read" in page


def test_without_a_scale_the_units_are_said(tmp_path: Path) -> None:
    plot = PLOT | {"units": "model units", "scale_m_per_unit": None, "scale_source": "none", "density_per_m2": None}
    codes = [
        coded("no_scale_given", "no scale was given: the cloud is in model units"),
        coded("markers_of_unknown_length", "no scale: markers are seen, but their length was not given"),
        coded("no_scale_from_markers", "no scale from ArUco markers: 7 is in one photo only"),
    ]
    full_folder(tmp_path, plot=plot | {"warning_codes": codes})
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "No scale is known: all lengths" in page
    assert "fsinfer scale OUT --click" in page
    assert "<li>No scale from ArUco markers: 7 is in one photo only.</li>" in page
    assert "o scale was given" not in page
    assert "<li>No scale: markers are seen, but their length was not given.</li>" in page
    assert "x (units)" in page
    assert "x (m)" not in page


def test_where_no_tree_has_a_dbh_the_table_has_no_column_of_its_interval(tmp_path: Path) -> None:
    bare = TREE | {"dbh_cm": "", "dbh_lo95_cm": "", "dbh_hi95_cm": "", "status": "unmeasured", "reason": "no scale"}
    full_folder(tmp_path, trees=[bare])
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert ["interval (cm)" in page, "An empty DBH" in page] == [False, False]
    full_folder(tmp_path, trees=[TREE, bare | {"tree_id": 2}])
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert ["interval (cm)" in page, "An empty DBH" in page] == [True, True]


def test_a_single_tree_without_a_scale_has_a_map_that_can_be_read(tmp_path: Path) -> None:
    plot = PLOT | {"units": "model units", "scale_m_per_unit": None, "scale_source": "none", "camera_height": 0.3}
    full_folder(tmp_path, plot=plot, trees=[TREE])
    page = make_report(tmp_path).read_text(encoding="utf-8")
    ticks = {float(text) for text in re.findall(r'class="axis"[^>]*>(-?[\d.]+)<', page)}
    # Four metres, of which each is a fifth of a unit.
    assert max(ticks) - min(ticks) + 0.2 >= 0.8
    assert len(ticks) >= 4
    assert "<b>1</b><span>stem found" in page


def test_stems_far_outside_of_the_walk_do_not_shrink_the_map(tmp_path: Path) -> None:
    far = TREE | {"tree_id": 9, "x_m": 300.0, "dbh_cm": "", "status": "outside"}
    full_folder(tmp_path, trees=[TREE, far])
    page = make_report(tmp_path).read_text(encoding="utf-8")
    ticks = [float(text) for text in re.findall(r'class="axis"[^>]*>(-?[\d.]+)<', page)]
    assert max(ticks) - min(ticks) < 60
    assert "1 outside of the walk, beyond the map" in page
    full_folder(tmp_path, trees=[far])  # where there are no others they are shown
    assert "beyond the map" not in make_report(tmp_path).read_text(encoding="utf-8")


def test_a_page_of_very_many_trees_has_pictures_of_those_that_ask_for_them(tmp_path: Path) -> None:
    doubtful = {500, 777}
    trees = [TREE | {"tree_id": n, "status": "doubtful" if n in doubtful else "ok"} for n in range(1, 801)]
    full_folder(tmp_path, trees=trees)
    picture = np.random.default_rng(0).integers(0, 255, (40, 50, 3), dtype=np.uint8)
    for n in range(1, 800):
        write_image(tmp_path / "figures" / f"tree_{n:03d}.png", picture)
    page = make_report(tmp_path).read_text(encoding="utf-8")
    cards = {
        int(n): card for n, card in re.findall(r'<article class="card" id="tree-(\d+)"(.*?)</article>', page, re.S)
    }
    assert len(cards) == 800
    assert {n for n, card in cards.items() if "data:image" in card} == doubtful | set(range(1, 299))
    note = "This page has pictures of 300 trees only, of the doubtful ones first."
    assert f"{note} The section of this tree is figures/tree_299.png." in cards[299]
    assert note in cards[800]
    assert "tree_800.png" not in cards[800]
    assert note not in cards[777] + cards[1]


def test_parts_of_the_walk_have_links_to_their_reports_and_nothing_else_has(tmp_path: Path) -> None:
    part = {"folder": "part-2", "photos": 26, "registered": 26, "trees": 7, "trees_with_dbh": 6, "error": ""}
    failed = part | {"folder": "part-3", "error": "too dark"}
    hostile = part | {"folder": "javascript:alert(1)"}
    full_folder(tmp_path, plot=PLOT | {"parts": [part, failed, hostile, "nonsense"]})
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "26 photos that nothing ties to the rest were measured on their own scale: 7 trees, 6 with a DBH" in page
    assert '<a href="part-2/report.html">' in page
    # What lies in its folder is of an earlier run.
    assert "could not be measured: too dark" in page
    assert "part-3/report.html" not in page
    assert "javascript:" not in page


def test_a_part_that_was_joined_is_said_with_its_stems_and_counts_as_placed(tmp_path: Path) -> None:
    part = {"folder": "part-2", "photos": 16, "registered": 14, "trees": 7, "trees_with_dbh": 6, "error": ""}
    joined = part | {"joined": {"name": "part-2", "common": 5, "new": 2}}
    rows = [TREE | {"tree_id": 1, "part": ""}, TREE | {"tree_id": 2, "part": "part-2", "reason": "little seen"}]
    full_folder(tmp_path, plot=PLOT | {"parts": [joined]}, trees=rows)
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "put into this plot by the pattern of their stems: 5 that the rest saw too, and 2 new ones." in page
    assert '<a href="part-2/report.html">' in page
    assert "on their own scale" not in page
    remark = "measured in part-2, and put here by the pattern of the stems; little seen"
    assert page.count(remark) == 3  # on the card, in the table, and what that is sorted by
    # 25 of 40 photos and the 14 of the part are nearly all.
    assert "photos could be placed" not in page
    assert "39 of 40" in page  # the large number says the same
    full_folder(tmp_path, plot=PLOT | {"parts": [part | {"joined": None}]}, trees=rows)
    assert "Only 25 of 40 photos could be placed" in make_report(tmp_path).read_text(encoding="utf-8")


def test_the_reasons_of_few_trees_without_a_diameter_are_said_at_once(tmp_path: Path) -> None:
    none = TREE | {"dbh_cm": "", "status": "unmeasured"}
    rows = [none | {"tree_id": number, "reason": f"why {number}"} for number in (1, 2, 3)]
    full_folder(tmp_path, trees=rows)
    assert "no diameter: why 1; why 2; why 3." in make_report(tmp_path).read_text(encoding="utf-8")


def test_the_advice_to_walk_round_is_given_once(tmp_path: Path) -> None:
    none = TREE | {"dbh_cm": "", "status": "unmeasured"}
    rows = [none | {"tree_id": 1, "reason": "do walk round it"}, none | {"tree_id": 2, "reason": "two walls"}]
    advice = "Mostly it helps to walk round the stem again"

    def page_with(entries: object) -> str:
        (tmp_path / "trees.json").write_text(entries if isinstance(entries, str) else json.dumps(entries))
        return make_report(tmp_path).read_text(encoding="utf-8")

    full_folder(tmp_path, trees=rows)
    # The words of a reason decide nothing.
    assert advice in make_report(tmp_path).read_text(encoding="utf-8")
    reason = {"code": "thin_arc", "values": {"seen_deg": 40}}
    assert advice in page_with([{"tree_id": 1, "status": "unmeasured", "reasons": [reason]}])
    entries = [{"tree_id": 1, "status": "unmeasured", "reasons": [reason | {"advises_revisit": True}]}]
    assert advice not in page_with([{"tree_id": None}, 7, {"tree_id": 2, "reasons": "none"}, *entries])
    # Not where the advice is on the card only.
    full_folder(tmp_path, trees=[*rows, none | {"tree_id": 3}])
    assert advice in page_with(entries)
    page = page_with("{}")
    assert "trees.json could not be read" in page
    assert advice in page


def test_a_cloud_of_a_scanner_is_not_advised_to_be_photographed(tmp_path: Path) -> None:
    lost = TREE | {"tree_id": 2, "dbh_cm": "", "status": "unmeasured", "reason": "w"}
    write_csv(tmp_path / "trees.csv", [TREE, lost])
    (tmp_path / "plot.json").write_text(json.dumps({"source": "a.laz", "units": "m", "warnings": []}))
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "has no diameter: w.</li>" in page
    assert "walk round" not in page


def test_a_run_that_has_only_begun_gives_a_page_that_says_what_is_missing(tmp_path: Path) -> None:
    (tmp_path / ".fsinfer").mkdir()
    page = make_report(tmp_path).read_text(encoding="utf-8")
    for text in ("plot.json is not", "trees.csv is not", "no point cloud", "no depth maps", "frames.csv is not"):
        assert text in page, text


def test_damaged_parts_are_notes(tmp_path: Path) -> None:
    full_folder(tmp_path)
    (tmp_path / "plot.json").write_text("{")
    (tmp_path / "trees.csv").write_bytes(b"\xff\xfe\x00tree")
    (tmp_path / "cloud.ply").write_bytes(b"ply\nnothing")
    (tmp_path / "depth" / "v0.pfm").write_bytes(b"Pf\n3 3\n-1\n")
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "plot.json could not be read" in page
    assert "trees.csv could not be read (it is no text in UTF-8; save it so again)" in page
    # What is there and damaged is not said to be missing.
    assert "is not in this folder" not in page
    assert "codec" not in page
    assert "The cloud could not be shown" in page
    assert "v0.pfm could not be shown" in page
    assert "Depth of v2" in page


def test_no_trees_is_a_result_with_a_diagnosis(tmp_path: Path) -> None:
    write_csv(tmp_path / "trees.csv", [], columns=list(TREE))
    (tmp_path / "plot.json").write_text(json.dumps(PLOT | {"diagnosis": "no stem reaches breast height"}))
    page = make_report(tmp_path).read_text(encoding="utf-8")
    assert "No trees were found." in page
    assert "no stem reaches breast height" in page


@pytest.mark.parametrize("bordered", [True, False])
def test_a_plot_without_stems_has_its_area_and_its_figures(tmp_path: Path, *, bordered: bool) -> None:
    """The report of a clearing said nothing of the plot: neither its area nor that nothing stands on it."""
    write_csv(tmp_path / "trees.csv", [], columns=list(TREE))
    plot = PLOT | {"stand": as_json(stand_of_diameters([], 400.0)), "plot_area_m2": 400.0}
    if bordered:
        border = Border(center=(1.0, -2.0), radius_m=12.62, origin="marker 7", moves_along=True)
        figures = plot_of([], border, SeenShare(share=1.0, method="by eye"), slope_deg=0.0).figures
        plot |= {"plot_border": as_json(figures)}
    (tmp_path / "plot.json").write_text(json.dumps(plot))
    page = make_report(tmp_path).read_text(encoding="utf-8")
    if bordered:
        assert "<td>circle of 12.62 m round marker 7</td>" in page
        assert '<th scope="row">Stems per hectare</th><td>0, 95 % interval 0 to 0' in page
        assert '<th scope="row">Basal area per hectare</th><td>0.0 m²/ha: no stem in the plot' in page
    else:
        assert '<th scope="row">Plot area</th><td>400 m²</td>' in page
        assert '<th scope="row">Stems per hectare</th><td>0</td>' in page
        assert '<th scope="row">Basal area per hectare</th><td>0.0 m²/ha</td>' in page


@pytest.mark.parametrize("bordered", [True, False])
def test_large_areas_and_numbers_of_stems_are_written_as_other_large_numbers(tmp_path: Path, *, bordered: bool) -> None:
    plots = [PLOT | {"plot_area_m2": area_m2} for area_m2 in (10_007, 10)]
    if bordered:
        border = Border(center=(1.0, -2.0), radius_m=60.0, origin="marker 7", moves_along=True)
        figures = plot_of([], border, SeenShare(share=1.0, method="by eye"), slope_deg=0.0).figures
        assert figures.stems_per_ha is not None
        many = replace(figures.stems_per_ha, value=1606.2, lo95=1411.8, hi95=1800.0)
        plots = [plots[0] | {"plot_border": as_json(replace(figures, stems_per_ha=many))}]
    page = ""
    for plot in plots:
        full_folder(tmp_path, plot=plot)
        page += make_report(tmp_path).read_text(encoding="utf-8")
    if bordered:
        assert '<th scope="row">Plot area, horizontal</th><td>11,310 m² (' in page
        assert '<th scope="row">Stems per hectare</th><td>1,606, 95 % interval 1,412 to 1,800' in page
    else:
        assert '<th scope="row">Plot area</th><td>10,007 m²</td>' in page
        assert '<th scope="row">Stems per hectare</th><td>3,000</td>' in page


def test_stems_outside_of_the_walk_that_stand_in_the_plot_are_told_as_such(tmp_path: Path) -> None:
    """The page said "3 stems in the plot, of 1 found", and of all outside of the walk that they are not counted."""
    border = Border(center=(1.0, -2.0), radius_m=12.62, origin="marker 7", moves_along=True)
    beyond = TREE | {"dbh_cm": "", "dbh_lo95_cm": "", "dbh_hi95_cm": "", "status": "outside"}
    trees = [TREE, *(beyond | {"tree_id": n, "x_m": x} for n, x in ((2, 6.0), (3, 9.0), (4, 30.0)))]
    write_csv(tmp_path / "rows.csv", trees)
    plot = plot_of(read_trees(tmp_path / "rows.csv"), border, SeenShare(share=1.0, method="by eye"), slope_deg=0.0)
    rows = [row | {"in_plot": int(bool(tree.in_plot))} for row, tree in zip(trees, plot.trees, strict=True)]
    given = PLOT | {"plot_border": as_json(plot.figures), "stand": {"stems": 1, "measured": 1}}
    page = make_report(full_folder(tmp_path, plot=given, trees=rows)).read_text(encoding="utf-8")
    assert "stems in the plot, of 4 found" in page
    assert (
        '<th scope="row">Outside of the walk</th><td>3 more, listed and not counted, but for 2 in the plot</td>' in page
    )


def test_not_a_folder_is_a_user_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a folder"):
        make_report(tmp_path / "none")


def test_a_folder_of_something_else_is_a_user_error(tmp_path: Path) -> None:
    (tmp_path / "IMG_1.jpg").write_bytes(b"no run")
    with pytest.raises(InputError, match="is no output folder of fsinfer"):
        make_report(tmp_path)
    assert not (tmp_path / "report.html").exists()
    write_csv(tmp_path / "trees.csv", [TREE])
    assert make_report(tmp_path).is_file()


@pytest.mark.parametrize(("text", "value"), [("1.5", 1.5), ("", None), ("nan", None), ("inf", None), (None, None)])
def test_number(text: str | None, value: float | None) -> None:
    assert number(text) == value

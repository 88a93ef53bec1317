"""What benchmarks write into their result files: the right figures, with names that say their unit."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.evaluation.measured import MeasuredTree
from fsinfer.evaluation.metrics import evaluate
from fsinfer.io.pfm import write_pfm
from fsinfer.scene import read_scene
from fsinfer.trees.tree import Tree
from tests.bench import demo, depth, plot, same, stems
from tests.bench.check import OUTCOMES, figure_name
from tests.bench.results import FIGURE
from tests.support.plane_scene import write_plane_scene
from training.simulate.stem_cloud import StemTruth

#: What each benchmark cannot do without.
ARGUMENTS = {
    "ablation": ["--data", "a", "--test", "b", "--out", "c"],
    "busy": ["scene", "work"],
    "check": ["plot", "out"],
    "cloud": ["plot", "out"],
    "cloud_size": ["work"],
    "demo": ["out"],
    "dendromatics": ["--python", "python"],
    "depth": ["scenes"],
    "effects": ["out"],
    "epipolar": ["scene"],
    "halves": ["photos", "out"],
    "judged": ["scene"],
    "kill": ["work"],
    "parity": ["scene"],
    "photos": ["photos", "out"],
    "plot": ["plot", "out"],
    "plot_speed": ["plot", "out"],
    "poses": ["plot"],
    "real_pairs": ["scene"],
    "relief": [],
    "resampled": ["scan.laz"],
    "same": ["work"],
    "sfm_mvs": ["plot", "out"],
    "speed": [],
    "stem_curve": ["plot", "out"],
    "stems": [],
    "stereo": [],
    "trunks": ["trunks", "out"],
    "video": ["out"],
}


def tree(tree_id: int, x_m: float, dbh_cm: float | None, half_cm: float = 1.0) -> Tree:
    return Tree(
        tree_id=tree_id,
        x_m=x_m,
        y_m=0.0,
        z_ground_m=0.0,
        dbh_cm=dbh_cm,
        dbh_lo95_cm=None if dbh_cm is None else dbh_cm - half_cm,
        dbh_hi95_cm=None if dbh_cm is None else dbh_cm + half_cm,
        dbh_perimeter_cm=None,
        dbh_min_cm=None,
        dbh_max_cm=None,
        bh_m=1.3,
        arc_coverage=1.0,
        points=100,
        residual_cm=None,
        lean_deg=0.0,
        height_m=None,
        status="ok",
        reasons=(),
    )


def stem(tree_id: int, dbh_cm: float, seen_deg: float = 360.0, tags: tuple[str, ...] = ()) -> StemTruth:
    return StemTruth(
        x_m=float(tree_id), y_m=0.0, z_ground_m=0.0, dbh_cm=dbh_cm, tree_id=tree_id, seen_deg=seen_deg, tags=tags
    )


@pytest.mark.parametrize("name", sorted(ARGUMENTS))
def test_a_result_needs_the_kind_of_its_set(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    main = importlib.import_module(f"tests.bench.{name}").main
    with pytest.raises(SystemExit) as stopped:
        main([*ARGUMENTS[name], "--result", "try"])
    assert stopped.value.code == 2
    assert "--result needs --result-set" in capsys.readouterr().err


def test_every_benchmark_is_in_the_test_above() -> None:
    paths = [path for path in Path(__file__).parent.glob("*.py") if not path.name.startswith("test_")]
    writing = {path.stem for path in paths if "    add_result_options(parser)" in path.read_text(encoding="utf-8")}
    assert writing == ARGUMENTS.keys()


def test_stems_count_what_was_found_measured_and_held_by_its_interval() -> None:
    matches = [
        stems.Match(seed=1, truth=stem(1, 30.0), tree=tree(1, 1.0, 30.5)),
        stems.Match(seed=1, truth=stem(2, 15.0, seen_deg=180.0), tree=tree(2, 2.0, 12.0)),
        stems.Match(seed=1, truth=stem(3, 50.0, tags=("double wall",)), tree=tree(3, 3.0, None)),
        stems.Match(seed=1, truth=stem(4, 20.0), tree=None),
        stems.Match(seed=1, truth=None, tree=tree(5, 9.0, 10.0)),
    ]
    figures = stems.figures_of(matches)
    counts = {"stems": 4, "found": 3, "false": 1, "measured": 2, "refused": 1, "inside_interval": 1}
    assert {name: figures[name] for name in counts} == counts
    assert figures["rmse_cm"] == pytest.approx(((0.5**2 + 3.0**2) / 2) ** 0.5)
    assert figures["bias_cm"] == pytest.approx(-1.25)
    assert figures["hidden_worst_cm"] == pytest.approx(3.0)
    assert (figures["double_wall_refused"], figures["double_wall_stems"]) == (1, 1)
    # Sections of 30 and 15 cm for which 30.5 and 12 cm were found, 6 % less: within 1 cm of each together only.
    shared = [replace(m, shared_sd_m=0.01 / 1.96) for m in matches]
    assert [figures["basal_area_plots"], figures["basal_area_inside_interval"]] == [1, 1]
    tight = [replace(m, tree=m.tree and tree(1, 0.0, m.tree.dbh_cm, half_cm=0.5)) for m in matches]
    assert stems.figures_of(tight)["basal_area_inside_interval_percent"] == 0
    wider = stems.figures_of(shared)["basal_area_half_width_median_percent"]
    assert wider == pytest.approx(100 * 2 * 42.5 / (30.5**2 + 12.0**2), rel=1e-3)
    assert figures["basal_area_half_width_median_percent"] == pytest.approx(wider * np.hypot(30.5, 12) / 42.5, rel=1e-3)
    assert all(FIGURE.fullmatch(name) for name in figures)
    assert "double wall: n 1, none measured" in stems.summary(figures)


def test_trees_of_a_plot_as_figures() -> None:
    measured = [MeasuredTree(tree_id=str(i), x_m=float(i), y_m=0.0, dbh_cm=30.0) for i in range(1, 4)]
    result = evaluate(measured, [tree(1, 1.0, 30.2), tree(2, 2.0, 31.5)], align="never")
    figures = plot.tree_figures(result, [True, False])
    assert (figures["trees"], figures["matched"], figures["omitted"]) == (3, 2, 1)
    assert figures["completeness_percent"] == pytest.approx(200 / 3)
    assert figures["worst_cm"] == pytest.approx(1.5)
    assert (figures["inside_interval"], figures["with_interval"]) == (1, 2)


def test_a_run_takes_as_long_as_its_stages_and_not_twice_as_long() -> None:
    summary = {"seconds": {"poses": 90.0, "depth": 30.0, "total": 120.0}, "depth_vs_sfm_median_rel": 0.002}
    figures = plot.run_figures(summary | {"photos": 9, "registered": 7, "peak_rss_mb": 1})
    assert (figures["minutes"], figures["poses_s"]) == (2, 90)
    assert figures["photos_not_registered"] == 2
    assert figures["depth_vs_sfm_percent"] == pytest.approx(0.2)


def test_shares_become_per_cent_and_units_centimetres() -> None:
    errors = dict.fromkeys((*depth.SHARES, *depth.LENGTHS), 0.25) | {"flying": float("nan")}
    report = {"views": {"a": 0.0, "b": 0.0}, "mean": errors, "pooled": errors}
    figures = depth.figures_of(report, unit_m=2.0)
    assert figures["views"] == 2
    assert figures["mean_within_1pct_percent"] == 25
    assert figures["pooled_median_abs_cm"] == 50
    assert "mean_flying_percent" not in figures
    unknown = depth.figures_of(report, unit_m=None)
    assert not [name for name in unknown if name.endswith("_cm") or "3cm" in name]


def test_outcomes_of_the_check_have_names_of_figures() -> None:
    assert all(FIGURE.fullmatch(figure_name(label)) for label in OUTCOMES)


def test_the_demo_runs_without_a_developers_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONPATH"):
        monkeypatch.setenv(name, "1")
    monkeypatch.setenv("PATH", "/bin")
    environment = demo.user_environment()
    assert environment["PATH"] == "/bin"
    assert not {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONPATH"} & environment.keys()


def test_other_code_has_another_digest(tmp_path: Path) -> None:
    for name, text in (("a", "x = 1\n"), ("b", "x = 1\n"), ("c", "x = 2\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "module.py").write_text(text, encoding="utf-8")
        (tmp_path / name / "data.json").write_text(json.dumps(name), encoding="utf-8")
    digests = [demo.digest_of(tmp_path / name) for name in "abc"]
    assert digests[0] == digests[1] != digests[2]


def test_runs_are_compared_stem_by_stem() -> None:
    first = [tree(1, 0.0, 30.0), tree(2, 2.0, 20.0), tree(3, 4.0, None), tree(4, 9.0, 12.0)]
    other = [tree(7, 2.004, 20.3, half_cm=1.4), tree(8, 0.0, 29.9), tree(9, 4.0, 15.0), tree(10, 9.4, 12.0)]
    found = same.differences(first, other)
    assert found["stems"] == 4
    assert found["unmatched"] == 2  # the one at 9 m and the one at 9.4 m
    assert found["changed"] == 1  # with a DBH in one run only
    assert found["dbh_cm"] == pytest.approx(0.3)
    assert found["half_width_cm"] == pytest.approx(0.4)
    assert found["place_mm"] == pytest.approx(4.0)


def test_stems_of_two_runs_are_one_where_they_stand_in_one_place() -> None:
    def apart(first: list[float], other: list[float]) -> tuple[float, float]:
        found = same.differences(
            [tree(k, x, 20.0) for k, x in enumerate(first)], [tree(k, x, 20.0) for k, x in enumerate(other)]
        )
        return found["unmatched"], found["place_mm"]

    assert apart([0.0, 0.1], [0.08]) == pytest.approx((1, 20.0))  # the nearer one
    assert apart([0.0], [0.31]) == (2, 0.0)
    assert apart([], [0.0]) == (1, 0.0)


def test_maps_are_compared_pixel_by_pixel(tmp_path: Path) -> None:
    for name, values in (("a", [[2.0, 4.0]]), ("b", [[2.0, 4.4]])):
        write_pfm(tmp_path / name / "view.pfm", np.array(values, np.float32))
    assert same.compared(tmp_path / "a", tmp_path / "b", relative=True) == pytest.approx([0.0, 0.1])
    assert same.compared(tmp_path / "a", tmp_path / "b", relative=False) == pytest.approx([0.0, 0.4])


def test_few_views_are_a_scene_of_their_own(tmp_path: Path) -> None:
    whole = write_plane_scene(tmp_path / "whole", views=5, height=12, width=12)
    same.few_views(whole, tmp_path / "few", 3)
    scene = read_scene(tmp_path / "few")
    assert [view.sources for view in scene.views] == [(1, 2), (0, 2), (1, 0)]
    assert (tmp_path / "few" / "images" / "2.png").is_file()

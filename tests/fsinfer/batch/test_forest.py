"""``fsinfer batch`` says what its plots tell of the forest: in the tables, the page and the terminal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fsinfer.cli.app import app
from tests.support.batch_plots import STAND_IN, behave, read_csv, write_table
from tests.support.workbook import read_sheets


@pytest.fixture(autouse=True)
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    from fsinfer.batch import attempt

    real = attempt._command_line
    monkeypatch.setattr(attempt, "_command_line", lambda task: (*STAND_IN, *real(task)[4:]))


def batch(table: Path, out: Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["batch", str(table), str(out)], env={"COLUMNS": "300"})
    return result.exit_code, " ".join(result.output.replace("│", " ").split())


def figure(value: float) -> dict[str, float]:
    return {"value": value, "lo95": 0.9 * value, "hi95": 1.1 * value}


def stand(folder: Path, name: str, stems_per_ha: float, **border: Any) -> None:
    """Let a plot have so many stems, of 0.05 m² each."""
    known = {"stems_per_ha": figure(stems_per_ha), "basal_area_m2_per_ha": figure(0.05 * stems_per_ha)}
    behave(folder, name, border=known | border)


def test_two_strata(tmp_path: Path) -> None:
    beech, spruce = {"stratum": "beech <old>", "stratum_ha": 30}, {"stratum": "spruce", "stratum_ha": 10}
    densities = {"b1": 400.0, "s1": 200.0, "b2": 500.0, "s2": 300.0, "b3": 600.0}
    rows = [{"name": name, **(beech if name[0] == "b" else spruce)} for name in densities]
    table, out = write_table(tmp_path, [*rows, {"name": "dark", **spruce}, {"name": "bare", **beech}]), tmp_path / "out"
    for name, density in densities.items():
        stand(tmp_path, name, density)
    behave(tmp_path, "dark", exit=2, say="Error: too dark")
    behave(tmp_path, "bare", border=None)
    code, said = batch(table, out)
    assert code == 3
    assert "Forest by 5 plots (stratified): 438 stems/ha (267 to 608, sampling error 39.0 %); 21.9 m²/ha" in said
    assert "On 40 ha: 17500 stems, 875 m²" in said
    left = "left out: 2 of 7 plots (1 failed: dark, 1 without a border: bare)"
    assert f"Beware: {left}" in said
    of_all, first, second = read_csv(out / "estimates.csv")
    assert (of_all["stems_per_ha"], of_all["stems_per_ha_se"], of_all["stems"]) == ("437.5", "45.1", "17500.0")
    assert left in of_all["remarks"]
    assert (first["stratum"], first["stems_per_ha"], second["stratum"]) == ("beech <old>", "500.0", "spruce")
    sheets = {sheet.name: sheet.rows() for sheet in read_sheets(out / "summary.xlsx")}
    assert list(sheets) == ["plots", "trees", "estimates"]
    assert sheets["estimates"][0] == list(of_all)
    assert sheets["estimates"][1][:4] == ["all", None, "stratified", 5.0]
    told = json.loads((out / "summary.json").read_text(encoding="utf-8"))["estimates"]
    assert [row["stratum"] for row in told["rows"]] == ["", "beech <old>", "spruce"]
    assert told["rows"][0]["stems"]["value"] == pytest.approx(17500.0)
    assert told["notices"][0]["code"] == "plots_left_out"
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.index('id="forest"') < page.index('id="plots"')
    assert "Stratum beech &lt;old&gt;, 3 plots, 30 ha: mean of plots of equal area" in page
    assert "<td>438</td>" in page
    assert left in page
    summary = {row["plot"]: row for row in read_csv(out / "summary.csv")}
    assert (summary["b1"]["stratum"], summary["b1"]["stratum_ha"], summary["b1"]["has_border"]) == (
        "beech <old>", "30.0", "1",
    )  # fmt: skip
    assert (summary["bare"]["has_border"], summary["dark"]["has_border"]) == ("0", "")


def test_another_stratum_measures_no_plot_again_and_its_table_is_new(tmp_path: Path) -> None:
    rows: list[dict[str, object]] = [{"name": name, "stratum": ""} for name in "ab"]
    table, out = write_table(tmp_path, rows), tmp_path / "out"
    for name, density in (("a", 400.0), ("b", 500.0)):
        stand(tmp_path, name, density)
    batch(table, out)
    assert [row["scope"] for row in read_csv(out / "estimates.csv")] == ["all"]
    code, said = batch(write_table(tmp_path, [{**row, "stratum": "beech"} for row in rows]), out)
    assert code == 0
    assert said.count("done before") == 2
    assert [row["stratum"] for row in read_csv(out / "estimates.csv")] == ["", "beech"]


def test_without_a_border_there_is_no_estimate_but_its_reason(tmp_path: Path) -> None:
    table, out = write_table(tmp_path, [{"name": "a"}, {"name": "b"}]), tmp_path / "out"
    stand(tmp_path, "a", 400.0)
    stand(tmp_path, "b", 500.0)
    batch(table, out)
    assert (out / "estimates.csv").is_file()
    for name in "ab":
        behave(tmp_path, name, border=None)
    _, said = batch(table, out)
    assert "Forest" not in said
    # A table of before would contradict the rest.
    assert not (out / "estimates.csv").exists()
    assert [sheet.name for sheet in read_sheets(out / "summary.xlsx")] == ["plots", "trees"]
    told = json.loads((out / "summary.json").read_text(encoding="utf-8"))["estimates"]
    assert (told["rows"], [given["code"] for given in told["notices"]]) == ([], ["no_borders"])
    assert "No plot has a border, so that the forest is not estimated" in (out / "report.html").read_text("utf-8")


def test_estimates_of_before_that_cannot_be_taken_away_are_told(tmp_path: Path) -> None:
    """A spreadsheet that shows them holds them: that was an internal error."""
    table, out = write_table(tmp_path, [{"name": "a"}]), tmp_path / "out"
    (out / "estimates.csv").mkdir(parents=True)  # no system removes it as a file
    code, said = batch(table, out)
    assert code == 2
    assert "cannot remove the old" in said
    assert "close the program that shows it" in said


@pytest.mark.parametrize("stratum", ["", "oak"])
def test_who_has_asked_for_the_forest_is_told_why_there_is_none(tmp_path: Path, stratum: str) -> None:
    table = write_table(tmp_path, [{"name": "a", "stratum": stratum}])
    border = {"stems_per_ha": None, "basal_area_m2_per_ha": None} if not stratum else None
    behave(tmp_path, "a", border=border)
    _, said = batch(table, tmp_path / "out")
    assert (f"Forest: no plot {'has a border' if stratum else 'counts (1 of which too little was seen: a)'}") in said


def test_two_areas_of_one_stratum_are_told_before_anything_runs(tmp_path: Path) -> None:
    rows = [{"name": "a", "stratum": "beech", "stratum_ha": 30}, {"name": "b", "stratum": "Beech", "stratum_ha": 3}]
    code, said = batch(write_table(tmp_path, rows), tmp_path / "out")
    assert code == 2
    assert "row 3, column stratum_ha: stratum 'Beech' has 3 ha here and 30 ha in row 2" in said
    assert not (tmp_path / "out").exists()


def test_a_single_plot_is_given_without_an_interval(tmp_path: Path) -> None:
    table = write_table(tmp_path, [{"name": "a"}])
    stand(tmp_path, "a", 400.0)
    code, said = batch(table, tmp_path / "out")
    assert code == 0
    assert "Forest by 1 plot (mean of plots): 400 stems/ha; 20.0 m²/ha" in said
    assert "there is no standard error" in said
    assert (tmp_path / "out" / "report.html").is_file()

"""A batch on this computer: isolation, retries, resuming, and the summary of all plots."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fsinfer.batch import outcome
from fsinfer.batch.attempt import stop_batch
from fsinfer.batch.guard import Ended, GuardResult
from fsinfer.batch.outcome import State
from fsinfer.batch.remaining import RemainingPlots
from fsinfer.batch.rows import PlotRow
from fsinfer.batch.run import BatchResult, PlotNews, run_batch
from fsinfer.batch.settings import BatchSettings
from fsinfer.batch.summary import count
from fsinfer.cli.app import app
from fsinfer.cli.batch_command import _lines
from fsinfer.errors import CRASHED, NOT_ENOUGH_MEMORY, InputError
from fsinfer.io.csv_text import read_table
from fsinfer.workflow.pipeline import STAGES
from tests.support.batch_plots import STAND_IN, behave, is_alive, read_csv, started, wait_for, write_table
from tests.support.places import ROOT
from tests.support.workbook import read_sheets


def run(table: Path, out: Path, **settings: object) -> BatchResult:
    return run_batch(table, out, settings=BatchSettings(command=STAND_IN, **settings))  # type: ignore[arg-type]


def messages(result: BatchResult) -> dict[str, str]:
    return {row.plot: row.message for row in result.rows if row.state.value == "failed"}


@pytest.mark.skipif(sys.platform != "linux", reason="sees memory in /proc, and knows such signals")
def test_a_plot_that_fails_touches_no_other_and_says_why(tmp_path: Path) -> None:
    names = ("good", "input", "box", "fault", "crash", "once", "memory", "poses", "full")
    table = write_table(tmp_path, [{"name": name} for name in names] + [{"name": "also good"}])
    behave(tmp_path, "input", exit=2, say="Error: 3 of 40 photos registered; take more photos between them")
    behave(tmp_path, "box", exit=2, say="Usage: fsinfer\n╭─ Error ────╮\n│ Invalid value for '--bh': 9.0    │\n╰────╯")
    behave(tmp_path, "fault", exit=1, say="Internal error (KeyError: 'a').\x1b[0m This is a fault")
    behave(tmp_path, "crash", signal=int(signal.SIGSEGV))
    behave(tmp_path, "once", signal=int(signal.SIGKILL), once=True)
    behave(tmp_path, "memory", exit=2, say=f"Error: {NOT_ENOUGH_MEMORY}; close other programs", once=True)
    behave(tmp_path, "poses", exit=2, say=f"Error: {CRASHED} while matching photos (SIGSEGV)", once=True)
    behave(tmp_path, "full", gb=0.5, seconds=600)
    news: list[PlotNews] = []
    settings = BatchSettings(command=STAND_IN, jobs=4, retries=1, limit_gb=0.3)
    result = run_batch(table, tmp_path / "out", settings=settings, news=news.append)
    failed = messages(result)
    assert set(failed) == {"input", "box", "fault", "crash", "full"}
    assert failed["input"] == "3 of 40 photos registered; take more photos between them"
    assert failed["box"] == "Invalid value for '--bh': 9.0"
    assert failed["fault"] == "Internal error (KeyError: 'a'). [0m This is a fault"
    assert failed["crash"] == "was killed by SIGSEGV"
    assert "more than --limit-gb 0.3" in failed["full"]
    assert all("\n" not in message for message in failed.values())
    # Bad input is not worth another attempt; crashes and memory are.
    attempts = {name: started(tmp_path / "out" / "plots" / name) for name in names}
    assert attempts == {
        "good": 1, "input": 1, "box": 1, "fault": 1, "crash": 2, "once": 2, "memory": 2, "poses": 2, "full": 2,
    }  # fmt: skip
    assert {row.plot: row.attempts for row in result.rows} == attempts | {"also good": 1}
    # Each once, in the order of the table, whatever the order in which they ended.
    assert [row["plot"] for row in read_csv(tmp_path / "out" / "summary.csv")] == [*names, "also good"]
    assert sorted(item.row.plot for item in news) == sorted([*names, "also good"])
    assert [item.finished for item in news] == list(range(1, 11))


def test_a_plot_that_takes_too_long_is_ended_and_not_tried_again(tmp_path: Path) -> None:
    table = write_table(tmp_path, [{"name": "slow"}])
    behave(tmp_path, "slow", seconds=600)
    result = run(table, tmp_path / "out", limit_minutes=0.02)
    assert messages(result) == {"slow": "took longer than --limit-minutes 0.02; run again with more to go on"}
    assert result.rows[0].attempts == 1


def test_finished_plots_are_not_run_again_unless_something_has_changed(tmp_path: Path) -> None:
    names = ("same", "photo", "option", "result", "edited", "failed")
    rows: list[dict[str, object]] = [{"name": name, "scale": 0.5} for name in names]
    table, out = write_table(tmp_path, rows), tmp_path / "out"
    behave(tmp_path, "failed", exit=2, say="Error: not yet")
    first = run(table, out, jobs=3)
    assert (first.ran, first.counts.failed) == (6, 1)
    before = (out / "summary.csv").read_bytes()
    (tmp_path / "photos" / "photo" / "two.jpg").write_bytes(b"more")
    (out / "plots" / "result" / "trees.csv").unlink()
    (out / "plots" / "edited" / "edits.csv").write_text("action,tree_id\ndelete,1\n", encoding="utf-8")
    rows[2]["scale"] = 0.6
    (tmp_path / "photos" / "failed" / "behave.json").unlink()
    write_table(tmp_path, rows)
    second = run(table, out, jobs=3)
    assert second.counts.done == 6
    assert {name: started(out / "plots" / name) for name in names} == {
        "same": 1, "photo": 2, "option": 2, "result": 2, "edited": 2, "failed": 2,
    }  # fmt: skip
    third = run(table, out, threads=1)
    assert third.ran == 0
    assert third.rows == second.rows
    # A plot that is not in the table any more is not in the summary either.
    write_table(tmp_path, rows[:1])
    assert run(table, out).counts.plots == 1
    assert before.splitlines()[1] == (out / "summary.csv").read_bytes().splitlines()[1]


def put_away(folder: Path) -> None:
    """Take the photographs away, as with the memory card that they lie on."""
    (folder / "photos").rename(folder / "in the drawer")


def test_a_finished_plot_whose_photos_are_not_there_keeps_its_trees(tmp_path: Path) -> None:
    table, out = write_table(tmp_path, [{"name": "a", "scale": 0.5}, {"name": "b"}]), tmp_path / "out"
    first = run(table, out)
    kept = [(out / "plots" / name / "batch.json").read_bytes() for name in "ab"]
    trees, summary = (out / "trees.csv").read_bytes(), read_csv(out / "summary.csv")
    put_away(tmp_path)
    (tmp_path / "photos" / "b").mkdir(parents=True)  # where a disk is hung in
    (tmp_path / "photos" / "b" / "Thumbs.db").write_bytes(b"of Explorer")
    second = run(table, out)
    assert (second.ran, second.counts) == (0, first.counts)
    assert (out / "trees.csv").read_bytes() == trees
    told = read_csv(out / "summary.csv")
    for name, before, row in zip("ab", summary, told, strict=True):
        assert row == before | {"message": f"its photos are not there at the moment ({tmp_path / 'photos' / name})"}
        assert started(out / "plots" / name) == 1
    assert "photos are not there" in (out / "report.html").read_text(encoding="utf-8")
    # Nothing is forgotten: with the card they are done, and not run again.
    assert [(out / "plots" / name / "batch.json").read_bytes() for name in "ab"] == kept
    shutil.rmtree(tmp_path / "photos")
    (tmp_path / "in the drawer").rename(tmp_path / "photos")
    third = run(table, out)
    assert (third.ran, third.rows) == (0, first.rows)


def test_a_plot_whose_trees_are_measured_in_another_way_now_is_not_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stage of another version is done anew by its run; a batch that called the plot done never began one."""
    table, out = write_table(tmp_path, [{"name": "a", "scale": 0.5}]), tmp_path / "out"
    run(table, out)
    assert run(table, out).ran == 0
    *before, trees, report = STAGES
    newer = replace(trees, version=trees.version + 1)
    monkeypatch.setattr(outcome, "STAGES", (*before, newer, report))
    assert run(table, out).ran == 1
    assert run(table, out).ran == 0


def test_without_photos_a_plot_is_not_done_with_what_has_changed_since(tmp_path: Path) -> None:
    names = ("same", "option", "edited", "measured", "before", "never", "broken")
    rows: list[dict[str, object]] = [{"name": name, "scale": 0.5} for name in names]
    out = tmp_path / "out"
    behave(write_table(tmp_path, rows).parent, "never", exit=2, say="Error: too dark")
    first = run(tmp_path / "plots.csv", out)
    trees = (out / "trees.csv").read_bytes()
    kept = {name: (out / "plots" / name / "batch.json").read_bytes() for name in names}
    put_away(tmp_path)
    rows[1]["scale"] = 0.6
    (out / "plots" / "edited" / "edits.csv").write_text("action,tree_id\ndelete,1\n", encoding="utf-8")
    table = out / "plots" / "measured" / "trees.csv"
    table.write_text(table.read_text(encoding="utf-8").replace(",0.20,", ",0.30,"), encoding="utf-8")
    old = json.loads(kept["before"])
    old.pop("options")  # as earlier versions wrote it
    (out / "plots" / "before" / "batch.json").write_text(json.dumps(old), encoding="utf-8")
    (out / "plots" / "broken" / "trees.csv").unlink()
    for row in rows:
        row["photos"] = f"photos/{row['name']}"
    with (tmp_path / "plots.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    second = run(tmp_path / "plots.csv", out)
    by_name = {row.plot: row for row in second.rows}
    assert {name: row.state.value for name, row in by_name.items()} == {
        "same": "done", "option": "outdated", "edited": "outdated", "measured": "outdated", "before": "outdated",
        "never": "failed", "broken": "failed",
    }  # fmt: skip
    assert (second.counts.done, second.counts.outdated, second.counts.failed) == (1, 4, 2)
    assert "still has the results of earlier options" in by_name["option"].message
    assert "still has the results of earlier options, corrections" in by_name["edited"].message
    assert "results were changed since" in by_name["measured"].message
    assert "did not note its options" in by_name["before"].message
    assert all("does not exist" in by_name[name].message for name in ("never", "broken"))
    before = {row.plot: row for row in first.rows}
    for name in ("option", "edited", "before"):
        again = by_name[name]
        assert replace(again, state=State.done, message="") == before[name]
    assert {row["plot"] for row in read_csv(out / "trees.csv")} == {"same", "option", "edited", "measured", "before"}
    assert len(trees.splitlines()) > len((out / "trees.csv").read_bytes().splitlines())
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "plots with outdated results" in page
    assert "plots/option/report.html" in page
    assert any("option: its photos are not there" in line for line in _lines(second))
    # What is kept of the plots stays, be they finished or not.
    for name in set(names) - {"before"}:
        assert (out / "plots" / name / "batch.json").read_bytes() == kept[name]
    # With the photos the changes are done.
    (tmp_path / "in the drawer").rename(tmp_path / "photos")
    (tmp_path / "photos" / "never" / "behave.json").unlink()
    third = run(tmp_path / "plots.csv", out)
    assert third.counts.done == len(names)
    assert {name: started(out / "plots" / name) for name in names} == {
        "same": 1, "option": 2, "edited": 2, "measured": 2, "before": 1, "never": 2, "broken": 2,
    }  # fmt: skip


def test_a_finished_plot_whose_files_are_not_there_keeps_its_trees(tmp_path: Path) -> None:
    """As without its photos: one polygon on a card in the drawer had made the plot a failed one, without its trees."""
    names = ("polygon", "both", "option", "renamed", "before")
    rows: list[dict[str, object]] = [{"name": name, "plot_polygon": f"{name}.csv", "scale": 0.5} for name in names]
    for name in (*names, "other"):
        (tmp_path / f"{name}.csv").write_text("x_m,y_m\n0,0\n9,0\n0,9\n", encoding="utf-8")
    table, out = write_table(tmp_path, rows), tmp_path / "out"
    first = run(table, out)
    trees = (out / "trees.csv").read_bytes()
    kept = {name: (out / "plots" / name / "batch.json").read_bytes() for name in names}
    old = json.loads(kept["before"])
    old.pop("named")  # as earlier versions wrote it
    (out / "plots" / "before" / "batch.json").write_text(json.dumps(old), encoding="utf-8")
    for name in (*names, "other"):
        (tmp_path / f"{name}.csv").unlink()
    shutil.rmtree(tmp_path / "photos" / "both")
    rows[2]["scale"], rows[3]["plot_polygon"] = 0.6, "other.csv"
    for row in rows:
        row["photos"] = f"photos/{row['name']}"
    with table.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    second = run(table, out)
    by_name = {row.plot: row for row in second.rows}
    assert {name: row.state.value for name, row in by_name.items()} == {
        "polygon": "done", "both": "done", "option": "outdated", "renamed": "outdated", "before": "outdated",
    }  # fmt: skip
    file = tmp_path / "polygon.csv"
    assert by_name["polygon"].message == f"the file of --plot-polygon is not there at the moment ({file})"
    assert by_name["both"].message.startswith("its photos are not there at the moment")
    assert "and the file of --plot-polygon is not there" in by_name["both"].message
    assert "still has the results of earlier options" in by_name["option"].message
    assert "did not note its options" in by_name["before"].message
    assert (second.ran, (out / "trees.csv").read_bytes()) == (0, trees)
    for name in set(names) - {"before"}:
        assert (out / "plots" / name / "batch.json").read_bytes() == kept[name]
    assert replace(by_name["polygon"], message="") == first.rows[0]


def test_options_reach_the_run(tmp_path: Path) -> None:
    (tmp_path / "corner.csv").write_text("", encoding="utf-8")
    table = write_table(tmp_path, [{"name": "a", "plot_center": "-1,2", "plot_radius_m": 12.62, "edits": "corner.csv"}])
    run(table, tmp_path / "out", threads=3, options=("--precision=float32",))
    (options,) = (tmp_path / "out" / "plots" / "a" / "started.txt").read_text(encoding="utf-8").splitlines()
    assert json.loads(options) == [
        "--plot-radius-m=12.62", "--plot-center=-1,2", "--precision=float32", f"--edits={tmp_path / 'corner.csv'}",
        "--threads=3",
    ]  # fmt: skip


def test_the_tables_hold_what_the_plots_say(tmp_path: Path) -> None:
    rows: list[dict[str, object]] = [{"name": f"plot {i}"} for i in range(8)]
    out = tmp_path / "out"
    result = run(write_table(tmp_path, rows), out, jobs=4)
    summary = read_csv(out / "summary.csv")
    trees = read_csv(out / "trees.csv")
    assert [row["plot"] for row in summary] == [row["name"] for row in rows]
    for row in summary:
        own = read_csv(out / "plots" / row["plot"] / "trees.csv")
        assert int(row["trees"]) == len(own)
        # Digit by digit what stands in the plot's own table.
        theirs = [{key: tree[key] for key in own[0]} for tree in trees if tree["plot"] == row["plot"]]
        assert theirs == own
    number = len(trees)
    assert result.counts.trees == number == sum(int(row["trees"]) for row in summary)
    with_border = next(row for row in summary if int(row["trees"]) == 2)
    assert [with_border[f"stems_per_ha{end}"] for end in ("", "_lo95", "_hi95")] == ["200.0", "180.0", "240.0"]
    basal = ("basal_area_m2_per_ha", "basal_area_lo95_m2_per_ha", "basal_area_hi95_m2_per_ha")
    assert [with_border[name] for name in basal] == ["16.0", "15.0", "18.0"]
    assert (with_border["area_m2"], with_border["quadratic_mean_dbh_cm"]) == ("500.0", "31.25")
    seen = next(row for row in summary if int(row["trees"]) == 3)
    assert (seen["stems_per_ha"], seen["stems_per_ha_lo95"], seen["area_m2"]) == ("77.0", "", "321.0")
    assert (seen["per_hectare_of"], seen["warnings"]) == ("seen ground only", "2")
    told = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert (told["plots"], told["done"], told["trees"], len(told["rows"])) == (8, 8, number, 8)
    sheets = {sheet.name: sheet.rows() for sheet in read_sheets(out / "summary.xlsx")}
    assert [len(sheets[name]) for name in ("plots", "trees")] == [9, number + 1]
    assert sheets["plots"][1][0] == "plot 0"
    assert sheets["trees"][1][5] == float(trees[0]["dbh_cm"])


class Page(HTMLParser):
    """Links, tags and text of a page, and what it would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.loads: list[str] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        values = dict(attrs)
        if tag == "a":
            self.links.append(values.get("href") or "")
        self.loads += [value for key in ("src", "data") if (value := values.get(key) or "")]

    def handle_data(self, data: str) -> None:
        self.texts.append(data.strip())


def test_no_name_or_message_becomes_a_formula_or_a_part_of_the_page(tmp_path: Path) -> None:
    names = ("=1+1", "@sum", "-2+3", "+4", "a & b", "100%41 #2", "it's", "ok {{ 7 + 7 }}")
    places = [{"latitude_deg": 47 + i / 100, "longitude_deg": 8 - i / 50} for i in range(len(names))]
    table = write_table(tmp_path, [{"name": name, **place} for name, place in zip(names, places, strict=True)])
    behave(tmp_path, "@sum", exit=2, say="Error: =cmd|' /C calc'!A0 <script>alert(1)</script>")
    out = tmp_path / "out"
    run(table, out, jobs=4)
    raw = read_csv(out / "summary.csv")
    assert [row["plot"] for row in raw[:4]] == ["'=1+1", "'@sum", "'-2+3", "+4"]
    assert raw[1]["message"].startswith("'=cmd")
    assert not [cell for row in raw for cell in row.values() if cell.startswith(("=", "@", "\t"))]
    # Our own reader, as spreadsheets that were told, gives back the names.
    read = read_table(out / "summary.csv", what="the summary", required=("plot",), way_out="")
    assert [row.cells["plot"] for row in read.rows] == list(names)
    assert [row[0] for row in read_sheets(out / "summary.xlsx")[0].rows()[1:]] == list(names)
    text = (out / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert "<script>alert" not in text
    assert "<b>bold" not in text
    assert page.loads == []
    assert "http://" not in text.replace("http://www.w3.org/", "")
    shown = set(page.texts)
    assert set(names) <= shown
    assert "plots/100%2541%20%232/report.html" in page.links
    assert "plots/%40sum/report.html" not in page.links
    # On the map and in the table.
    assert page.links.count("plots/%3D1%2B1/report.html") == 2
    for link in page.links:
        if link.startswith("plots/"):
            from urllib.parse import unquote

            assert (out / unquote(link)).is_file()


def test_without_places_the_page_says_so(tmp_path: Path) -> None:
    table = write_table(tmp_path, [{"name": "a"}])
    run(table, tmp_path / "out")
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "No plot has a place on earth" in text
    assert "<circle" not in text


def test_the_summary_stands_after_each_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # However long this computer's disk takes to write it.
    monkeypatch.setattr("fsinfer.batch.run._PAUSE_FACTOR", 0.0)
    table, out = write_table(tmp_path, [{"name": name} for name in "abc"]), tmp_path / "out"
    seen = []

    def news(item: PlotNews) -> None:
        states = [row["state"] for row in read_csv(out / "summary.csv")]
        seen.append((item.finished, states.count("done"), states.count("waiting")))

    run_batch(table, out, settings=BatchSettings(command=STAND_IN), news=news)
    assert seen == [(1, 1, 2), (2, 2, 1), (3, 3, 0)]


def test_a_summary_that_takes_long_to_write_waits_for_more_plots_and_stands_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsinfer.batch.run._PAUSE_FACTOR", 1e6)
    table, out = write_table(tmp_path, [{"name": name} for name in "abc"]), tmp_path / "out"
    seen = set()

    def news(_: PlotNews) -> None:
        seen.add(tuple(row["state"] for row in read_csv(out / "summary.csv")))

    run_batch(table, out, settings=BatchSettings(command=STAND_IN), news=news)
    assert seen == {("waiting",) * 3}
    assert [row["state"] for row in read_csv(out / "summary.csv")] == ["done"] * 3
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["done"] == 3


def test_plots_that_were_done_before_have_no_summary_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fsinfer.batch.run._PAUSE_FACTOR", 0.0)
    table, out = write_table(tmp_path, [{"name": name} for name in "abc"]), tmp_path / "out"
    run(table, out)
    names = ("summary.csv", "summary.json", "summary.xlsx", "trees.csv", "report.html")
    written = []

    def news(item: PlotNews) -> None:
        assert not item.ran
        written.append([(out / name).stat().st_mtime_ns for name in names])

    run_batch(table, out, settings=BatchSettings(command=STAND_IN), news=news)
    assert len(written) == 3
    assert written[0] == written[1] == written[2]


def test_a_damaged_result_is_one_failed_plot(tmp_path: Path) -> None:
    table, out = write_table(tmp_path, [{"name": "a"}, {"name": "b"}]), tmp_path / "out"
    run(table, out)
    kept = out / "plots" / "a" / "batch.json"
    (out / "plots" / "a" / "plot.json").write_text("[]", encoding="utf-8")
    from fsinfer.batch.outcome import result_digests

    told = json.loads(kept.read_text(encoding="utf-8")) | {"results": result_digests(out / "plots" / "a")}
    kept.write_text(json.dumps(told), encoding="utf-8")
    result = run(table, out)
    assert "is no plot summary" in messages(result)["a"]
    assert result.counts.done == 1


@pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc")
def test_ctrl_c_ends_the_plots_and_keeps_what_is_finished(tmp_path: Path) -> None:
    table, out = write_table(tmp_path, [{"name": "a"}, {"name": "b"}, {"name": "c"}]), tmp_path / "out"
    behave(tmp_path, "b", seconds=600, child=True)
    code = (
        "import sys; from unittest.mock import patch; from fsinfer.batch import attempt\n"
        "from tests.support.batch_plots import STAND_IN\n"
        "line = attempt._command_line\n"
        "from dataclasses import replace\n"
        "patch('fsinfer.batch.attempt._command_line', lambda task: line(replace(task, command=STAND_IN))).start()\n"
        "from fsinfer.cli.app import main; main()"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-c", code, "batch", str(table), str(out)],
        env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    child = out / "plots" / "b" / "child.txt"
    wait_for(lambda: child.is_file() and child.read_text() != "", seconds=120)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Stopped. What is finished is kept" in said
    assert "Traceback" not in said
    assert not is_alive(int(child.read_text()))
    states = {row["plot"]: row["state"] for row in read_csv(out / "summary.csv")}
    assert states == {"a": "done", "b": "waiting", "c": "waiting"}


def test_a_batch_that_was_stopped_starts_nothing_more(tmp_path: Path) -> None:
    from fsinfer.batch.attempt import PlotTask, attempt

    table = write_table(tmp_path, [{"name": "a"}])
    behave(tmp_path, "a", seconds=600)
    stop_batch("token")
    task = PlotTask(batch="token", photos=tmp_path / "photos" / "a", out=tmp_path / "out", command=STAND_IN)
    assert attempt(task).message == "was stopped; run again to go on"
    assert table.is_file()


def test_why_a_plot_could_not_be_started_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = GuardResult(ended=Ended.unable, returncode=None, seconds=0.0, peak_gb=None, message="cannot be taken away")
    monkeypatch.setattr("fsinfer.batch.attempt._under_guard", lambda *_: told)
    result = run(write_table(tmp_path, [{"name": "a"}]), tmp_path / "out", retries=0)
    assert messages(result) == {"a": "cannot be taken away"}


def test_a_worker_with_another_version_measures_nothing(tmp_path: Path) -> None:
    from fsinfer.batch.attempt import PlotTask, attempt

    task = PlotTask(batch="b", photos=tmp_path, out=tmp_path / "out", command=STAND_IN, version="0.0.1")
    tried = attempt(task)
    assert "the batch 0.0.1; install the same version everywhere" in tried.message
    assert (tried.done, tried.again) == (False, True)
    assert not (tmp_path / "out").exists()


def invoke(*words: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["batch", *words], env={"COLUMNS": "300"})
    return result.exit_code, " ".join(result.output.replace("│", " ").split())


def test_the_exit_code_tells_whether_plots_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fsinfer.batch import attempt

    real = attempt._command_line

    def stand_in(task: attempt.PlotTask) -> tuple[str, ...]:
        return (*STAND_IN, *real(task)[4:])

    monkeypatch.setattr(attempt, "_command_line", stand_in)
    table, out = write_table(tmp_path, [{"name": "a"}, {"name": "b"}]), tmp_path / "out"
    behave(tmp_path, "b", exit=2, say="Error: too dark; take them by day")
    code, said = invoke(str(table), str(out))
    assert code == 3
    assert "1/2 a: " in said
    assert "2/2 b: failed: too dark; take them by day" in said
    assert "Plots: 1 of 2 measured, 1 failed" in said
    assert f"Report: {out / 'report.html'}" in said
    (tmp_path / "photos" / "b" / "behave.json").unlink()
    code, said = invoke(str(table), str(out))
    assert code == 0
    assert "done before" in said
    (tmp_path / "photos").rename(tmp_path / "away")
    code, said = invoke(str(table), str(out))
    assert code == 0
    assert "done before; its photos are not there at the moment" in said
    code, said = invoke(str(table), str(out), "--precision", "float32")
    assert code == 3
    assert "Plots: 0 of 2 measured, 2 with outdated results, 0 failed" in said
    (tmp_path / "away").rename(tmp_path / "photos")
    (tmp_path / "corner.csv").write_text("x_m,y_m\n0,0\n9,0\n0,9\n", encoding="utf-8")
    write_table(tmp_path, [{"name": "a", "plot_polygon": "corner.csv"}, {"name": "b"}])
    assert invoke(str(table), str(out))[0] == 0
    (tmp_path / "corner.csv").unlink()
    code, said = invoke(str(table), str(out))
    assert code == 0
    assert "done before; the file of --plot-polygon is not there at the moment" in said
    write_table(tmp_path, [{"name": "a"}, {"name": "b"}])
    assert invoke(str(table), str(out))[0] == 0
    code, said = invoke(str(table), str(out), "--quiet")
    assert code == 0
    assert said.startswith("Nothing to do: everything was finished before. Plots: 2 of 2 measured, 0 failed")


@pytest.mark.parametrize(
    ("figures", "why"),
    [
        (
            {"trees": 12, "trees_with_dbh": 0, "units": "model units"},
            "it has no scale; give its aruco_length_m or scale",
        ),
        ({"trees": 3, "trees_with_dbh": 0, "units": "m"}, "none of its 3 trees could be measured"),
        ({"trees": 0, "trees_with_dbh": 0, "units": "m"}, "no tree was found"),
        ({"trees": 3, "trees_with_dbh": 1, "units": "m"}, None),
    ],
)
def test_a_plot_without_a_diameter_says_why(figures: dict[str, Any], why: str | None) -> None:
    rows = (PlotRow(plot="oak", state=State.done, **figures), PlotRow(plot="ash", state=State.waiting))
    result = BatchResult(out=Path("out"), rows=rows, counts=count(rows), ran=1, report=Path("report.html"))
    told = [line for line in _lines(result) if "has no DBH" in line]
    assert len(told) == (why is not None)
    assert why is None or f"oak has no DBH: {why}" in told[0]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["missing.csv", "out"], "there is no such file"),
        (["plots.csv", "out", "--copy"], "--copy was given without --scheduler"),
        (["plots.csv", "out", "--limit-gb", "0"], "--limit-gb is 0"),
        (["plots.csv", "out", "--limit-minutes", "1,5"], "write a point, not a comma: 1.5"),
        (["plots.csv", "out", "--scheduler", "tcp://127.0.0.1:9"], "no Dask scheduler answers at tcp://127.0.0.1:9"),
        (["plots.csv", "out", "--scheduler", "what"], "no Dask scheduler answers at what"),
    ],
)
def test_what_cannot_be_used_is_told_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], told: str
) -> None:
    if "--scheduler" in words:
        pytest.importorskip("distributed")
        monkeypatch.setattr("fsinfer.cluster.workers.CONNECT_S", 1.0)
    monkeypatch.chdir(tmp_path)
    write_table(tmp_path, [{"name": "a"}])
    code, said = invoke(*words)
    assert code == 2
    assert told in said
    assert "Traceback" not in said
    assert not (tmp_path / "out" / "plots").exists()


def test_without_dask_the_way_to_it_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    table = write_table(tmp_path, [{"name": "a"}])
    with pytest.raises(InputError, match=r"pip install 'fsinfer\[cluster\]'"):
        run(table, tmp_path / "out", scheduler="tcp://127.0.0.1:9")


def test_the_remaining_time_is_that_of_plots_that_ran() -> None:
    remaining = RemainingPlots()
    assert remaining.seconds(10, 2) is None
    remaining.add(50.0)
    remaining.add(70.0)
    assert remaining.seconds(10, 2) == 300.0
    # The last round takes a whole plot's time, however few there are.
    assert remaining.seconds(1, 4) == 60.0
    assert remaining.seconds(0, 4) == 0.0

"""The documents' figures are those of the result files, and the machinery that holds them there works."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.bench import effects, tables
from tests.bench.results import KINDS, RESULTS, ROOT, command_line, read_result, write_result
from tests.bench.tables import TableError, differences, filled, marks
from tests.bench.templates import EFFECT_WORDS, TEMPLATES

FIGURES = {"rmse_cm": 0.2374, "bias_cm": -0.051, "trees": 5, "false": 0}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_result("try", FIGURES, command="python -m tests.bench.plot PLOT OUT", kind="blind", folder=tmp_path)
    return tmp_path


def check(text: str, folder: Path) -> list[str]:
    return differences(list(marks(text, "page.md", folder)))


def test_every_figure_of_the_documents_is_that_of_its_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert tables.main(["--check"]) == 0, capsys.readouterr()


def test_every_result_file_can_be_read_and_is_clean() -> None:
    paths = sorted(RESULTS.glob("*.json"))
    assert paths
    for path in paths:
        result = read_result(path.stem)
        assert result.name == path.stem
        assert result.kind in KINDS
        assert re.fullmatch("[0-9a-f]{40}", result.commit), f"{path.name} was not measured on a commit"
        assert result.figures
        assert not re.search(r"/(work|home|tmp|root|Users)/", path.read_text(encoding="utf-8"))


def test_the_readme_has_no_figure_of_accuracy_by_hand() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for mark in reversed(list(marks(text, "README.md"))):
        text = text[: mark.start] + text[mark.end :]
    assert not re.search(r"\b(RMSE|bias|AE|MAE|error)\b[^\n|]{0,30}\d", text)


def test_a_figure_that_differs_is_named_with_its_line(folder: Path) -> None:
    text = "first\nRMSE <!-- f:try.rmse_cm:.2f -->0.23<!-- /f --> cm\n"
    assert check(text, folder) == ["page.md:2: try.rmse_cm: the text says '0.23', the file '0.24'"]
    assert not check(text.replace("0.23", "0.24"), folder)


def test_writing_puts_in_what_the_check_asks_for(folder: Path) -> None:
    text = (
        "RMSE <!-- f:try.rmse_cm:.2f --><!-- /f --> and <!-- f:try.bias_cm:+.2f -->9<!-- /f --> cm, "
        "<!-- f:try.trees -->?<!-- /f --> trees, <!-- f:try.set --><!-- /f -->\n"
    )
    new = filled(text, list(marks(text, "page.md", folder)))
    assert re.sub("<!--.*?-->", "", new) == "RMSE 0.24 and \N{MINUS SIGN}0.05 cm, 5 trees, blind\n"
    assert not check(new, folder)


def test_a_table_that_differs_is_named_with_its_row(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setitem(TEMPLATES, "two", lambda results: ["| a |", f"| {results[0].figures['trees']} |"])
    text = "<!-- figures: two try -->\n\n| a |\n| 4 |\n\n<!-- /figures -->\n"
    assert check(text, folder) == ["page.md:4: two try: the text says '| 4 |', the file '| 5 |'"]
    assert not check(text.replace("4", "5"), folder)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("x <!-- f:none.rmse_cm -->1<!-- /f -->", "there is no .*none.json"),
        ("x <!-- f:try.mae_cm -->1<!-- /f -->", "no figure 'mae_cm'"),
        ("x <!-- f:try.rmse_cm:d -->1<!-- /f -->", "Unknown format"),
        ("x <!-- f:try.rmse_cm -->1", "not closed"),
        ("<!-- f:try.rmse_cm -->1<!-- /f -->", "begins a line"),
        ("- <!-- f:try.rmse_cm -->1<!-- /f -->", "begins a line"),
        ("<!-- figures: nothing try -->\n<!-- /figures -->", "no table 'nothing'"),
    ],
)
def test_a_mark_that_cannot_be_filled_is_an_error_with_its_line(text: str, why: str, folder: Path) -> None:
    with pytest.raises(TableError, match=rf"page\.md:3: .*{why}"):
        check(f"\n\n{text}\n", folder)


def test_the_headline_refuses_a_set_that_is_not_blind(folder: Path) -> None:
    write_result("seen", FIGURES, command="python -m tests.bench.plot P O", kind="development", folder=folder)
    with pytest.raises(TableError, match="seen is a development set"):
        check("<!-- figures: headline seen -->\n<!-- /figures -->\n", folder)


def test_a_result_says_what_it_was_measured_on(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    write_result("try", FIGURES, command="python -m x", kind="blind", folder=folder)
    record: dict[str, Any] = json.loads((folder / "try.json").read_text(encoding="utf-8"))
    assert record["figures"] == FIGURES
    assert record["set"] == "blind"
    assert record["processor"]["cores"] >= 1
    assert record["thread_variables"]["OMP_NUM_THREADS"] == "3"
    assert set(record["versions"]) == {"python", "numpy", "onnxruntime", "opencv", "pycolmap", "fsinfer"}
    assert record["commit"]


def test_what_is_no_figure_is_refused(tmp_path: Path) -> None:
    def write(figures: dict[str, Any], name: str = "try", kind: Any = "blind") -> Path:
        return write_result(name, figures, command="python -m x", kind=kind, folder=tmp_path)

    for key, value in {"text": "0.24", "endless": float("inf"), "Name": 1}.items():
        with pytest.raises(ValueError, match=key):
            write({key: value})
    with pytest.raises(ValueError, match="Try"):
        write({}, name="Try")
    with pytest.raises(ValueError, match="half"):
        write({}, kind="half")
    write({"nothing": None, "unknown": float("nan"), "rmse_cm": 0.5})
    assert read_result("try", tmp_path).figures == {"rmse_cm": 0.5}


def test_a_command_names_no_folder_of_the_machine_and_no_option_of_the_result() -> None:
    words = ["/data/plots/plot", "out", "--result", "a", "--result-set=blind", "--note", "x y", "--slow"]
    assert command_line("tests.bench.plot", words) == "python -m tests.bench.plot plot out --slow"


def test_every_effect_that_is_measured_has_words_in_the_table() -> None:
    assert {*EFFECT_WORDS} == {name.removesuffix("2") for name in effects.cases([])}


def test_effects_are_listed_with_who_placed_how_many(tmp_path: Path) -> None:
    row = {"photos": 26, "cheap_right": 26, "cheap_rms_mm": 3.6, "ours_right": 26, "ours_rms_mm": 3.6}
    figures = {f"wind2_{key}": value for key, value in (row | {"colmap_right": 16, "colmap_rms_mm": 21.6}).items()}
    dbh = {"ours_trees": 8, "ours_matched": 7, "ours_rmse_cm": 0.214, "ours_bias_cm": -0.046}
    figures |= {f"none_{key}": value for key, value in (row | dbh).items()}
    write_result("try", figures, command="python -m tests.bench.effects OUT", kind="development", folder=tmp_path)
    assert TEMPLATES["effects"]([read_result("try", tmp_path)])[2:] == [
        "| none | 26 of 26, 3.6 mm | 26 of 26, 3.6 mm | 7 of 8, 0.21, \N{MINUS SIGN}0.05 cm | not measured |",
        "| leaves and undergrowth move 1.5 cm, doubled | 26 of 26, 3.6 mm | 26 of 26, 3.6 mm | not measured | "
        "16 of 26, 21.6 mm |",
    ]


def test_plots_together_hide_none_that_went_wrong(folder: Path) -> None:
    plots = {
        "good": (300, 300, 40, 40, 0, 0.2, 40, "True"),
        "lost": (300, 280, 40, 7, 105, 11.8, 1, "True"),
        "fair": (300, 299, 40, 39, 1, 0.4, 38, "True"),
        "short": (90, 90, 14, 14, 0, 0.3, 14, "True"),
        "clean": (120, 120, 16, 16, 0, 0.1, 16, "None"),
    }
    names = ("photos", "photos_registered", "trees", "matched", "false", "rmse_cm", "inside_interval")
    for name, (*figures, phone) in plots.items():
        record = dict(zip(names, figures, strict=True)) | {"with_interval": figures[3]}
        settings = {"plot": {"phone": phone}}
        write_result(
            name, record, command="python -m tests.bench.plot P O", kind="blind", folder=folder, settings=settings
        )
    results = [read_result(name, folder) for name in plots]
    lines = TEMPLATES["together"](results)
    assert [line for line in lines if ", 300 photographs" in line] == [
        "| with a phone's effects in a breeze, 300 photographs | 3 | 879 of 900 | 86 of 120 | 106 "
        "| 0.40 cm, 11.80 cm | 79 of 86 |"
    ]
    assert len(lines) == 5
    with pytest.raises(ValueError, match="blind sets only"):
        TEMPLATES["together"]([replace(results[0], kind="development")])

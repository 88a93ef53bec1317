"""Every code of a plot's border has a sentence, and every notice the values that it asks for."""

from __future__ import annotations

import ast
from pathlib import Path
from string import Formatter

import fsinfer
from fsinfer.notices.notice import notice
from fsinfer.notices.plots import SENTENCES, PlotCode
from fsinfer.notices.sentences import sentence


def test_every_code_has_a_sentence_and_every_notice_its_values() -> None:
    assert set(SENTENCES) == set(PlotCode)
    made = {}
    for path in Path(fsinfer.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "notice":
                code = node.args[0]
                if isinstance(code, ast.Attribute) and ast.unparse(code.value) == "PlotCode":
                    made[PlotCode[code.attr]] = {keyword.arg for keyword in node.keywords}
    asked = {code: {name for _, name, _, _ in Formatter().parse(SENTENCES[code]) if name} for code in PlotCode}
    assert made == asked


def test_sentences_are_lower_case_and_have_no_full_stop() -> None:
    for text in SENTENCES.values():
        assert text[0].islower()
        assert not text.endswith((".", ";"))


def test_thousands_of_names_do_not_fill_the_screen() -> None:
    names = tuple(f"tree {number} (0.02 m in)" for number in range(3000))
    told = notice(PlotCode.border_cases, trees=names)
    said = sentence(told)
    assert "tree 59 (0.02 m in) and 2940 more" in said
    assert len(said) < 2000
    assert told.values["trees"] == names
    assert "more" not in sentence(notice(PlotCode.border_cases, trees=names[:60]))

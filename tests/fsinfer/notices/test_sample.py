"""Every code of the estimates has a sentence, and every notice the values that it asks for."""

from __future__ import annotations

import ast
from pathlib import Path
from string import Formatter

import fsinfer
from fsinfer.notices.notice import notice
from fsinfer.notices.sample import REASONS, SENTENCES, SampleCode
from fsinfer.notices.sentences import sentence


def test_every_code_has_a_sentence_and_every_notice_its_values() -> None:
    assert set(SENTENCES) == set(SampleCode)
    # Why a plot is left out is found for each, and said together.
    made = {code: {"plots", "names"} for code in REASONS}
    for path in Path(fsinfer.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "notice":
                code = node.args[0]
                if isinstance(code, ast.Attribute) and ast.unparse(code.value) == "SampleCode":
                    made[SampleCode[code.attr]] = {str(keyword.arg) for keyword in node.keywords}
    asked = {code: {name for _, name, _, _ in Formatter().parse(SENTENCES[code]) if name} for code in SampleCode}
    assert made == asked


def test_sentences_are_lower_case_and_have_no_full_stop() -> None:
    for text in SENTENCES.values():
        assert text[0].islower() or text.startswith("{plots}")
        assert not text.endswith((".", ";"))


def test_why_plots_are_left_out_is_said_in_one_sentence() -> None:
    why = tuple(
        notice(code, plots=2, names=("a", "b")) for code in (SampleCode.left_failed, SampleCode.left_without_border)
    )
    told = sentence(notice(SampleCode.plots_left_out, plots=4, of=9, why=why))
    assert told.startswith("left out: 4 of 9 plots (2 failed: a, b, 2 without a border: a, b); ")

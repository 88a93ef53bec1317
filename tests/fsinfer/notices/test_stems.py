"""Every code of the dendrometry has its sentence, and every notice the values that its sentence asks for."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import pytest

import fsinfer
from fsinfer.notices.notice import notice, notice_json, notice_of_json
from fsinfer.notices.sentences import advises_revisit, headline, is_remark, joined, sentence
from fsinfer.notices.stems import ADVICE, ADVISES_REVISIT, REMARKS, SENTENCES, StemCode

PACKAGE = Path(fsinfer.__file__).parent
#: Made with the code of a rejection, not by name: ``notice(why, count=...)``.
COUNTED = {code for code in StemCode if code.startswith("candidate_")}


def made() -> Iterator[tuple[StemCode, set[str]]]:
    """Each ``notice(StemCode.x, a=..., b=...)`` of the package: the code and the names of its values."""
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "notice"):
                continue
            codes = [node.args[0].body, node.args[0].orelse] if isinstance(node.args[0], ast.IfExp) else node.args[:1]
            for code in codes:
                if isinstance(code, ast.Attribute) and ast.unparse(code.value) == "StemCode":
                    yield StemCode[code.attr], {str(keyword.arg) for keyword in node.keywords}


def asked(code: StemCode) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(SENTENCES[code]) if name is not None}


def test_every_code_has_a_sentence() -> None:
    assert set(SENTENCES) == set(StemCode)
    assert {*ADVICE, *REMARKS, *ADVISES_REVISIT} <= set(StemCode)


def test_notices_hold_what_their_sentences_ask_for() -> None:
    values: dict[StemCode, list[set[str]]] = defaultdict(list)
    for code, names in made():
        values[code].append(names)
    assert set(values) == set(StemCode) - COUNTED
    for code, all_names in values.items():
        for names in all_names:
            assert names == asked(code), code
    assert all(asked(code) == {"count"} for code in COUNTED)


def test_sentences_are_lower_case_and_have_no_full_stop() -> None:
    for text in [*SENTENCES.values(), *ADVICE.values()]:
        assert not text.endswith((".", ";"))
        assert text[0].islower() or text[0] == "{"


def test_advice_follows_behind_a_semicolon_and_is_left_out_of_the_headline() -> None:
    rough = notice(StemCode.too_rough, residual_cm=2.86)
    said = "surface too rough: residual 2.9 cm"
    assert headline(rough) == said
    assert sentence(rough) == f"{said}; undergrowth or bad depth at breast height"
    few = notice(StemCode.edges_alone, photos=5, refused=rough)
    assert sentence(few) == f"only from its edges in 5 photos ({said})"
    assert joined([few, notice(StemCode.no_scale)]) == f"only from its edges in 5 photos ({said}); no scale"


def test_one_is_one() -> None:
    told = [sentence(notice(StemCode.trees_found, trees=trees, measured=trees)) for trees in (0, 1, 2)]
    assert told == [f"{trees} found, {n} with a DBH" for n, trees in enumerate(("0 trees", "1 tree", "2 trees"))]
    few = notice(StemCode.few_edges, photos=1)
    assert headline(few) == "mostly from its edges in 1 photo: few, or from few of its sides"
    left = [sentence(notice(StemCode.far_outside, points=points)) for points in (1, 820)]
    assert left == [
        "1 point far outside the plot was left out", "820 points far outside the plot were left out",
    ]  # fmt: skip


def test_notices_within_notices_go_through_json() -> None:
    changes = (notice(StemCode.tree_added, tree_id=7), notice(StemCode.tree_merged, other_id=6, tree_id=1))
    given = notice(StemCode.corrected_by_hand, changes=changes)
    assert notice_of_json(notice_json(given)) == given
    assert sentence(given) == "stem map corrected by hand: tree 7 added, 6 merged into 1"
    assert is_remark(given)


@pytest.mark.parametrize("code", list(StemCode))
def test_who_is_sent_round_a_stem_is_told_so(code: StemCode) -> None:
    said = f"{SENTENCES[code]} {ADVICE.get(code, '')}"
    assert ("walk round" in said) == (code in ADVISES_REVISIT) == advises_revisit(notice(code))

"""The fuzzer itself, and a few cases of the quick readers; ``python -m tests.fuzz all`` takes its time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest

from fsinfer.errors import InputError
from tests.fuzz.__main__ import Tally, fuzz
from tests.fuzz.cases import Cases, run_cases
from tests.fuzz.catalogue import READERS
from tests.fuzz.mutators import change_bytes, change_json, change_text, cut
from tests.fuzz.reader import Reader
from tests.fuzz.table import put_fuzz_rows, put_rows

#: Those that need no process of their own: nothing in them can end this one.
QUICK = ("ply", "ply-text", "text-cloud", "cams", "pair", "poses-json", "pfm", "depth-json", "truth", "edits", "frames",
         "trees", "border", "geojson", "clicks", "jpeg", "png", "ledger")  # fmt: skip


@pytest.mark.parametrize("name", QUICK)
def test_changed_files_are_read_or_told(tmp_path: Path, name: str) -> None:
    outcomes = list(run_cases(READERS[name], tmp_path / "work", seed=1, first=0, count=40))
    assert len(outcomes) == 40
    found = [f"case {one.case}: {one.finding}\n{one.trace}" for one in outcomes if one.finding]
    assert not found, "\n".join(found)
    # Neither is all of it refused, which would test one line, nor all of it read.
    assert any(one.read for one in outcomes) or name == "geojson"
    assert not all(one.read for one in outcomes) or name == "ledger"


def reader(read: Callable[[Path], object]) -> Reader:
    def make(folder: Path) -> None:
        (folder / "a.txt").write_text("1 2 3", encoding="utf-8")

    def guarded(folder: Path) -> object:
        return None if (folder / "a.txt").read_text(encoding="utf-8") == "1 2 3" else read(folder)

    def change(_: bytes, rng: Random) -> bytes:
        return b"%d" % rng.randrange(1000)

    return Reader(name="a", what="A", make=make, targets=("*.txt",), mutators=(change,), read=guarded, most_mb=64)


def judged(tmp_path: Path, read: Callable[[Path], object]) -> str:
    return Cases(reader(read), tmp_path / "work", 0).run(0).finding


def fail(error: BaseException) -> None:
    raise error


def test_what_is_a_finding(tmp_path: Path) -> None:
    assert judged(tmp_path, lambda _: None) == ""
    assert judged(tmp_path, lambda _: fail(InputError("a.txt is damaged; delete it"))) == ""
    assert judged(tmp_path, lambda _: fail(InputError("it is damaged"))) == "the message names no file"
    assert judged(tmp_path, lambda _: fail(KeyError("x"))) == "KeyError"
    assert judged(tmp_path, lambda _: fail(RecursionError())) == "RecursionError"
    assert judged(tmp_path, lambda _: bytes(1 << 28).count(b"1")) in ("too much memory", "")


def test_cases_follow_from_their_numbers(tmp_path: Path) -> None:
    cases = Cases(READERS["truth"], tmp_path / "work", 3)
    first = [(cases.change(case).name, cases.change(case).read_bytes()) for case in (5, 6, 5)]
    assert first[0] == first[2]
    assert first[0] != first[1]


def test_a_process_that_ends_and_one_that_hangs_are_findings(monkeypatch: pytest.MonkeyPatch) -> None:
    tally = fuzz("ends-itself", seconds=60, cases=3, seed=0, first=0, hang_s=1.0)
    assert tally.cases == 3
    assert sorted(tally.findings) == ["ended the process with 7", "longer than 1 s"]


def test_mutators_change_and_keep_what_they_should() -> None:
    text = b'{"a": [1, 2.5, {"b": "c"}], "d": null}'
    for change in (change_bytes, change_text, change_json, cut):
        made = {change(text, Random(seed)) for seed in range(60)}
        assert len(made) > 20, change
    assert change_bytes(b"", Random(0)) != b""
    assert cut(b"", Random(0)) == b""


def test_rows_of_a_table_are_replaced_by_their_name(tmp_path: Path) -> None:
    page = tmp_path / "a.md"
    page.write_text(
        "x\n<!-- t -->\n\n| a | b |\n|---|---|\n| one | 1 |\n| two | 2 |\n\n<!-- /t -->\ny\n", encoding="utf-8"
    )
    put_rows(page, "t", {"two": ["3"], "three": ["4"]})
    lines = page.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line.startswith("|")] == [
        "| a | b |", "|---|---|", "| one | 1 |", "| two | 3 |", "| three | 4 |",
    ]  # fmt: skip
    assert (lines[0], lines[-1]) == ("x", "y")
    with pytest.raises(ValueError, match="no marks"):
        put_rows(page, "other", {})
    page.write_text("<!-- fuzz -->\n\n| a |\n|---|\n\n<!-- /fuzz -->\n", encoding="utf-8")
    put_fuzz_rows(page, [Tally(name="ply", cases=1200, read=300, seconds=90)])
    assert "| PLY clouds, binary | `ply` | 1,200 | 300 | 90 | 0 |" in page.read_text(encoding="utf-8")

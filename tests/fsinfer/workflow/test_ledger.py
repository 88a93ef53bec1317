"""A stage is done once, again when its inputs or outputs changed, and never half."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np
import pytest

from fsinfer.errors import InputError, PosesError
from fsinfer.io.digest import file_digest
from fsinfer.output.json_values import as_json
from fsinfer.workflow.ledger import StageBook


class Counter:
    """Work that counts its calls and writes ``text`` into a file."""

    def __init__(self, path: Path, text: str = "a") -> None:
        self.path, self.text, self.calls = path, text, 0

    def __call__(self) -> dict[str, object]:
        self.calls += 1
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text(self.text, encoding="utf-8")
        return {"calls": self.calls, "warnings": ("w",)}


def test_stage_is_skipped_until_its_inputs_change(tmp_path: Path) -> None:
    work = Counter(tmp_path / "maps" / "a.txt")
    ran = [StageBook(tmp_path).run("s", work, inputs={"k": k}, outputs=["maps"]).ran for k in (1, 1, 2, 2, 1)]
    assert ran == [True, False, True, False, True]
    assert work.calls == 3


def test_skipped_stage_gives_the_saved_result_and_time(tmp_path: Path) -> None:
    work = Counter(tmp_path / "maps" / "a.txt")
    first = StageBook(tmp_path).run("s", work, inputs={}, outputs=["maps"])
    second = StageBook(tmp_path).run("s", work, inputs={}, outputs=["maps"])
    assert second.result == first.result == {"calls": 1, "warnings": ["w"]}
    assert (second.run_id, second.seconds) == (first.run_id, first.seconds)


@pytest.mark.parametrize("harm", ["delete", "shorten", "overwrite"])
def test_harmed_output_makes_the_stage_run_again(tmp_path: Path, harm: str) -> None:
    output = tmp_path / "cloud.ply"
    work = Counter(output, "0123456789")
    StageBook(tmp_path).run("s", work, inputs={}, outputs=["cloud.ply"])
    if harm == "delete":
        output.unlink()
    else:
        output.write_text("012345" if harm == "shorten" else "987654321x", encoding="utf-8")
    assert StageBook(tmp_path).run("s", work, inputs={}, outputs=["cloud.ply"]).ran
    assert output.read_text(encoding="utf-8") == "0123456789"


def test_later_stage_follows_an_earlier_one_that_ran_again(tmp_path: Path) -> None:
    early, late = Counter(tmp_path / "early" / "a"), Counter(tmp_path / "late" / "a")

    def both(early_input: int, late_input: int) -> list[bool]:
        book = StageBook(tmp_path)
        first = book.run("early", early, inputs={"k": early_input}, outputs=["early"])
        second = book.run("late", late, inputs={"k": late_input}, after=["early"], outputs=["late"])
        return [first.ran, second.ran]

    assert both(1, 1) == [True, True]
    assert both(1, 2) == [False, True]
    assert both(2, 2) == [True, True]
    early.path.unlink()
    assert both(2, 2) == [True, True]
    assert both(2, 2) == [False, False]


def _interrupted(out: Path, *, inputs: dict[str, int], keeps_partial: bool) -> None:
    def half() -> dict[str, object]:
        (out / "maps").mkdir(exist_ok=True)
        (out / "maps" / "half.pfm").write_text("x", encoding="utf-8")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        StageBook(out).run("s", half, inputs=inputs, outputs=["maps"], keeps_partial=keeps_partial)


@pytest.mark.parametrize(
    ("keeps_partial", "inputs", "kept"), [(True, {"k": 1}, True), (True, {"k": 2}, False), (False, {"k": 1}, False)]
)
def test_interrupted_stage_goes_on_only_with_the_same_inputs(
    tmp_path: Path, keeps_partial: bool, inputs: dict[str, int], kept: bool
) -> None:
    _interrupted(tmp_path, inputs={"k": 1}, keeps_partial=keeps_partial)
    work = Counter(tmp_path / "maps" / "whole.pfm")
    record = StageBook(tmp_path).run("s", work, inputs=inputs, outputs=["maps"], keeps_partial=keeps_partial)
    assert record.ran
    assert (tmp_path / "maps" / "half.pfm").exists() is kept


def test_time_of_an_interrupted_attempt_is_counted(tmp_path: Path) -> None:
    _interrupted(tmp_path, inputs={}, keeps_partial=True)
    path = tmp_path / ".fsinfer" / "s.json"
    saved = json.loads(path.read_text(encoding="utf-8"))
    assert saved["state"] == "started"
    path.write_text(json.dumps(saved | {"seconds": 100.0}), encoding="utf-8")
    work = Counter(tmp_path / "maps" / "a")
    record = StageBook(tmp_path).run("s", work, inputs={}, outputs=["maps"], keeps_partial=True)
    assert 100.0 <= record.seconds < 101.0


def test_failed_stage_keeps_its_error_and_is_not_done(tmp_path: Path) -> None:
    def fail() -> dict[str, object]:
        raise PosesError("no poses")

    with pytest.raises(PosesError, match="no poses"):
        StageBook(tmp_path).run("s", fail, inputs={})
    work = Counter(tmp_path / "a")
    assert StageBook(tmp_path).run("s", work, inputs={}).ran


def test_foreign_files_are_never_deleted(tmp_path: Path) -> None:
    mine = tmp_path / "frames" / "holiday.jpg"
    mine.parent.mkdir()
    mine.write_text("precious", encoding="utf-8")
    work = Counter(tmp_path / "frames" / "a")
    with pytest.raises(InputError, match="choose another output folder"):
        StageBook(tmp_path).run("s", work, inputs={}, outputs=["frames"])
    assert work.calls == 0
    assert mine.read_text(encoding="utf-8") == "precious"


def test_damaged_record_costs_a_repetition_only(tmp_path: Path) -> None:
    work = Counter(tmp_path / "maps" / "a")
    StageBook(tmp_path).run("s", work, inputs={}, outputs=["maps"])
    (tmp_path / ".fsinfer" / "s.json").write_text('{"state": "do', encoding="utf-8")
    assert StageBook(tmp_path).run("s", work, inputs={}, outputs=["maps"]).ran
    assert not StageBook(tmp_path).run("s", work, inputs={}, outputs=["maps"]).ran


def test_digest_sees_content_and_name_but_not_folder_or_date(tmp_path: Path) -> None:
    big = bytes(300_000)
    paths = [tmp_path / name for name in ("one/a.jpg", "two/a.jpg", "three/a.jpg", "one/b.jpg")]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(big)
    paths[2].write_bytes(big[:-1] + b"1")
    digests = [file_digest(path) for path in paths]
    assert digests[0] == digests[1]
    assert len({*digests}) == 3
    with pytest.raises(InputError, match="cannot read"):
        file_digest(tmp_path / "missing.jpg")


def test_settings_become_json() -> None:
    class Rule(Enum):
        uphill = "uphill"

    @dataclass(frozen=True, kw_only=True)
    class Settings:
        rule: Rule = Rule.uphill
        sizes: tuple[int, ...] = (1, 2)
        matrix: object = None
        path: Path = Path("a")

    value = as_json({"s": Settings(matrix=np.eye(2)), "n": np.float32(0.5)})
    assert value == {
        "s": {"rule": "uphill", "sizes": [1, 2], "matrix": [[1.0, 0.0], [0.0, 1.0]], "path": "a"},
        "n": 0.5,
    }
    with pytest.raises(TypeError, match="object"):
        as_json(object())


def test_memory_peak_sees_an_array() -> None:
    # In a process of its own: here an array may fall into memory that earlier tests left resident.
    program = (
        "import numpy as np\n"
        "from fsinfer.workflow.memory_peak import MemoryPeak\n"
        "peak = MemoryPeak()\n"
        "before = peak.read_mb()\n"
        "block = np.ones(8_000_000)\n"
        "print(before, peak.read_mb(), block.nbytes / 2**20)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    before, after, size = done.stdout.split()
    if "None" in (before, after):
        pytest.skip("this system does not tell the peak memory of a process")
    assert float(after) - float(before) > 0.5 * float(size)

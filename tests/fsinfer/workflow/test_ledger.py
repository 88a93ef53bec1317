"""A stage is done once, again when its inputs or outputs changed, and never half."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from fsinfer._version import __version__
from fsinfer.errors import InputError, PosesError
from fsinfer.io.digest import file_digest
from fsinfer.workflow.ledger import Ledger, Stage, StageRecord


@dataclass(frozen=True, kw_only=True)
class Counted:
    """What the stages of these tests return."""

    calls: int
    warnings: tuple[str, ...] = ()


class Counter:
    """Work that counts its calls and writes ``text`` into a file."""

    def __init__(self, path: Path, text: str = "a") -> None:
        self.path, self.text, self.calls = path, text, 0
        self.resumed: list[bool] = []

    def __call__(self, resume: bool) -> Counted:
        self.calls += 1
        self.resumed.append(resume)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text(self.text, encoding="utf-8")
        return Counted(calls=self.calls, warnings=("w",))


def run_stage(
    out: Path,
    work: Callable[[bool], Counted],
    *,
    name: str = "s",
    version: int = 1,
    inputs: Mapping[str, object] | None = None,
    after: Sequence[StageRecord[Counted]] = (),
    outputs: tuple[str, ...] = (),
    beside: tuple[str, ...] = (),
    keeps_partial: bool = False,
) -> StageRecord[Counted]:
    stage = Stage(
        name=name, version=version, result=Counted, outputs=outputs, beside=beside, keeps_partial=keeps_partial
    )
    return Ledger(out).run(stage, work, inputs=inputs or {}, after=after)


def test_stage_is_skipped_until_its_inputs_change(tmp_path: Path) -> None:
    work = Counter(tmp_path / "maps" / "a.txt")
    ran = [run_stage(tmp_path, work, inputs={"k": k}, outputs=("maps",)).ran for k in (1, 1, 2, 2, 1)]
    assert ran == [True, False, True, False, True]
    assert work.calls == 3


def test_skipped_stage_gives_the_saved_result_and_time(tmp_path: Path) -> None:
    work = Counter(tmp_path / "maps" / "a.txt")
    first = run_stage(tmp_path, work, outputs=("maps",))
    second = run_stage(tmp_path, work, outputs=("maps",))
    assert second.result == first.result == Counted(calls=1, warnings=("w",))
    assert (second.run_id, second.seconds) == (first.run_id, first.seconds)


def test_looking_into_the_folder_makes_no_stage_run_again(tmp_path: Path) -> None:
    work = Counter(tmp_path / "maps" / "inner" / "a.txt")
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / ".DS_Store").write_bytes(b"finder")
    assert run_stage(tmp_path, work, outputs=("maps",)).ran  # not refused as another's folder
    for name in (".DS_Store", "inner/._a.txt", "inner/Thumbs.db", "Desktop.ini", ".Trashes/x"):
        (tmp_path / "maps" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "maps" / name).write_bytes(b"by the system")
    stage = Stage(name="s", version=1, result=Counted, outputs=("maps",))
    assert Ledger(tmp_path).recall(stage) is not None
    assert not run_stage(tmp_path, work, outputs=("maps",)).ran
    (tmp_path / "maps" / "b.txt").write_text("a person's", encoding="utf-8")
    assert Ledger(tmp_path).recall(stage) is None


@pytest.mark.parametrize("harm", ["delete", "shorten", "overwrite"])
def test_harmed_output_makes_the_stage_run_again(tmp_path: Path, harm: str) -> None:
    output = tmp_path / "cloud.ply"
    work = Counter(output, "0123456789")
    run_stage(tmp_path, work, outputs=("cloud.ply",))
    if harm == "delete":
        output.unlink()
    else:
        output.write_text("012345" if harm == "shorten" else "987654321x", encoding="utf-8")
    assert run_stage(tmp_path, work, outputs=("cloud.ply",)).ran
    assert output.read_text(encoding="utf-8") == "0123456789"


@pytest.mark.parametrize("name", ["trees.xlsx", "figures/tree_1.png"])
def test_what_lies_beside_the_outputs_is_made_again_where_it_was_deleted_only(tmp_path: Path, name: str) -> None:
    work = Counter(tmp_path / name)
    beside = ("trees.xlsx", "figures")

    def ran() -> bool:
        return run_stage(tmp_path, work, beside=beside).ran

    assert [ran(), ran()] == [True, False]
    (tmp_path / name).write_text("a person's column beside", encoding="utf-8")
    (tmp_path / name).with_name("mine.txt").write_text("a person's", encoding="utf-8")
    assert not ran()
    (tmp_path / name).with_name("mine.txt").unlink()
    (tmp_path / name).unlink()
    stage = Stage(name="s", version=1, result=Counted, beside=beside)
    assert Ledger(tmp_path).recall(stage) is None
    assert [ran(), ran()] == [True, False]
    # A record of before tells nothing of it.
    record = tmp_path / ".fsinfer" / "s.json"
    told = json.loads(record.read_text(encoding="utf-8"))
    del told["beside"]
    record.write_text(json.dumps(told), encoding="utf-8")
    assert not ran()


def test_later_stage_follows_an_earlier_one_that_ran_again(tmp_path: Path) -> None:
    early, late = Counter(tmp_path / "early" / "a"), Counter(tmp_path / "late" / "a")

    def both(early_input: int, late_input: int) -> list[bool]:
        first = run_stage(tmp_path, early, name="early", inputs={"k": early_input}, outputs=("early",))
        second = run_stage(tmp_path, late, name="late", inputs={"k": late_input}, after=[first], outputs=("late",))
        return [first.ran, second.ran]

    assert both(1, 1) == [True, True]
    assert both(1, 2) == [False, True]
    assert both(2, 2) == [True, True]
    early.path.unlink()
    assert both(2, 2) == [True, True]
    assert both(2, 2) == [False, False]


def _interrupted(out: Path, *, inputs: dict[str, int], keeps_partial: bool) -> None:
    def half(_resume: bool) -> Counted:
        (out / "maps").mkdir(exist_ok=True)
        (out / "maps" / "half.pfm").write_text("x", encoding="utf-8")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_stage(out, half, inputs=inputs, outputs=("maps",), keeps_partial=keeps_partial)


@pytest.mark.parametrize(
    ("keeps_partial", "inputs", "kept"), [(True, {"k": 1}, True), (True, {"k": 2}, False), (False, {"k": 1}, False)]
)
def test_interrupted_stage_goes_on_only_with_the_same_inputs(
    tmp_path: Path, keeps_partial: bool, inputs: dict[str, int], kept: bool
) -> None:
    _interrupted(tmp_path, inputs={"k": 1}, keeps_partial=keeps_partial)
    work = Counter(tmp_path / "maps" / "whole.pfm")
    record = run_stage(tmp_path, work, inputs=inputs, outputs=("maps",), keeps_partial=keeps_partial)
    assert record.ran
    assert (tmp_path / "maps" / "half.pfm").exists() is kept
    assert work.resumed == [kept]


def test_interrupted_stage_goes_on_only_in_the_folders_that_it_was_in(tmp_path: Path) -> None:
    """fsinfer poses in the folder of a run, stopped with the options that the run is given next."""

    def stop(_resume: bool) -> Counted:
        raise KeyboardInterrupt

    _interrupted(tmp_path, inputs={"k": 1}, keeps_partial=True)
    with pytest.raises(KeyboardInterrupt):
        run_stage(tmp_path, stop, inputs={"k": 2}, outputs=("own",), keeps_partial=True)
    work = Counter(tmp_path / "maps" / "whole.pfm")
    run_stage(tmp_path, work, inputs={"k": 2}, outputs=("maps",), keeps_partial=True)
    assert work.resumed == [False]
    assert not (tmp_path / "maps" / "half.pfm").exists()


def test_time_of_an_interrupted_attempt_is_counted(tmp_path: Path) -> None:
    _interrupted(tmp_path, inputs={}, keeps_partial=True)
    path = tmp_path / ".fsinfer" / "s.json"
    saved = json.loads(path.read_text(encoding="utf-8"))
    assert saved["state"] == "started"
    path.write_text(json.dumps(saved | {"seconds": 100.0}), encoding="utf-8")
    work = Counter(tmp_path / "maps" / "a")
    record = run_stage(tmp_path, work, outputs=("maps",), keeps_partial=True)
    assert 100.0 <= record.seconds < 101.0


def test_failed_stage_keeps_its_error_and_is_not_done(tmp_path: Path) -> None:
    def fail(_resume: bool) -> Counted:
        raise PosesError("no poses")

    with pytest.raises(PosesError, match="no poses"):
        run_stage(tmp_path, fail)
    work = Counter(tmp_path / "a")
    assert run_stage(tmp_path, work).ran


def test_foreign_files_are_never_deleted(tmp_path: Path) -> None:
    mine = tmp_path / "frames" / "holiday.jpg"
    mine.parent.mkdir()
    mine.write_text("precious", encoding="utf-8")
    work = Counter(tmp_path / "frames" / "a")
    with pytest.raises(InputError, match="choose another output folder"):
        run_stage(tmp_path, work, outputs=("frames",))
    assert work.calls == 0
    assert mine.read_text(encoding="utf-8") == "precious"


def test_folders_of_a_stage_that_it_made_nowhere_here_are_the_users(tmp_path: Path) -> None:
    """Of ``fsinfer run PLOT/images PLOT`` and then ``fsinfer frames VIDEO PLOT``, which owns PLOT/images."""
    mine = tmp_path / "images" / "IMG_1.jpg"
    mine.parent.mkdir()
    mine.write_text("precious", encoding="utf-8")
    run_stage(tmp_path, Counter(tmp_path / "frames" / "a"), outputs=("frames",))
    alone = Counter(tmp_path / "images" / "a")
    with pytest.raises(InputError, match="choose another output folder"):
        run_stage(tmp_path, alone, inputs={"other": 1}, outputs=("images", "frames.csv"))
    assert mine.read_text(encoding="utf-8") == "precious"
    # Moved away, both ways of the stage go on in one folder, each emptying what it made.
    mine.rename(tmp_path / "IMG_1.jpg")
    for _ in range(2):
        assert run_stage(tmp_path, alone, inputs={"other": 1}, outputs=("images", "frames.csv")).ran
        assert run_stage(tmp_path, Counter(tmp_path / "frames" / "b"), outputs=("frames",)).ran
        assert [path.name for path in (tmp_path / "frames").iterdir()] == ["b"]


def test_records_of_before_own_what_they_tell(tmp_path: Path) -> None:
    run_stage(tmp_path, Counter(tmp_path / "frames" / "a"), outputs=("frames",))
    path = tmp_path / ".fsinfer" / "s.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    del record["owned"]
    path.write_text(json.dumps(record), encoding="utf-8")
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "IMG_1.jpg").write_text("precious", encoding="utf-8")
    with pytest.raises(InputError, match="images holds files"):
        run_stage(tmp_path, Counter(tmp_path / "images" / "a"), inputs={"other": 1}, outputs=("images",))
    assert run_stage(tmp_path, Counter(tmp_path / "frames" / "b"), inputs={"other": 1}, outputs=("frames",)).ran


def test_damaged_record_costs_a_repetition_only(tmp_path: Path) -> None:
    work = Counter(tmp_path / "maps" / "a")
    run_stage(tmp_path, work, outputs=("maps",))
    (tmp_path / ".fsinfer" / "s.json").write_text('{"state": "do', encoding="utf-8")
    assert run_stage(tmp_path, work, outputs=("maps",)).ran
    assert not run_stage(tmp_path, work, outputs=("maps",)).ran


def test_a_new_version_of_the_algorithm_does_the_stage_again(tmp_path: Path) -> None:
    work = Counter(tmp_path / "maps" / "a")
    ran = [run_stage(tmp_path, work, version=version, outputs=("maps",)).ran for version in (1, 1, 2, 2)]
    assert ran == [True, False, True, False]
    entry = json.loads((tmp_path / ".fsinfer" / "s.json").read_text(encoding="utf-8"))
    assert (entry["version"], entry["made_by"]) == (2, __version__)


def test_a_result_of_another_layout_is_made_again(tmp_path: Path) -> None:
    work = Counter(tmp_path / "maps" / "a")
    run_stage(tmp_path, work, outputs=("maps",))
    path = tmp_path / ".fsinfer" / "s.json"
    saved = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps(saved | {"result": {"number": 1}}), encoding="utf-8")
    assert run_stage(tmp_path, work, outputs=("maps",)).result.calls == 2


def test_the_ledger_tells_what_a_finished_stage_was_made_from(tmp_path: Path) -> None:
    assert Ledger(tmp_path).inputs_of("s") is None
    _interrupted(tmp_path, inputs={"k": 1}, keeps_partial=True)
    assert Ledger(tmp_path).inputs_of("s") is None
    assert Ledger(tmp_path).has("s")
    run_stage(tmp_path, Counter(tmp_path / "maps" / "a"), inputs={"k": (1, 2)}, outputs=("maps",), keeps_partial=True)
    assert Ledger(tmp_path).inputs_of("s") == {"k": [1, 2]}


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

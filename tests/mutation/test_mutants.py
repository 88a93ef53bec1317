"""The breakages themselves: each is one place, is Python, and does not touch what decides nothing."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.mutation.__main__ import sample
from tests.mutation.mutants import Mutant, mutants_of
from tests.mutation.named import NAMED, ways_of
from tests.mutation.record import Record, digest_of, write_report
from tests.mutation.targets import TARGETS
from tests.mutation.trial import METHOD, Outcome, try_tests
from tests.support.places import ROOT

SOURCE = '''"""Doc with 5 in it."""

from dataclasses import dataclass

#: Rounds at most. Source: numerics.
ROUNDS = 7
#: What decides. Source: judgement.
LIMIT = 0.5


@dataclass
class Settings:
    """Two.

    Attributes
    ----------
    wide: of a thing. Source: judgement.
    steps: of it. Source: numerics.
    """

    wide: float = 0.25
    steps: int = 3


def inside(a: float, b: float = 2) -> bool:
    """Whether 9 is not."""
    if a < 0:
        raise ValueError(f"{a} < {0}")
    total = max(a * b + 1e-9, LIMIT)
    total += atan(a, b)
    list(zip([a], [b], strict=True))
    return total > 1 and not b
'''


def breakages(source: str = SOURCE) -> set[tuple[str, str]]:
    return {(mutant.before, mutant.after) for mutant in mutants_of(source, "some.py")}


def test_numbers_terms_comparisons_bounds_and_arguments_are_broken() -> None:
    found = breakages()
    assert {("0.5", "1.0"), ("0.5", "0.25"), ("0.25", "0.5"), ("2", "3")} <= found
    assert {("a * b", "((a) / (b))"), ("a * b", "(a)"), ("max", "min"), ("a, b", "b, a")} <= found
    assert {("a < 0", "(a >= 0)"), ("not b", "(b)"), ("total += atan(a, b)", "pass")} <= found
    assert ("total > 1 and not b", "((total > 1) or (not b))") in found


def test_what_decides_nothing_is_left_alone() -> None:
    numbers = {before for before, _ in breakages() if before.replace(".", "").isdigit()}
    assert "True" not in {before for before, _ in breakages()}
    assert numbers == {"0.5", "0.25", "2", "0", "1"}  # not ROUNDS, steps, 1e-9, nor what is raised or written


def test_every_breakage_is_one_place_and_can_be_read() -> None:
    for mutant in mutants_of(SOURCE, "some.py"):
        broken = mutant.apply(SOURCE)
        assert ast.dump(ast.parse(broken)) != ast.dump(ast.parse(SOURCE)), mutant
        assert broken.startswith(SOURCE[: mutant.start])
        assert broken.endswith(SOURCE[mutant.end :])


def test_targets_are_files_and_samples_hold_each_other() -> None:
    for name, target in TARGETS.items():
        assert all((ROOT / path.partition("::")[0]).exists() for path in (*target.files, *target.tests)), name
        few, more = sample(target, name, 2, 0), sample(target, name, 4, 0)
        assert more[:2] == few
    every = mutants_of((ROOT / "fsinfer/trees/diameter/dbh.py").read_text(encoding="utf-8"), "dbh.py")
    assert len({mutant.name for mutant in every}) == len(every) > 250


@pytest.mark.parametrize("name", NAMED)
def test_what_is_broken_by_name_is_still_there(name: str) -> None:
    source = (ROOT / NAMED[name].file).read_text(encoding="utf-8")
    assert all((ROOT / test.partition("::")[0]).exists() for test in NAMED[name].tests)
    for way in ways_of(name):
        assert way.apply(source) == source.replace(way.before, way.after)
        ast.parse(way.apply(source))


@pytest.fixture
def project(tmp_path: Path) -> Path:
    (tmp_path / "thing.py").write_text("def double(a):\n    return 2 * a\n")
    (tmp_path / "test_thing.py").write_text("from thing import double\n\ndef test_it():\n    assert double(2) == 4\n")
    (tmp_path / "pytest.ini").write_text("[pytest]\npythonpath = .\naddopts = --import-mode=importlib\n")
    return tmp_path


@pytest.mark.skipif(METHOD == "spawn", reason="a new process does not find this package in a project of its own")
@pytest.mark.parametrize(
    ("source", "state"),
    [
        (None, "survived"),
        ("def double(a):\n    return a * 2\n", "survived"),
        ("def double(a):\n    return 3 * a\n", "killed"),
        ("def double(a):\n    while True: pass\n", "timeout"),
    ],
)
def test_a_trial_tells_what_the_tests_say_of_broken_source(project: Path, source: str | None, state: str) -> None:
    broken = None if source is None else ("thing.py", source)
    outcome = try_tests(project, ["test_thing.py"], limit_s=3.0 if state == "timeout" else 30.0, broken=broken)
    assert outcome.state == state
    assert outcome.by == ("test_thing.py::test_it" if state == "killed" else "")
    assert (project / "thing.py").read_text().endswith("return 2 * a\n")


def test_what_is_known_is_kept_and_told(tmp_path: Path) -> None:
    first, second, third = mutants_of(SOURCE, "some.py")[:3]
    record = Record(tmp_path / "known" / "results.jsonl")
    record.note("dbh", first, "v1", Outcome(state="killed", by="test_a", seconds=1.0))
    record.note("dbh", second, "v1", Outcome(state="survived", by="", seconds=1.0))
    again = Record(tmp_path / "known" / "results.jsonl")
    assert again.knows(first, "v2")  # killed stays killed
    assert again.knows(second, "v1")
    assert not again.knows(second, "v2")  # other tests may see it
    assert not again.knows(third, "v1")
    reasons = tmp_path / "survivors.toml"
    for why, score in (("numerics", "50 % | 50 %"), ("without effect: it is the same", "50 % | 100 %")):
        reasons.write_text(f'{second.name} = "{why}"\n')
        named = {"both": [first, second], "none": [third]}
        text = write_report({"dbh": [first, second, third]}, named, again, seed=0, per_module=3, reasons=reasons)
        assert "| both | 2 | 1 |\n| none | 1 | not tried |" in text
        assert f"| dbh | 2 | 1 | 1 | {int('effect' in why)} | {score} |" in text
        assert f"({second.name}) | {why} |" in text


def test_the_digest_of_tests_sees_their_text(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "test_b.py").write_text("1")
    before = digest_of(["a"], tmp_path)
    (tmp_path / "a" / "test_b.py").write_text("2")
    assert digest_of(["a"], tmp_path) != before


def test_a_breakage_has_the_same_name_wherever_its_line_stands() -> None:
    def names(source: str) -> set[str]:
        return {mutant.name for mutant in mutants_of(source, "some.py")}

    assert names("# a line more\n" + SOURCE) == names(SOURCE)
    assert isinstance(mutants_of(SOURCE, "some.py")[0], Mutant)

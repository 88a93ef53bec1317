"""What is known of each breakage, kept between runs, and the page that tells it."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.mutation.mutants import Mutant
from tests.mutation.trial import Outcome
from tests.support.places import ROOT

#: Why a breakage may survive, by its name: written by hand.
REASONS = Path(__file__).with_name("survivors.toml")

_HEAD = """# Breakages that the tests notice

A test that nothing can fail is no test. `python -m tests.mutation` breaks the modules that a diameter, its interval and
the network hang on, one place at a time (a number doubled or halved, a term left out, a comparison turned round, two
arguments changed over ...), and runs the tests that belong to the module. A breakage that they notice is *killed*, one
that they do not notice *survives*. `tests/mutation/mutants.py` says what is broken, `tests/mutation/targets.py` which
tests belong to what.

The run takes hours, is not part of `.ci/run`, and goes on where it was stopped: `tests/mutation/results.jsonl` holds
what became of each breakage, and by which test. mutmut and cosmic-ray were looked at first: mutmut 3 breaks functions
only, and here most of what decides stands in the fields of settings; cosmic-ray writes into the working tree, knows
one command of tests for all modules, and breaks numbers by one, so that 0.0005 becomes 1.0005.

This page is written by `{command}`.

"""


class Record:
    """The outcomes in a file of JSON lines; the last line on a breakage counts."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[str, dict[str, Any]] = {}
        if path.is_file():
            for line in path.read_text(encoding="utf-8").splitlines():
                entry = json.loads(line)
                self._known[entry["name"]] = entry

    def knows(self, mutant: Mutant, tests: str) -> bool:
        """Whether it was killed before, or survived these very tests."""
        entry = self._known.get(mutant.name)
        return entry is not None and (entry["state"] != "survived" or entry["tests"] == tests)

    def state(self, mutant: Mutant) -> str | None:
        """``survived``, ``killed``, ``timeout``, or None where it was not tried."""
        entry = self._known.get(mutant.name)
        return None if entry is None else str(entry["state"])

    def note(self, target: str, mutant: Mutant, tests: str, outcome: Outcome) -> None:
        """Add an outcome and write it down."""
        entry = {
            "name": mutant.name, "target": target, "tests": tests, "state": outcome.state, "by": outcome.by,
            "seconds": round(outcome.seconds, 1), "place": f"{mutant.file}:{mutant.line}", "code": mutant.code,
            "before": mutant.before, "after": mutant.after,
        }  # fmt: skip
        self._known[mutant.name] = entry
        self._path.parent.mkdir(exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")


def digest_of(tests: Sequence[str], root: Path = ROOT) -> str:
    """Digest of test files and folders: another one where the tests have changed."""
    digest = hashlib.sha256()
    for test in tests:
        path = root / test.partition("::")[0]
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(file.relative_to(root).as_posix().encode() + file.read_bytes())
    return digest.hexdigest()[:12]


def read_reasons(path: Path = REASONS) -> dict[str, str]:
    """Reasons by the name of the breakage."""
    return {str(name): str(why) for name, why in tomllib.loads(path.read_text(encoding="utf-8")).items()}


def write_report(
    chosen: Mapping[str, Sequence[Mutant]],
    named: Mapping[str, Sequence[Mutant]],
    record: Record,
    *,
    seed: int,
    per_module: int,
    reasons: Path = REASONS,
) -> str:
    """The page: score by module, what became of the named ones, then every survivor with its reason."""
    why = read_reasons(reasons)
    rows, survivors = [], []
    sums = [0, 0, 0, 0]
    for name, mutants in chosen.items():
        states = [record.state(mutant) for mutant in mutants]
        left = [mutant for mutant, state in zip(mutants, states, strict=True) if state == "survived"]
        tried = sum(state is not None for state in states)
        killed, excused = tried - len(left), sum(_excused(why.get(mutant.name, "")) for mutant in left)
        survivors += [(name, mutant) for mutant in left]
        sums = [total + value for total, value in zip(sums, (tried, killed, len(left), excused), strict=True)]
        rows.append(_row(name, tried, killed, len(left), excused))
    command = "python -m tests.mutation --report docs/mutation.md"
    lines = [
        _HEAD.format(command=command),
        f"## Score\n\nUp to {per_module or 'all'} breakages of each module, drawn with seed {seed}; *tried* says how",
        "many there was time for. *Without effect* are survivors that no test could tell from the sound code; the last",
        "column leaves them out. Tests were written with this very sample before one's eyes, so that it flatters:",
        "another `--seed` draws breakages that nobody has looked at.\n",
        "| module | tried | killed | survived | without effect | score | score without those |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        *rows,
        _row("**all**", *sums),
        "\n## Breakages that a review found\n",
        "A review broke these by hand and no test failed. `python -m tests.mutation --named` breaks them again, each",
        "in one or more ways, numbers by half and by double (`tests/mutation/named.py`).\n",
        "| breakage | ways | noticed |",
        "| --- | --- | --- |",
        *(_named_row(name, [record.state(way) for way in ways]) for name, ways in named.items()),
        "\n## Survivors\n",
    ]
    if survivors:
        lines += ["| module | where | breakage | why it survives |", "| --- | --- | --- | --- |"]
    for name, mutant in survivors:
        where = f"`{Path(mutant.file).name}`, {mutant.where or 'module'}: `{_cell(mutant.code)}`"
        breakage = f"{mutant.kind}: `{_cell(mutant.before)}` → `{_cell(mutant.after)}` ({mutant.name})"
        lines.append(f"| {name} | {where} | {breakage} | {why.get(mutant.name, 'not yet looked at')} |")
    return "\n".join(lines) + "\n"


def _excused(reason: str) -> bool:
    return reason.startswith("without effect")


def _named_row(name: str, states: Sequence[str | None]) -> str:
    noticed = sum(state in ("killed", "timeout") for state in states)
    return f"| {name} | {len(states)} | {noticed if all(states) else 'not tried'} |"


def _row(name: str, tried: int, killed: int, survived: int, excused: int) -> str:
    score = f"{100 * killed / tried:.0f} %" if tried else ""
    rest = f"{100 * killed / (tried - excused):.0f} %" if tried > excused else ""
    return f"| {name} | {tried} | {killed} | {survived} | {excused} | {score} | {rest} |"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("`", "'")

"""What is kept of a plot that was given to a run: ``batch.json`` in its folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from fsinfer._version import __version__
from fsinfer.io.digest import file_digest
from fsinfer.io.files import is_by_system, write_text
from fsinfer.output.json_values import as_json, of_json
from fsinfer.output.layout import CLICKS_FILE, EDITS_FILE, PLOT_FILE, REPORT_FILE, TREES_CSV
from fsinfer.workflow.pipeline import STAGES

OUTCOME_FILE = "batch.json"
#: What a finished plot must still have for its run not to be started again; all the rest is the run's own ledger's.
_RESULTS = (PLOT_FILE, TREES_CSV, REPORT_FILE)
#: What a user may have put into a plot's folder by hand.
CORRECTIONS = (EDITS_FILE, CLICKS_FILE)


class State(StrEnum):
    """Where a plot stands; ``outdated`` has results, which are not those that it is to have now."""

    done = "done"
    outdated = "outdated"
    failed = "failed"
    waiting = "waiting"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a plot.

    Attributes
    ----------
    state: any but waiting. message: why it failed, or what else is to be known, one line. again: whether another
        attempt may go better.
    ran: False where it was done before and nothing has changed.
    attempts: that were made. seconds: that all of them took, those of earlier batches too.
    host: the computer of the last one. peak_gb: largest memory, where there was a limit on it.
    place_deg: latitude and longitude in WGS84, the middle of those that the photographs carry; None without any.
    inputs: digest of what it was made from; options: of that without the photographs; named: of that
        without what the files hold that options name. Empty where they were not kept.
    results: digests of its main files.
    """

    state: State
    message: str = ""
    again: bool = False
    ran: bool = True
    attempts: int = 1
    seconds: float = 0.0
    host: str = ""
    peak_gb: float | None = None
    place_deg: tuple[float, float] | None = None
    inputs: str = ""
    options: str = ""
    named: str = ""
    results: tuple[str, ...] = ()


def read_outcome(out: Path) -> Outcome | None:
    """The outcome kept in a plot's folder; None where there is none, or one that cannot be read."""
    try:
        kept = json.loads((out / OUTCOME_FILE).read_text(encoding="utf-8"))
        # Earlier versions kept no digests of the options alone.
        return of_json(Outcome, {"options": "", "named": ""} | kept)
    except (OSError, ValueError, TypeError, KeyError):
        return None


def write_outcome(out: Path, outcome: Outcome) -> None:
    """Keep an outcome in the plot's folder, atomically."""
    write_text(out / OUTCOME_FILE, json.dumps(as_json(outcome), indent=1, ensure_ascii=False) + "\n")


def inputs_digest(photos: Sequence[Path], out: Path, options: Sequence[str], files: Iterable[Path]) -> str:
    """Digest of the options, the versions, and names, sizes and times of all files that a run would read.

    Versions are that of the package and those of a run's stages, as its ledger has them: a plot whose trees would be
    measured in another way now is not done.

    Quick for thousands of plots; what it takes for new, such as photographs that were copied, ``fsinfer run`` looks at
    more closely and does not do again. Without ``photos`` it is that of the options.
    """
    read = [*sorted(photos), *files, *(out / name for name in CORRECTIONS)]
    versions = [__version__, *(f"{stage.name} {stage.version}" for stage in STAGES)]
    told = [versions, list(options), [_describe(path) for path in read]]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def photo_files(photos: Path) -> list[Path]:
    """The files of a folder of photographs, or the video; none where there is neither."""
    try:
        if photos.is_dir():
            return [path for path in photos.iterdir() if path.is_file() and not is_by_system(path.name)]
    except OSError:
        return []
    return [photos] if photos.is_file() else []


def result_digests(out: Path) -> tuple[str, ...]:
    """Digests of the main results; empty where one is missing."""
    paths = [out / name for name in _RESULTS]
    return tuple(file_digest(path) for path in paths) if all(path.is_file() for path in paths) else ()


def _describe(path: Path) -> tuple[str, int, int] | tuple[str]:
    try:
        found = path.stat()
    except OSError:
        return (path.name,)
    return (path.name, found.st_size, found.st_mtime_ns)

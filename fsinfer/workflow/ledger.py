"""Bookkeeping of the stages of a run: what is done, from which inputs, in how many seconds, with how much memory.

Each stage has one small JSON record in ``OUT/.fsinfer/NAME.json``. It is written with state ``started`` before the
work and with state ``done`` *after* everything else, so that a kill at any moment leaves a stage that is not done.
A stage is skipped when its record is done, its fingerprint (settings and inputs) is the same, and its outputs are
still what the stage wrote. Later stages put the ``run_id`` of the earlier ones into their inputs: a stage that ran
again, for whatever reason, makes those that depend on it run again.
"""

from __future__ import annotations

import hashlib
import json
import logging
import secrets
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fsinfer.errors import InputError, OutputError
from fsinfer.io.digest import file_digest
from fsinfer.io.files import make_folder, write_text
from fsinfer.output.json_values import as_json
from fsinfer.workflow.memory_peak import MemoryPeak

RECORDS_FOLDER = ".fsinfer"
# Raised when a record of an older layout must not be trusted any more.
RECORD_FORMAT = 1

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class StageRecord:
    """What is known of one stage.

    Attributes
    ----------
    name: the stage.
    run_id: changes each time that the stage really runs.
    seconds: wall-clock time of the work, summed over interrupted attempts with the same inputs.
    peak_rss_mb: largest resident memory while it ran, MiB; None where the system does not tell.
    result: what the stage returned (JSON values).
    ran: False when the stage was skipped because it was done before.
    """

    name: str
    run_id: str
    seconds: float
    peak_rss_mb: float | None
    result: dict[str, Any]
    ran: bool


class StageBook:
    """The records of one output folder; :meth:`run` does a stage or skips it."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.folder = out / RECORDS_FOLDER
        self.records: dict[str, StageRecord] = {}

    def run(
        self,
        name: str,
        work: Callable[[], Mapping[str, Any]],
        *,
        inputs: Mapping[str, Any],
        after: Sequence[str] = (),
        outputs: Sequence[str] = (),
        keeps_partial: bool = False,
    ) -> StageRecord:
        """Do ``work`` unless it was done before with the same inputs.

        Parameters
        ----------
        name: name of the stage, used as a file name.
        work: returns the stage's result, JSON values only.
        inputs: everything the result depends on (settings dataclasses, digests of files); made JSON by
            :func:`as_json`.
        after: names of the stages whose outputs this one reads; they must have been run in this book.
        outputs: files and folders below the output folder that the stage owns. Folders are emptied before the work.
        keeps_partial: the work goes on with what an interrupted attempt *with the same inputs* left, instead of
            starting with empty folders.

        Raises
        ------
        InputError
            A folder the stage would have to empty was not made by this stage.
        FsinferError
            Whatever ``work`` raises; the stage stays not done.
        """
        before = {earlier: self.records[earlier].run_id for earlier in after}
        fingerprint = _digest({"format": RECORD_FORMAT, "stage": name, "inputs": as_json(inputs), "after": before})
        saved = self._read(name)
        same = saved.get("fingerprint") == fingerprint
        if same and saved.get("state") == "done" and saved.get("outputs") == self._describe(outputs):
            _log.info("stage %s: done before, skipped", name)
            record = _record(name, saved, ran=False)
            self.records[name] = record
            return record
        carried_on = same and saved.get("state") == "started" and keeps_partial
        if not carried_on:
            self._empty(name, outputs, known=bool(saved))
        spent_s = float(saved.get("seconds", 0.0)) if carried_on else 0.0
        entry: dict[str, Any] = {"state": "started", "fingerprint": fingerprint, "run_id": secrets.token_hex(8)}
        self._write(name, entry | {"seconds": spent_s})
        start = time.perf_counter()
        peak = MemoryPeak()
        try:
            result = dict(work())
        except BaseException:
            # Only for the clock: the time of an attempt that a later one goes on from is part of the cost.
            self._write(name, entry | {"seconds": spent_s + time.perf_counter() - start})
            raise
        entry |= {"seconds": round(spent_s + time.perf_counter() - start, 3), "peak_rss_mb": peak.read_mb()}
        entry |= {"result": as_json(result), "outputs": self._describe(outputs), "state": "done"}
        self._write(name, entry)
        record = _record(name, entry, ran=True)
        self.records[name] = record
        return record

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.json"

    def _read(self, name: str) -> dict[str, Any]:
        try:
            saved = json.loads(self._path(name).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError):
            # A damaged record only costs a repetition; "known" stays true, so that the folder may be emptied.
            return {"state": "damaged"}
        return saved if isinstance(saved, dict) else {"state": "damaged"}

    def _write(self, name: str, entry: Mapping[str, Any]) -> None:
        write_text(self._path(name), json.dumps(entry, indent=1) + "\n")

    def _describe(self, outputs: Sequence[str]) -> dict[str, Any]:
        """Say what lies at each output, so that a deleted, emptied or overwritten one is noticed."""
        return {output: _describe_path(self.out / output) for output in outputs}

    def _empty(self, name: str, outputs: Sequence[str], *, known: bool) -> None:
        for output in outputs:
            folder = self.out / output
            if not folder.is_dir() or not any(folder.iterdir()):
                continue
            if not known:
                msg = f"{folder} holds files that this run did not make; choose another output folder or move them away"
                raise InputError(msg)
            try:
                shutil.rmtree(folder)
            except OSError as error:
                msg = f"cannot empty {folder} for stage {name} ({error.strerror or error}); delete it by hand"
                raise OutputError(msg) from error
            make_folder(folder)


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _describe_path(path: Path) -> Any:
    if path.is_dir():
        sizes = [item.stat().st_size for item in path.rglob("*") if item.is_file()]
        return [len(sizes), sum(sizes)]
    return file_digest(path) if path.is_file() else None


def _record(name: str, entry: Mapping[str, Any], *, ran: bool) -> StageRecord:
    return StageRecord(
        name=name,
        run_id=str(entry["run_id"]),
        seconds=float(entry["seconds"]),
        peak_rss_mb=entry.get("peak_rss_mb"),
        result=dict(entry["result"]),
        ran=ran,
    )

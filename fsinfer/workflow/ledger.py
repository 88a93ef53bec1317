"""The ledger of an output folder: which stages are done, from which inputs, in how many seconds, with how much memory.

Each stage has one small JSON record in ``OUT/.fsinfer/NAME.json``. It is written with state ``started`` before the
work and with state ``done`` *after* everything else, so that a kill at any moment leaves a stage that is not done.
A stage is skipped when its record is done, its fingerprint is the same, and its outputs are still what the stage wrote.

The fingerprint holds what the stage reads, every setting it uses, the version of its own algorithm, and the ``run_id``
of the stages it follows: one that ran again, for whatever reason, makes those that depend on it run again.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import secrets
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from fsinfer._version import __version__
from fsinfer.errors import FsinferError, InputError, OutputError
from fsinfer.io.digest import file_digest
from fsinfer.io.files import disk_full, is_by_system, is_disk_full, make_folder, write_text
from fsinfer.io.json_text import read_json
from fsinfer.output.json_values import as_json, of_json
from fsinfer.output.layout import RECORDS_FOLDER
from fsinfer.processes import hand_back
from fsinfer.workflow.folder_lock import alone_in
from fsinfer.workflow.memory_peak import MemoryPeak

#: Raised when records of an older layout must not be trusted any more. Source: the layout of the record.
RECORD_FORMAT = 2

T = TypeVar("T")
# What of_json raises for a result that somebody else wrote.
_UNREADABLE = (TypeError, ValueError, KeyError, OverflowError, InputError)
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Stage(Generic[T]):
    """What is fixed about a stage.

    Attributes
    ----------
    name: of the stage and of its record.
    version: of its algorithm: raised with every change after which the same inputs give another result.
    result: type of what it returns, a frozen dataclass.
    outputs: files and folders below the output folder that it owns. Folders are emptied before the work.
    beside: further files and folders of files that it makes. One that was deleted is made again; what they hold may be
        changed by hand, as workbooks are.
    keeps_partial: the work goes on with what an interrupted attempt *with the same fingerprint* left, instead of
        starting with empty folders.
    later: fields of the result, JSON values, that earlier versions did not write, for what is recalled of theirs.
    """

    name: str
    version: int
    result: type[T]
    outputs: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    keeps_partial: bool = False
    later: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class StageRecord(Generic[T]):
    """What is known of one stage that is done.

    Attributes
    ----------
    name: the stage.
    run_id: changes each time that the stage really runs.
    seconds: wall-clock time of the work, summed over interrupted attempts with the same fingerprint.
    peak_rss_mb: largest resident memory while it ran, MiB; None where the system does not tell.
    made_by: version of fsinfer that did the work.
    result: what the stage returned.
    ran: False when the stage was skipped because it was done before.
    """

    name: str
    run_id: str
    seconds: float
    peak_rss_mb: float | None
    made_by: str
    result: T
    ran: bool


class Ledger:
    """The records of one output folder; :meth:`run` does a stage or skips it."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.folder = out / RECORDS_FOLDER

    def run(
        self,
        stage: Stage[T],
        work: Callable[[bool], T],
        *,
        inputs: Mapping[str, Any],
        after: Sequence[StageRecord[Any]] = (),
        again: bool = False,
    ) -> StageRecord[T]:
        """Do ``work`` unless it was done before with the same inputs.

        Parameters
        ----------
        stage: what is fixed about it.
        work: returns the stage's result. It is given True where it may go on with what an attempt left.
        inputs: everything the result depends on (settings dataclasses, digests of files); made JSON by
            :func:`fsinfer.output.json_values.as_json`.
        after: records of the stages whose outputs this one reads.
        again: do it though it was done before: something that the inputs do not tell has changed.

        Raises
        ------
        InputError
            A folder the stage would have to empty was not made by this stage.
        OutputError
            Another run is at work in the folder, or the disk is full.
        FsinferError
            Whatever ``work`` raises; the stage stays not done. One that was done with other inputs, and whose outputs
            are still what it wrote, stays done with those.
        """
        with alone_in(self.out):
            return self._run(stage, work, inputs=inputs, after=after, again=again)

    def _run(
        self,
        stage: Stage[T],
        work: Callable[[bool], T],
        *,
        inputs: Mapping[str, Any],
        after: Sequence[StageRecord[Any]],
        again: bool,
    ) -> StageRecord[T]:
        told = {
            "format": RECORD_FORMAT,
            "stage": stage.name,
            "version": stage.version,
            "inputs": as_json(inputs),
            "after": {record.name: record.run_id for record in after},
        }
        fingerprint = _digest(told)
        saved = self._read(stage.name)
        same = saved.get("fingerprint") == fingerprint
        if same and not again and self._is_done(stage, saved):
            try:
                record = self._record(stage, saved, ran=False)
            except _UNREADABLE:
                _log.info("stage %s: its record is of another version", stage.name)
            else:
                _log.info("stage %s: done before, skipped", stage.name)
                return record
        # ``fsinfer poses`` works in other folders than the poses of a run; records of before do not tell in which.
        there = saved.get("into", sorted(stage.outputs)) == sorted(stage.outputs)
        carried_on = same and there and saved.get("state") == "started" and stage.keeps_partial
        if not carried_on:
            self._empty(stage, owned=_owned(stage, saved))
        spent_s = (_number(saved.get("seconds")) or 0.0) if carried_on else 0.0
        entry: dict[str, Any] = {"state": "started", "fingerprint": fingerprint, "run_id": secrets.token_hex(8)}
        entry |= {"version": stage.version, "made_by": __version__, "inputs": told["inputs"]}
        entry["owned"] = sorted(_owned(stage, saved) | set(stage.outputs))
        entry["into"] = sorted(stage.outputs)
        self._write(stage.name, entry | {"seconds": spent_s})
        start = time.perf_counter()
        hand_back()
        peak = MemoryPeak()
        try:
            result = work(carried_on)
        except BaseException as error:
            # Before the record is written: libraries have errors of their own for a full disk.
            full = isinstance(error, Exception) and not isinstance(error, OutputError) and is_disk_full(self.out)
            # What was refused before it wrote anything leaves the results of before whole, and theirs is the record.
            refused = isinstance(error, FsinferError) and not isinstance(error, OutputError)
            if refused and self._is_done(stage, saved):
                left = saved
            else:
                # Only for the clock: the time of an attempt that a later one goes on from is part of the cost.
                left = entry | {"seconds": spent_s + time.perf_counter() - start}
            with suppress(OutputError):
                self._write(stage.name, left)
            if full:
                raise disk_full(self.out) from error
            raise
        entry |= {"seconds": round(spent_s + time.perf_counter() - start, 3), "peak_rss_mb": peak.read_mb()}
        entry |= {"result": as_json(result, folder=self.out), "outputs": self._describe(stage.outputs), "state": "done"}
        entry |= {"beside": {name: _files_at(self.out / name) for name in stage.beside}}
        self._write(stage.name, entry)
        return self._record(stage, entry, ran=True)

    def recall(self, stage: Stage[T]) -> StageRecord[T] | None:
        """The record of a stage that is done and whose outputs are still what it wrote, whatever its inputs are now."""
        saved = self._read(stage.name)
        if not self._is_done(stage, saved):
            return None
        try:
            return self._record(stage, saved, ran=False)
        except _UNREADABLE:
            return None

    def inputs_of(self, name: str, *, begun: bool = False) -> dict[str, Any] | None:
        """The inputs that a stage was done with, JSON values; None where it is not done.

        ``begun``: those of one that did not come to its end as well.
        """
        saved = self._read(name)
        inputs = saved.get("inputs")
        known = saved.get("state") == "done" or (begun and saved.get("state") == "started")
        return inputs if known and isinstance(inputs, dict) else None

    def is_begun(self, name: str) -> bool:
        """Whether the stage was begun and did not come to its end."""
        return bool(self._read(name).get("state") == "started")

    def has(self, name: str) -> bool:
        """Whether the stage was ever begun in this folder."""
        return self._path(name).is_file()

    def _record(self, stage: Stage[T], entry: Mapping[str, Any], *, ran: bool) -> StageRecord[T]:
        seconds = _number(entry["seconds"])
        if seconds is None:
            msg = f"{entry['seconds']!r} are no seconds"
            raise ValueError(msg)
        told = entry["result"]
        return StageRecord(
            name=stage.name,
            run_id=str(entry["run_id"]),
            seconds=seconds,
            peak_rss_mb=_number(entry.get("peak_rss_mb")),
            made_by=str(entry["made_by"]),
            result=of_json(stage.result, {**stage.later, **told} if isinstance(told, dict) else told, folder=self.out),
            ran=ran,
        )

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.json"

    def _read(self, name: str) -> dict[str, Any]:
        try:
            saved = read_json(self._path(name))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError):
            # A damaged record only costs a repetition; it is not none, so that the folders may be emptied.
            return {"state": "damaged"}
        return saved if isinstance(saved, dict) else {"state": "damaged"}

    def _write(self, name: str, entry: Mapping[str, Any]) -> None:
        write_text(self._path(name), json.dumps(entry, indent=1) + "\n")

    def _is_done(self, stage: Stage[Any], saved: Mapping[str, Any]) -> bool:
        """Whether a record is that of a stage that came to its end, and what it made is still there."""
        if saved.get("state") != "done" or saved.get("outputs") != self._describe(stage.outputs):
            return False
        beside = saved.get("beside", {})  # not in records of before
        if not isinstance(beside, dict):
            return False
        counts = {name: _number(count) for name, count in beside.items()}
        return all(count is not None and _files_at(self.out / name) >= count for name, count in counts.items())

    def _describe(self, outputs: Sequence[str]) -> dict[str, Any]:
        """Say what lies at each output, so that a deleted, emptied or overwritten one is noticed."""
        return {output: _describe_path(self.out / output) for output in outputs}

    def _empty(self, stage: Stage[T], *, owned: AbstractSet[str]) -> None:
        for output in stage.outputs:
            folder = self.out / output
            if not folder.is_dir() or all(is_by_system(item.name) for item in folder.iterdir()):
                continue
            if output not in owned:
                msg = f"{folder} holds files that this run did not make; choose another output folder or move them away"
                raise InputError(msg)
            try:
                shutil.rmtree(folder)
            except OSError as error:
                msg = f"cannot empty {folder} for stage {stage.name} ({error.strerror or error}); delete it by hand"
                raise OutputError(msg) from error
            make_folder(folder)


def _number(value: Any) -> float | None:
    """A finite number of a record, None for anything else."""
    sound = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if sound else None


def _owned(stage: Stage[Any], saved: Mapping[str, Any]) -> set[str]:
    """The outputs that this stage made before, here, and may empty.

    ``fsinfer run`` writes frames and scene into folders of their own, ``fsinfer frames`` and ``fsinfer poses`` into
    folders that may be the user's beside a run: ``PLOT/images`` of ``fsinfer run PLOT/images PLOT``.
    """
    told, described = saved.get("owned"), saved.get("outputs")
    if isinstance(told, list):
        return {output for output in told if isinstance(output, str)}
    # Records of before tell the outputs of a stage that is done; what they do not tell, and damaged ones, is believed.
    if isinstance(described, dict):
        return set(described)
    return set(stage.outputs) if saved else set()


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _files_at(path: Path) -> int:
    """How many files lie in a folder; 1 for a file, 0 for what is not there."""
    if path.is_dir():
        return sum(item.is_file() and not is_by_system(item.name) for item in path.iterdir())
    return int(path.is_file())


def _describe_path(path: Path) -> Any:
    if path.is_dir():
        # Looking into the folder leaves files there, and makes nothing of what the stage wrote another.
        found = (item for item in path.rglob("*") if not any(map(is_by_system, item.relative_to(path).parts)))
        sizes = [item.stat().st_size for item in found if item.is_file()]
        return [len(sizes), sum(sizes)]
    return file_digest(path) if path.is_file() else None

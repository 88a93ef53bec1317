"""What an output folder holds, read leniently: a missing or damaged part becomes a note, never a failure."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import FsinferError
from fsinfer.io.csv_text import read_rows
from fsinfer.io.json_text import read_json
from fsinfer.notices.stems import StemCode
from fsinfer.output.plot_json import OF_FILE
from fsinfer.scale.scale import CAMERA_HEIGHT_M
from fsinfer.trees.tree import OUTSIDE

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class StageWarning:
    """A warning of a stage: its ``text``, and what it is about.

    Attributes
    ----------
    code: the kind of warning; empty in ``plot.json`` of a version that wrote sentences only.
    text: the sentence, as written for the terminal.
    remark: True for what is of use to those who look closely, but asks for nothing.
    """

    code: str
    text: str
    remark: bool


@dataclass(frozen=True, kw_only=True)
class Contents:
    """The parts of an output folder that are text.

    Attributes
    ----------
    out: the folder.
    plot: ``plot.json``, {} when missing.
    trees: rows of ``trees.csv``, None when there is no table.
    revisit_advised: numbers of the trees whose reason in ``trees.csv`` says already to walk round the stem again, after
        ``trees.json``; none where that is missing.
    outside: numbers of the trees that stand outside of the walk: they are listed, and count in no figure of the stand.
    frames: rows of ``frames.csv``, None when there is none.
    notes: what could not be read, in plain words.
    unreadable: names of the files that ``notes`` are about.
    """

    out: Path
    plot: dict[str, Any]
    trees: list[dict[str, str]] | None
    revisit_advised: frozenset[int]
    outside: frozenset[int]
    frames: list[dict[str, str]] | None
    notes: tuple[str, ...]
    unreadable: frozenset[str] = frozenset()

    def why_missing(self, name: str) -> str:
        """Why there is nothing of the file ``name`` to show: it cannot be read, which a note tells, or is not there."""
        return f"{name} could not be read" if name in self.unreadable else f"{name} is not in this folder"

    @property
    def counted(self) -> list[dict[str, str]]:
        """The rows of ``trees.csv`` that count in the figures of the stand."""
        return [tree for tree in self.trees or () if tree_number(tree) not in self.outside]

    @property
    def photographed(self) -> bool:
        """Whether the trees are of photographs, not of a cloud of other origin in whatever folder."""
        if self.plot.get(OF_FILE) and self.cloud_from_scene is None and not self.plot.get("photos"):
            return False
        return bool(self.plot.get("photos")) or any((self.out / name).is_dir() for name in ("scene", "depth"))

    @property
    def metric(self) -> bool:
        """True when lengths are metres."""
        if self.plot.get("units") is not None:
            return bool(self.plot["units"] == "m")
        # A cloud measured by itself (fsinfer trees) has no scale of its own, but trees with a DBH.
        return bool(self.plot.get("scale_m_per_unit")) or any(
            number(t.get("dbh_cm")) is not None for t in self.trees or ()
        )

    @property
    def metre(self) -> float:
        """Length of a metre in units of the cloud: while no scale is known, guessed from the cameras' height."""
        camera_height = number(self.plot.get("camera_height"))
        guessed = not self.metric and camera_height is not None and camera_height > 0
        return (camera_height or 1.0) / CAMERA_HEIGHT_M if guessed else 1.0

    @property
    def cloud_from_scene(self) -> NDArray[np.float64] | None:
        """(4, 4) similarity from the scene's coordinates to those of ``cloud.ply``; None where it is not known."""
        try:
            similarity = np.array(self.plot.get("cloud_from_scene"), dtype=np.float64)
        except (TypeError, ValueError):
            return None
        sound = similarity.shape == (4, 4) and bool(np.isfinite(similarity).all())
        return similarity if sound and np.linalg.det(similarity[:3, :3]) > 0 else None

    @property
    def trees_per_cloud(self) -> float:
        """Coordinates of ``trees.csv`` are those of ``cloud.ply`` times this (``fsinfer trees --scale``)."""
        scale = self.plot.get("trees_scale")
        factor = number(scale.get("m_per_unit")) if isinstance(scale, dict) else None
        return factor if factor is not None and factor > 0 else 1.0

    @property
    def parts(self) -> list[Mapping[str, Any]]:
        """The parts of the walk that ``plot.json`` tells of."""
        parts = self.plot.get("parts")
        return [part for part in parts if isinstance(part, dict)] if isinstance(parts, list) else []

    @property
    def registered(self) -> float | None:
        """Photos that the plot is of: those that were placed, and those of the parts that were put into it."""
        own = number(self.plot.get("registered"))
        joined = (part for part in self.parts if isinstance(part.get("joined"), dict))
        return None if own is None else own + sum(number(part.get("registered")) or 0.0 for part in joined)

    @property
    def warnings(self) -> tuple[StageWarning, ...]:
        """What the stages warned of; without ``warning_codes`` every sentence is an ordinary warning."""
        coded = self.plot.get("warning_codes")
        if isinstance(coded, list):
            return tuple(
                StageWarning(code=str(one.get("code") or ""), text=str(one["text"]), remark=one.get("remark") is True)
                for one in coded
                if isinstance(one, dict) and one.get("text")
            )
        given = self.plot.get("warnings")
        texts = given if isinstance(given, list) else [given] if given else []
        return tuple(StageWarning(code="", text=str(text), remark=False) for text in texts)


def read_contents(out: Path) -> Contents:
    """Read the text parts of ``out``."""
    notes: dict[str, str] = {}
    plot = _lenient(lambda: _read_plot(out / "plot.json"), "plot.json", notes)
    trees = _lenient(lambda: read_rows(out / "trees.csv"), "trees.csv", notes)
    reasons = _lenient(lambda: _read_reasons(out / "trees.json"), "trees.json", notes) or {}
    # By the reason, not by the status: with --far-stems those are measured as any other.
    outside = _with(reasons, lambda reason: reason.get("code") == StemCode.outside_walk)
    frames_path = next((p for p in (out / "frames" / "frames.csv", out / "frames.csv") if p.is_file()), None)
    frames = None if frames_path is None else _lenient(lambda: read_rows(frames_path), "frames.csv", notes)
    return Contents(
        out=out,
        plot=plot or {},
        trees=trees,
        revisit_advised=_with(reasons, lambda reason: reason.get("advises_revisit") is True),
        outside=outside | {n for t in trees or () if t.get("status") == OUTSIDE and (n := tree_number(t)) is not None},
        frames=frames,
        notes=tuple(notes.values()),
        unreadable=frozenset(notes),
    )


def number(text: object) -> float | None:
    """Return a finite float, or None for an empty or unreadable cell."""
    try:
        value = float(text)  # type: ignore[arg-type]  # anything else is a TypeError
    except (TypeError, ValueError):
        return None
    return value if value - value == 0 else None


def measured_cm(rows: Sequence[Mapping[str, str]]) -> list[float]:
    """DBH of those rows of ``trees.csv`` that have one."""
    return [d for tree in rows if (d := number(tree.get("dbh_cm"))) is not None]


def tree_number(tree: Mapping[str, object]) -> int | None:
    """The number of a row of ``trees.csv`` or an entry of ``trees.json``; None where it is empty or damaged."""
    value = number(tree.get("tree_id"))
    return None if value is None else int(value)


def _lenient(read: Callable[[], T], name: str, notes: dict[str, str]) -> T | None:
    try:
        return read()
    except FileNotFoundError:
        return None
    except (OSError, ValueError, csv.Error, FsinferError) as error:
        # A codec's own words tell nobody what to do.
        why = "it is no text in UTF-8; save it so again" if isinstance(error, UnicodeDecodeError) else str(error)
        notes[name] = f"{name} could not be read ({why}); that part of the report is missing."
        return None


def _read_plot(path: Path) -> dict[str, Any]:
    plot = read_json(path)
    if not isinstance(plot, dict):
        msg = "it is no JSON object"
        raise ValueError(msg)
    return plot


def _read_reasons(path: Path) -> dict[int, list[dict[str, Any]]]:
    """The reasons of the trees in ``trees.json`` by number; entries of another shape are passed over."""
    trees = read_json(path)
    if not isinstance(trees, list):
        msg = "it is no JSON list"
        raise ValueError(msg)
    found = {}
    for tree in trees:
        reasons = tree.get("reasons") if isinstance(tree, dict) else None
        if not isinstance(reasons, list) or (tree_id := tree_number(tree)) is None:
            continue
        found[tree_id] = [reason for reason in reasons if isinstance(reason, dict)]
    return found


def _with(reasons: Mapping[int, list[dict[str, Any]]], holds: Callable[[dict[str, Any]], bool]) -> frozenset[int]:
    """Numbers of the trees of which a reason is such a one."""
    return frozenset(number for number, given in reasons.items() if any(map(holds, given)))

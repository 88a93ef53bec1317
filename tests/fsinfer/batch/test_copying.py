"""Photographs to a worker that shares no disk, and results back; the worker here is a call of the function."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fsinfer.batch.attempt import Attempt, PlotTask
from fsinfer.batch.copying import attempt_in, attempt_there
from fsinfer.cluster import pieces
from fsinfer.cluster.pieces import Part, Piece, bundles, write_pieces
from fsinfer.errors import InputError
from tests.support.batch_plots import STAND_IN, behave, write_table


def call_here(function: Callable[..., Any], *arguments: object) -> Any:
    return function(*arguments)


def send(folder: Path, name: str, call: Callable[..., Any] = call_here, **files: Path) -> Attempt:
    task = PlotTask(
        batch="b",
        photos=folder / "photos" / name,
        out=folder / "out" / name,
        command=STAND_IN,
        options=("--scale=2.0",),
    )
    scratch_in = folder / "scratch"
    scratch_in.mkdir(exist_ok=True)
    tried = attempt_there(call, task, [(f"--{key}", path) for key, path in files.items()], str(scratch_in))
    # Nothing is left on the worker.
    assert list(scratch_in.iterdir()) == []
    return tried


def test_the_results_come_back_as_if_the_plot_had_run_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "PIECE_BYTES", 1000)
    write_table(tmp_path, [{"name": "a"}])
    behave(tmp_path, "a", cloud=5000)
    photo = bytes(range(256)) * 20
    (tmp_path / "photos" / "a" / "two.jpg").write_bytes(photo)
    (tmp_path / "my edits.csv").write_text("action\n", encoding="utf-8")
    out = tmp_path / "out" / "a"
    (out / "figures").mkdir(parents=True)
    (out / "figures" / "tree_099.png").write_bytes(b"of an earlier run")
    (out / "trees.gpkg").write_bytes(b"of an earlier run")
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    (out / "scale_clicks.json").write_text("{}", encoding="utf-8")
    seen: list[str] = []

    def call(function: Callable[..., Any], *arguments: Any) -> Any:
        if function is attempt_in:
            root = Path(arguments[0])
            seen.extend(path.relative_to(root).as_posix() for path in sorted(root.rglob("*")) if path.is_file())
            assert (root / "photos" / "a" / "two.jpg").read_bytes() == photo
        return function(*arguments)

    tried = send(tmp_path, "a", call, edits=tmp_path / "my edits.csv")
    assert (tried.done, tried.message) == (True, "")
    assert seen == [
        "files/edits/my edits.csv", "out/a/scale_clicks.json", "photos/a/behave.json", "photos/a/one.jpg",
        "photos/a/two.jpg",
    ]  # fmt: skip
    assert (out / "cloud.ply").read_bytes() == b"a" * 5000
    assert (out / "figures" / "tree_001.png").read_bytes() == b""
    # Of an earlier run nothing is left that this one did not make; what the user put there stays.
    assert not (out / "figures" / "tree_099.png").exists()
    assert not (out / "trees.gpkg").exists()
    assert (out / "notes.txt").read_text(encoding="utf-8") == "mine"
    options = (out / "started.txt").read_text(encoding="utf-8")
    assert "--edits=" in options
    assert "my edits.csv" in options
    assert not (out / ".arriving").exists()


def test_of_a_plot_that_failed_what_it_said_comes_back(tmp_path: Path) -> None:
    write_table(tmp_path, [{"name": "a"}])
    behave(tmp_path, "a", exit=2, say="Error: too dark")
    out = tmp_path / "out" / "a"
    out.mkdir(parents=True)
    (out / "trees.csv").write_text("kept", encoding="utf-8")
    tried = send(tmp_path, "a")
    assert (tried.done, tried.message, tried.again) == (False, "too dark", False)
    assert (out / "run.log").read_text(encoding="utf-8") == "Error: too dark\n"
    assert (out / "trees.csv").read_text(encoding="utf-8") == "kept"


def test_a_video_travels_too_and_missing_photos_are_told(tmp_path: Path) -> None:
    write_table(tmp_path, [{"name": "a"}])
    (tmp_path / "walk.mp4").write_bytes(b"film")
    task = PlotTask(batch="b", photos=tmp_path / "walk.mp4", out=tmp_path / "out" / "a", command=STAND_IN)
    assert attempt_there(call_here, task, [], str(tmp_path)).done
    missing = PlotTask(batch="b", photos=tmp_path / "none", out=tmp_path / "out" / "b", command=STAND_IN)
    assert "none holds no photos" in attempt_there(call_here, missing, [], str(tmp_path)).message


@pytest.mark.parametrize("name", ["../trees.csv", "/etc/passwd", "a/../../b", "..\\b", "C:evil", ""])
def test_no_worker_writes_outside_of_the_plot(tmp_path: Path, name: str) -> None:
    write_table(tmp_path, [{"name": "a"}])

    def call(function: Callable[..., Any], *arguments: object) -> Any:
        if function is pieces.list_files:
            return [(name, 4)]
        if function is pieces.read_parts:
            return [Piece(name=name, start=0, data=b"evil")]
        return function(*arguments)

    before = sorted(path for path in tmp_path.rglob("*") if "scratch" not in path.parts)
    with pytest.raises(InputError, match="a worker has sent a wrong name"):
        send(tmp_path, "a", call)
    after = {path for path in tmp_path.rglob("*") if path.is_file()}
    assert after == {path for path in before if path.is_file()}
    with pytest.raises(InputError):
        write_pieces(str(tmp_path), [Piece(name=name, start=0, data=b"")])


def test_loads_hold_every_byte_once_and_few_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "PIECE_BYTES", 10)
    files = [("a", 25), ("empty", 0), ("b", 3), ("c", 10)]
    loads = list(bundles(files))
    assert all(sum(part.length for part in load) <= 10 for load in loads)
    parts = [part for load in loads for part in load]
    for name, size in files:
        own = [part for part in parts if part.name == name]
        assert sum(part.length for part in own) == size
        assert [part.start for part in own] == [sum(p.length for p in own[:i]) for i in range(len(own))]
    assert Part(name="empty", start=0, length=0) in parts

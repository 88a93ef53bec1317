"""Files to and from the disk of a worker that does not see them, in pieces.

Every function takes or gives a few megabytes at most, so that neither scheduler nor worker ever holds a whole plot.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from fsinfer.errors import InputError

#: Bytes that travel at a time. Source: numerics; Dask warns of calls beyond 10 MB.
PIECE_BYTES = 4_000_000


@dataclass(frozen=True, kw_only=True)
class Piece:
    """``data`` belongs at byte ``start`` of the file ``name``, a path with slashes below the folder."""

    name: str
    start: int
    data: bytes


@dataclass(frozen=True, kw_only=True)
class Part:
    """``length`` bytes from ``start`` on of the file ``name``."""

    name: str
    start: int
    length: int


def make_scratch(inside: str | None) -> str:
    """A new folder on the worker's own disk."""
    return tempfile.mkdtemp(prefix="fsinfer-", dir=inside)


def remove_scratch(*folders: str) -> None:
    """Delete such folders with all that they hold."""
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)


def write_pieces(folder: str, pieces: Sequence[Piece]) -> None:
    """Put pieces in their places."""
    for piece in pieces:
        path = below(Path(folder), piece.name)
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("r+b" if path.exists() else "wb") as stream:
            stream.seek(piece.start)
            stream.write(piece.data)


def read_parts(folder: str, parts: Sequence[Part]) -> list[Piece]:
    """The bytes of these parts."""
    pieces = []
    for part in parts:
        with below(Path(folder), part.name).open("rb") as stream:
            stream.seek(part.start)
            pieces.append(Piece(name=part.name, start=part.start, data=stream.read(part.length)))
    return pieces


def list_files(folder: str, names: Sequence[str] = ()) -> list[tuple[str, int]]:
    """Names and sizes of all files below ``folder``; of those named alone where any are."""
    root = Path(folder)
    found = [root / name for name in names] or sorted(root.rglob("*"))
    return [(path.relative_to(root).as_posix(), path.stat().st_size) for path in found if path.is_file()]


def below(folder: Path, name: str) -> Path:
    """A file below ``folder``; :class:`InputError` for a name that would lead out of it."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name or not path.parts:
        msg = f"{name!r} is no file of {folder}: a worker has sent a wrong name"
        raise InputError(msg)
    return folder / path


def bundles(files: Iterable[tuple[str, int]]) -> Iterator[list[Part]]:
    """Parts of files (name, size) in loads of ``PIECE_BYTES``; an empty file is a part of no bytes."""
    load: list[Part] = []
    room = PIECE_BYTES
    for name, size in files:
        start = 0
        while start < size or size == 0:
            length = min(size - start, room)
            load.append(Part(name=name, start=start, length=length))
            start, room = start + length, room - length
            # Many small files are a load as well.
            if room == 0 or len(load) == 200:
                yield load
                load, room = [], PIECE_BYTES
            if size == 0:
                break
    if load:
        yield load


def pieces_of(sent: Mapping[str, Path]) -> Iterator[list[Piece]]:
    """The content of files by the names that they are to have there, in loads of ``PIECE_BYTES``.

    Raises
    ------
    InputError
        A file cannot be read.
    """
    for load in bundles((name, path.stat().st_size) for name, path in sent.items()):
        yield [_piece(part, sent[part.name]) for part in load]


def _piece(part: Part, path: Path) -> Piece:
    try:
        with path.open("rb") as stream:
            stream.seek(part.start)
            data = stream.read(part.length)
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}"
        raise InputError(msg) from error
    return Piece(name=part.name, start=part.start, data=data)

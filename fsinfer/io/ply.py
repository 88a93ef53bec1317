"""The PLY format: the vertex table as NumPy columns, by structured arrays (no other reader needed)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.io.files import atomic_path

# Both spellings of the scalar types that are in use (Turk 1994; Open3D, CloudCompare and MeshLab write the second).
_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
_NAMES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float"}
_NAMES["f8"] = "double"
#: A header longer than this is none: a random binary file is not searched to its end. Source: numerics.
_MAX_HEADER_BYTES = 65536
#: Of a row that cannot be read so much is shown, characters. Source: layout.
_SHOWN_CHARACTERS = 60


@dataclass(frozen=True, kw_only=True)
class _Element:
    name: str
    count: int
    properties: tuple[tuple[str, str], ...]
    has_lists: bool


@dataclass(frozen=True, kw_only=True)
class PlyTable:
    """The vertex table of a binary PLY: row type, number of rows, and its first byte in the file."""

    dtype: np.dtype[np.void]
    count: int
    offset: int


def read_ply(path: Path) -> dict[str, NDArray[Any]]:
    """Read the vertex table of a PLY file (ascii, little or big endian); faces and other elements are ignored.

    Returns
    -------
    Property name -> (N,) array in the file's own type, native byte order.

    Raises
    ------
    CloudError
        The file is missing, is no PLY, has no vertices, or is cut short.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}; check the path"
        raise CloudError(msg) from error
    form, elements, start = _parse_header(path, data[:_MAX_HEADER_BYTES])
    element, before = _vertices(path, elements)
    if form == "ascii":
        return _read_ascii(path, data[start:], element, skip_rows=sum(e.count for e in before))
    place = _binary_table(path, form, element, before, start, len(data))
    table = np.frombuffer(data, dtype=place.dtype, count=place.count, offset=place.offset)
    return {name: table[name].astype(place.dtype[name].newbyteorder("=")) for name, _ in element.properties}


def find_table(path: Path) -> PlyTable | None:
    """Where the vertices of a binary PLY lie, so that they can be read in pieces; None for an ascii one.

    Raises as :func:`read_ply` does.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(_MAX_HEADER_BYTES)
        size = path.stat().st_size
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}; check the path"
        raise CloudError(msg) from error
    form, elements, start = _parse_header(path, head)
    element, before = _vertices(path, elements)
    return None if form == "ascii" else _binary_table(path, form, element, before, start, size)


def read_rows(path: Path, table: PlyTable, start: int, count: int) -> NDArray[np.void]:
    """``count`` vertices from number ``start`` on, in the file's own types."""
    offset = table.offset + start * table.dtype.itemsize
    # Not a memory map: pages of a mapped file count as memory of the process until the system takes them back.
    rows = np.fromfile(path, dtype=table.dtype, count=count, offset=offset)
    if len(rows) < count:
        raise _truncated(path, start + len(rows), table.count)
    return rows


def write_ply(path: Path, columns: dict[str, NDArray[Any]], *, comments: tuple[str, ...] = ()) -> None:
    """Write (N,) columns as a binary little-endian PLY, atomically. Column types must be PLY scalar types."""
    dtype = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    count = len(next(iter(columns.values())))
    table = np.empty(count, dtype=dtype)
    for name, column in columns.items():
        table[name] = column
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    header += [f"element vertex {count}"]
    header += [f"property {_NAMES[column.dtype.str[1:]]} {name}" for name, column in columns.items()]
    header += ["end_header", ""]
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write("\n".join(header).encode("ascii"))
        table.tofile(stream)


def _parse_header(path: Path, head: bytes) -> tuple[str, list[_Element], int]:
    """Return the format, the elements and the offset of the body."""
    damaged = f"{path} is not a PLY file, or its header is damaged; export the cloud again as PLY, LAS or LAZ"
    end = head.find(b"end_header")
    newline = head.find(b"\n", end)
    if not head.startswith(b"ply") or end < 0 or newline < 0:
        raise CloudError(damaged)
    form, elements = "", []
    try:
        for line in head[:end].decode("ascii", errors="replace").splitlines():
            words = line.split()
            if not words:
                continue
            if words[0] == "format":
                form = words[1]
            elif words[0] == "element":
                elements.append(_Element(name=words[1], count=int(words[2]), properties=(), has_lists=False))
            elif words[0] == "property":
                last = elements[-1]
                if words[1] == "list":
                    elements[-1] = _Element(
                        name=last.name, count=last.count, properties=last.properties, has_lists=True
                    )
                else:
                    properties = (*last.properties, (words[2], _TYPES[words[1]]))
                    elements[-1] = _Element(
                        name=last.name, count=last.count, properties=properties, has_lists=last.has_lists
                    )
    except (IndexError, ValueError, KeyError) as error:
        raise CloudError(damaged) from error
    if form not in ("ascii", "binary_little_endian", "binary_big_endian") or any(e.count < 0 for e in elements):
        raise CloudError(damaged)
    if any(len({name for name, _ in e.properties}) != len(e.properties) for e in elements):
        raise CloudError(damaged)
    return form, elements, newline + 1


def _vertices(path: Path, elements: list[_Element]) -> tuple[_Element, list[_Element]]:
    """The vertex element, and those that stand before it."""
    before: list[_Element] = []
    for element in elements:
        if element.name == "vertex":
            if element.has_lists:
                msg = f"{path}: its vertices hold a list property; export the cloud without it, or as LAZ"
                raise CloudError(msg)
            return element, before
        before.append(element)
    msg = f"{path} has no vertices; export the points (not only faces) as PLY again"
    raise CloudError(msg)


def _binary_table(path: Path, form: str, element: _Element, before: list[_Element], start: int, size: int) -> PlyTable:
    order = "<" if form == "binary_little_endian" else ">"
    for earlier in before:
        if earlier.has_lists:
            msg = f"{path}: element '{earlier.name}' stands before the vertices; export the points alone, or as LAZ"
            raise CloudError(msg)
        start += earlier.count * _row_dtype(earlier, order).itemsize
    dtype = _row_dtype(element, order)
    have = max(0, size - start) // max(1, dtype.itemsize)
    if have < element.count:
        raise _truncated(path, have, element.count)
    return PlyTable(dtype=dtype, count=element.count, offset=start)


def _row_dtype(element: _Element, order: str) -> np.dtype[np.void]:
    return np.dtype([(name, order + kind) for name, kind in element.properties])


def _read_ascii(path: Path, body: bytes, element: _Element, *, skip_rows: int) -> dict[str, NDArray[Any]]:
    lines = body.decode("ascii", errors="replace").splitlines()[skip_rows : skip_rows + element.count]
    if len(lines) < element.count:
        raise _truncated(path, len(lines), element.count)
    if not lines:
        return {name: np.empty(0, dtype=kind) for name, kind in element.properties}
    try:
        values = np.loadtxt(lines, dtype=np.float64, ndmin=2, comments=None)
    except ValueError as error:
        with_comma = next((line.strip() for line in lines if "," in line), "")
        if with_comma:
            msg = (
                f"{path} has commas in its numbers, as in {with_comma[:_SHOWN_CHARACTERS]!r}; export the cloud with "
                "decimal points, or as binary PLY, LAS or LAZ"
            )
            raise CloudError(msg) from error
        msg = f"{path} is cut short or damaged ({error}); export or copy it again"
        raise CloudError(msg) from error
    if values.shape != (element.count, len(element.properties)):
        raise _truncated(path, len(values), element.count)
    return {name: values[:, i].astype(kind) for i, (name, kind) in enumerate(element.properties)}


def _truncated(path: Path, have: int, count: int) -> CloudError:
    return CloudError(f"{path} is cut short: {have} of {count} points are there; export or copy it again")

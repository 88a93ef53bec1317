"""What the header of a LAS or LAZ file promises, held against the size of the file before anybody believes it.

A damaged or hostile header can promise more records or points than any memory holds; whoever reads by it runs for
hours or asks for all the memory there is.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from fsinfer.io.laz_pieces import why_laz_damaged

#: Bytes of the longest header (LAS 1.4), and of a record before its content, ordinary and extended. Source: format.
_HEADER_BYTES, _RECORD_BYTES, _LONG_RECORD_BYTES = 375, 54, 60
#: Bit of the point format that says that the points are compressed. Source: format; LASzip.
_COMPRESSED = 0x80
#: More points in a byte than this are a damaged header. Source: judgement; LAZ takes about one byte a point.
_MOST_POINTS_PER_BYTE = 1000


@dataclass(frozen=True, kw_only=True)
class _Header:
    header_bytes: int
    points_at: int
    records: int
    compressed: bool
    point_bytes: int
    points: int
    long_records_at: int
    long_records: int


def why_damaged(path: Path) -> str:
    """Why the header cannot be that of this file, in words; empty where nothing speaks against it.

    Only what must hold is asked for: a program that reads the file says the rest. Raises OSError.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = _parse(stream.read(_HEADER_BYTES))
        if head is None:
            return "it has no LAS header"
        if head.points_at > size or head.header_bytes + _RECORD_BYTES * head.records > head.points_at:
            return "its header promises more records than the file can hold"
        if not _hold_long_records(stream, head, size):
            return "its header promises more records than the file can hold"
        if not head.compressed:
            have = (size - head.points_at) // max(head.point_bytes, 1)
            return "" if have >= head.points else f"{have} of {head.points} points are there"
        if head.points > _MOST_POINTS_PER_BYTE * size:
            return "its header promises more points than the file can hold"
        return (
            why_laz_damaged(
                stream,
                points_at=head.points_at,
                point_bytes=head.point_bytes,
                size=size,
                records=_records(stream, head),
            )
            if head.points
            else ""
        )


def _hold_long_records(stream: BinaryIO, head: _Header, size: int) -> bool:
    """Whether the records behind the points end within the file; each says its own length."""
    at = head.long_records_at
    for _ in range(head.long_records):
        stream.seek(at + 20)
        length = stream.read(8)
        if len(length) < 8:
            return False
        at += _LONG_RECORD_BYTES + int.from_bytes(length, "little")
        if at > size:
            return False
    return True


def _records(stream: BinaryIO, head: _Header) -> list[tuple[bytes, int, bytes]]:
    """User, number and content of the records before the points."""
    stream.seek(head.header_bytes)
    rest = stream.read(head.points_at - head.header_bytes)
    records, at = [], 0
    for _ in range(head.records):
        if at + _RECORD_BYTES > len(rest):
            break
        user, number, length = struct.unpack_from("<2x16sHH", rest, at)
        records.append((user.rstrip(b"\0"), number, rest[at + _RECORD_BYTES : at + _RECORD_BYTES + length]))
        at += _RECORD_BYTES + length
    return records


def _parse(head: bytes) -> _Header | None:
    if len(head) < 227 or not head.startswith(b"LASF"):
        return None
    header_bytes, points_at, records, form, point_bytes, points = struct.unpack_from("<HIIBHI", head, 94)
    long_records_at = long_records = 0
    if head[25] >= 4:
        if len(head) < 255:
            return None
        long_records_at, long_records, points = struct.unpack_from("<QIQ", head, 235)
    return _Header(
        header_bytes=header_bytes,
        points_at=points_at,
        records=records,
        compressed=bool(form & _COMPRESSED),
        point_bytes=point_bytes,
        points=points,
        long_records_at=long_records_at,
        long_records=long_records,
    )

"""The compressed pieces of a LAZ file: what their lengths promise, before the decompressor believes it.

It takes the lengths from four places (record, table, pieces, layers of a piece) and asks for so much memory; where it
gets none the whole process ends, without an error that could be caught.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from itertools import pairwise
from typing import BinaryIO

#: Record that describes the compression, and the numbers in it: kind, points of a piece, count of the items. Source:
#: format; LASzip 3.4.
_USER, _NUMBER, _RECORD = b"laszip encoded", 22204, struct.Struct("<H2xBB2xIIqqH")
_ITEM = struct.Struct("<HHH")
#: Kind of compression whose pieces have layers, and points of a piece where each has its own number. Source: format.
_LAYERED, _VARIABLE = 3, 0xFFFFFFFF
#: Layers of the items of a point: point, colours, colours and infrared, wave packet; those of extra bytes have one a
#: byte. Source: format.
_LAYERS, _EXTRA_BYTES = {10: 9, 11: 1, 12: 2, 13: 1}, 14
#: More points than any program puts into a piece; 50,000 are usual. Source: judgement.
_MOST_IN_A_PIECE = 10_000_000


def why_laz_damaged(
    stream: BinaryIO, *, points_at: int, point_bytes: int, size: int, records: Sequence[tuple[bytes, int, bytes]]
) -> str:
    """Why the pieces cannot be those of this file, in words; empty where nothing speaks against it.

    ``points_at`` is where they begin, ``point_bytes`` the length of a point, ``records`` user, number and content of
    those before. Raises what lazrs raises for a table that cannot be unpacked.
    """
    import lazrs

    record = next((content for user, number, content in records if (user, number) == (_USER, _NUMBER)), b"")
    if len(record) < _RECORD.size:
        return "the description of its compression is missing"
    kind, _, _, _, in_a_piece, _, _, items = _RECORD.unpack_from(record)
    if len(record) < _RECORD.size + items * _ITEM.size:
        return "the description of its compression is cut short"
    described = [_ITEM.unpack_from(record, _RECORD.size + i * _ITEM.size) for i in range(items)]
    if sum(length for _, length, _ in described) != point_bytes:
        return "its compression is that of other points"
    if in_a_piece == 0 or (in_a_piece != _VARIABLE and in_a_piece > _MOST_IN_A_PIECE):
        return f"it says that {in_a_piece} points are compressed together"
    if kind == 1:
        return ""  # all points in one piece, without a table
    why = _why_no_table(stream, points_at, size)
    if why:
        return why
    stream.seek(points_at)
    lengths = [length for _, length in lazrs.read_chunk_table(stream, lazrs.LazVlr(record))]
    if sum(lengths) > size - points_at:
        return "its compressed points promise more than the file can hold"
    if kind != _LAYERED:
        return ""
    layers = sum(length if item == _EXTRA_BYTES else _LAYERS.get(item, 0) for item, length, _ in described)
    starts = [points_at + 8]
    for length in lengths:
        starts.append(starts[-1] + length)
    fixed = point_bytes + 4 + 4 * layers
    for start, end in pairwise(starts):
        stream.seek(start + point_bytes + 4)
        told = stream.read(4 * layers)
        if len(told) < 4 * layers or fixed + sum(struct.unpack(f"<{layers}I", told)) > end - start:
            return "a piece of its compressed points promises more than it holds"
    return ""


def _why_no_table(stream: BinaryIO, points_at: int, size: int) -> str:
    """The place of the table stands before the points, the count of the pieces at its beginning."""
    stream.seek(points_at)
    place = stream.read(8)
    if len(place) < 8:
        return "its points are missing"
    (at,) = struct.unpack("<q", place)
    if at == -1:  # written by a program that could not go back; then the place is at the end of the file
        stream.seek(size - 8)
        (at,) = struct.unpack("<q", stream.read(8))
    if not points_at + 8 <= at <= size - 8:
        return "the table of its compressed points is missing"
    stream.seek(at)
    _, pieces = struct.unpack("<II", stream.read(8))
    # Each piece takes a byte at the least.
    return "" if pieces <= size else "its compressed points promise more than the file can hold"

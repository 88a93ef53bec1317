"""Headers that lie: binary formats changed at the fields that say how much follows, with their checks put right."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from random import Random

from tests.fuzz.mutators import change_bytes
from tests.fuzz.reader import Mutator

_SIZES = (0, 1, 2, 3, 255, 65535, 2**20, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
_COUNTS = (*_SIZES, 2**40, 2**62, 2**63, 2**64 - 1)
#: Offset and width of the fields of a LAS 1.4 header that say what follows: global encoding, header size, offset to
#: points, records, format, record length, legacy counts, then (1.4) the extended records and the count of points.
_LAS_FIELDS = (
    (6, 2), (24, 1), (25, 1), (94, 2), (96, 4), (100, 4), (104, 1), (105, 2), (107, 4), (111, 4), (235, 8), (243, 4),
    (247, 8), (255, 8),
)  # fmt: skip


def lie_in_las(data: bytes, rng: Random) -> bytes:
    """One or two fields of the header, or steps and corners of the coordinates, hold something else."""
    content = bytearray(data)
    for _ in range(rng.randint(1, 2)):
        if rng.random() < 0.8:
            offset, width = rng.choice(_LAS_FIELDS)
            value = rng.choice(_COUNTS) % (1 << (8 * width))
            content[offset : offset + width] = value.to_bytes(width, "little")
        else:
            offset = rng.choice(range(131, 227, 8))
            value_f = rng.choice((0.0, -1.0, 1e300, 1e-300, float("nan"), float("inf")))
            content[offset : offset + 8] = struct.pack("<d", value_f)
    return bytes(content)


def lie_in_records(data: bytes, rng: Random) -> bytes:
    """The variable length records of LAS and LAZ (frame, extra dimensions, chunk sizes) and the chunk table."""
    if len(data) < 375:
        return change_bytes(data, rng)
    points = min(int.from_bytes(data[96:100], "little"), len(data) - 1)
    start = min(int.from_bytes(data[94:96], "little"), points)
    content = bytearray(data)
    for _ in range(rng.randint(1, 3)):
        near_points = rng.random() < 0.4
        # The first eight bytes of the points of LAZ say where its chunk table is; the table is the end of the file.
        low, high = (points, points + 12) if near_points and rng.random() < 0.5 else (start, points)
        if near_points and low == start:
            low, high = len(content) - 24, len(content)
        at = rng.randrange(max(low, 0), max(high, low + 1, 1))
        width = rng.choice((1, 2, 4, 8))
        content[at : at + width] = (rng.choice(_COUNTS) % (1 << (8 * width))).to_bytes(width, "little")
    return bytes(content)


def lie_in_png(data: bytes, rng: Random) -> bytes:
    """A PNG of another size or kind than its content, each chunk with a good checksum; sometimes a chunk more."""
    pieces, at = [data[:8]], 8
    while at + 8 <= len(data):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        body = data[at + 8 : at + 8 + length]
        if kind == b"IHDR" and len(body) == 13:
            fields = list(struct.unpack(">IIBBBBB", body))
            for _ in range(rng.randint(1, 2)):
                which = rng.randrange(7)
                fields[which] = rng.choice(_SIZES) if which < 2 else rng.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
            body = struct.pack(">IIBBBBB", *(f % (2**32) if i < 2 else f % 256 for i, f in enumerate(fields)))
        pieces.append(_chunk(kind, body))
        if kind == b"IHDR" and rng.random() < 0.3:
            bomb = zlib.compress(bytes(rng.choice((10, 10**5, 10**7))), 9)
            pieces.append(_chunk(rng.choice((b"iCCP", b"zTXt")), b"a\x00\x00" + bomb))
        at += 12 + length
    return b"".join(pieces)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def lie_in_counts(data: bytes, rng: Random) -> bytes:
    """The counts that COLMAP writes before its tables: of all entries, and somewhere inside."""
    content = bytearray(data)
    at = 0 if rng.random() < 0.5 else rng.randrange(max(len(content) - 8, 1))
    content[at : at + 8] = rng.choice(_COUNTS).to_bytes(8, "little", signed=False)
    return bytes(content)


def in_member(pattern: str, change: Mutator) -> Mutator:
    """Changes one file inside a zip (its checksum is right again) whose name ends so."""

    def mutate(data: bytes, rng: Random) -> bytes:
        target = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(target, "w") as new:
            names = [name for name in old.namelist() if name.endswith(pattern)]
            chosen = rng.choice(names) if names else ""
            for name in old.namelist():
                content = old.read(name)
                new.writestr(name, change(content, rng) if name == chosen else content)
        return target.getvalue()

    return mutate

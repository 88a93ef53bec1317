"""JPEG files with a hole: sectors of a card that could not be read, or a copy that was stopped, left zeros in them.

Zeros are codes, too: decoders go on, and what follows is a picture of nothing, without an error. In the coded pixels of
sound photographs runs of zeros have a few bytes.
"""

from __future__ import annotations

import re

#: Cards, disks and copies lose whole sectors, bytes. Source: format; the least size of a sector.
_SECTOR = 512
#: Sound bytes beside a hole may be zero by chance, so many. Source: numerics; of each the chance is 1 in 256.
_BY_CHANCE = 8
_ZEROS = re.compile(rb"\0+")
#: Markers of a JPEG file. Source: format.
_START, _START_OF_SCAN, _END = b"\xff\xd8", 0xDA, b"\xff\xd9"


def has_hole(data: bytes) -> bool:
    """Whether whole sectors of the coded pixels of a JPEG file are zero.

    What stands before (metadata) and behind them (a film, a second picture) may hold zeros of its own. Nor do other
    runs of zeros tell: with a code table of its own a part of a picture that is all alike may become one.
    """
    begin = _coded_from(data)
    if begin is None:
        return False
    end = data.find(_END, begin)
    end = len(data) if end < 0 else end
    at = begin
    # Where no more are found it looks at the very first byte, which is none.
    while found := _ZEROS.match(data, max(0, data.find(bytes(_SECTOR), at, end)), end):
        at = found.end()
        ends_with_sector = at % _SECTOR <= _BY_CHANCE or at == len(data)
        if -found.start() % _SECTOR <= _BY_CHANCE and ends_with_sector:
            return True
    return False


def _coded_from(data: bytes) -> int | None:
    """Where the first segment of coded pixels begins; None where the segments before it do not lead there."""
    at = len(_START)
    while data.startswith(_START) and data[at : at + 1] == b"\xff" and at + 4 <= len(data):
        marker = data[at + 1]
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if marker == _START_OF_SCAN:
            return at
    return None

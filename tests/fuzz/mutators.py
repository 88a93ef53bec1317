"""Changes to files: of bytes, of words and numbers in a text, of values in JSON."""

from __future__ import annotations

import json
import re
import struct
from random import Random
from typing import Any

from tests.fuzz.reader import Mutator

#: Whole numbers at which readers break: ends of the types, signs, sizes that no memory holds.
_EDGES = (0, 1, -1, 2, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62,
          2**63 - 1, -(2**31), -(2**63))  # fmt: skip
#: Numbers as they stand in texts.
_NUMBERS = (
    "0", "-0", "-1", "1", "nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e400", "2147483648", "4294967296",
    "1" * 30, "9" * 400, "9" * 5000, "1_000", "0x10", "1,5", "", "+", "0.5", "1e6", "100000", "123456789012", "\u0661",
)  # fmt: skip
#: Texts that mean something to somebody: paths, formulas, markup, ends of strings.
_WORDS = (
    "../../../escaped", "/dev/null", "/etc/hostname", "C:\\nul", "..", ".", "", "\x00", "=1+1", "@SUM(A1)", "<script>",
    "</script>", "%s%n", "{{7*7}}", "\ud800", "\ufeff", "\u202e", "a" * 5000, "\n", "\r", '"', "'", ";", ",",
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][\w.]*")
#: A change of content is small, or nothing but the first check of a reader is ever tried.
_MOST_CHANGES = 4


def change_bytes(data: bytes, rng: Random) -> bytes:
    """Flip, set, cut, repeat, and write numbers at which readers break; most of it in the head of the file."""
    content = bytearray(data)
    for _ in range(rng.randint(1, _MOST_CHANGES)):
        _change_once(content, rng)
    return bytes(content)


def _change_once(content: bytearray, rng: Random) -> None:
    size = len(content)
    if not size:
        content.extend(rng.randbytes(rng.randint(1, 64)))
        return
    # Headers decide most: half of all changes fall into the first 512 bytes.
    at = rng.randrange(min(size, 512) if rng.random() < 0.5 else size)
    kind = rng.randrange(8)
    if kind == 0:
        content[at] ^= 1 << rng.randrange(8)
    elif kind == 1:
        content[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    elif kind in (2, 3):
        width = rng.choice((2, 4, 4, 8))
        value = rng.choice(_EDGES) % (1 << (8 * width))
        content[at : at + width] = value.to_bytes(width, rng.choice(("little", "big")))
    elif kind == 4:
        content[at : at + 8] = struct.pack("<d", rng.choice((float("nan"), float("inf"), -1.0, 1e308, 1e-320, 0.0)))
    elif kind == 5:
        del content[at : at + rng.choice((1, 2, 4, 16, size))]
    elif kind == 6:
        content[at:at] = rng.randbytes(rng.choice((1, 2, 4, 16, 64)))
    else:
        length = rng.randint(1, min(256, size))
        other = rng.randrange(size)
        content[at : at + length] = content[other : other + length]


def cut(data: bytes, rng: Random) -> bytes:
    """The file as an interrupted copy leaves it: its beginning, or its beginning and zeros."""
    keep = rng.randrange(len(data)) if data else 0
    return data[:keep] + (bytes(len(data) - keep) if rng.random() < 0.3 else b"")


def change_text(data: bytes, rng: Random) -> bytes:
    """Numbers, words and lines that do not belong there."""
    for _ in range(rng.randint(1, _MOST_CHANGES)):
        kind = rng.randrange(6)
        if kind in (0, 1):
            data = _replace(data, _NUMBER, rng.choice(_NUMBERS), rng)
        elif kind == 2:
            data = _replace(data, _WORD, rng.choice(_WORDS), rng)
        elif kind == 3:
            data = _replace(data, rng.choice((_WORD, _NUMBER)), rng.choice((*_NUMBERS, *_WORDS)), rng)
        else:
            data = _change_lines(data, rng)
    return data


def _replace(data: bytes, pattern: re.Pattern[bytes], text: str, rng: Random) -> bytes:
    found = list(pattern.finditer(data))
    if not found:
        return data
    match = rng.choice(found)
    return data[: match.start()] + text.encode("utf-8", errors="surrogatepass") + data[match.end() :]


def _change_lines(data: bytes, rng: Random) -> bytes:
    lines = data.split(b"\n")
    one, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(4)
    if kind == 0:
        del lines[one]
    elif kind == 1:
        lines[one], lines[other] = lines[other], lines[one]
    elif kind == 2:
        lines[one:one] = [lines[other]] * rng.choice((1, 3, 1000))
    else:
        lines[one] = rng.choice(_WORDS).encode("utf-8", errors="surrogatepass") + lines[one]
    return b"\n".join(lines)


def change_head(end: bytes) -> Mutator:
    """Changes words and numbers up to the first ``end`` only; what follows stays as it is."""

    def change(data: bytes, rng: Random) -> bytes:
        stop = data.find(end)
        return data if stop < 0 else change_text(data[:stop], rng) + data[stop:]

    return change


def change_json(data: bytes, rng: Random) -> bytes:
    """Another value, another type or nothing at some place of a JSON file."""
    value = json.loads(data)
    for _ in range(rng.randint(1, 2)):
        value = _change_value(value, rng, depth=0)
    text = json.dumps(value)
    if rng.random() < 0.03:
        # Nested deeper than a reader that calls itself can go.
        text = text.replace("null", "[" * 100_000 + "]" * 100_000) if "null" in text else "[" * 100_000
    if rng.random() < 0.05:
        text = _replace(text.encode(), _NUMBER, rng.choice(_NUMBERS), rng).decode("utf-8", errors="replace")
    return text.encode()


def _change_value(value: Any, rng: Random, depth: int) -> Any:
    inside = isinstance(value, (dict, list)) and len(value) > 0
    if inside and rng.random() < (0.97 if depth < 1 else 0.75):
        if isinstance(value, dict):
            key = rng.choice(list(value))
            if rng.random() < 0.12:
                return {k: v for k, v in value.items() if k != key}
            if rng.random() < 0.05:
                return {(rng.choice(_WORDS) if k == key else k): v for k, v in value.items()}
            return {**value, key: _change_value(value[key], rng, depth + 1)}
        at = rng.randrange(len(value))
        if rng.random() < 0.1:
            return value[:at] + value[at + 1 :]
        return [*value[:at], _change_value(value[at], rng, depth + 1), *value[at + 1 :]]
    return rng.choice(
        (None, True, False, 0, -1, 1, 0.5, 1e308, -1e308, float("nan"), float("inf"), 10**400, 2**63, 1e-320, [], {},
         [None], [[]], {"a": None}, [1, 2, 3], "1", [1e308, -1e308], rng.choice(_WORDS), rng.choice(_NUMBERS))
    )  # fmt: skip

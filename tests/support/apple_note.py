"""Photographs with the note that Apple's phones make of their accelerometer."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image


def apple_note(felt_g: Sequence[float], *, order: str = ">") -> bytes:
    """A maker's note with a running number and the acceleration (3,), laid out as in a photograph of a phone."""
    values = [number for value in felt_g for number in (round(value * 1_000_003), 1_000_003)]
    head = b"Apple iOS\0\0\1" + (b"MM" if order == ">" else b"II")
    entries = [struct.pack(f"{order}HHIi", 1, 9, 1, 13)]
    at = len(head) + 2 + 12 * 2 + 4
    entries.append(struct.pack(f"{order}HHII", 8, 10, 3, at))
    return head + struct.pack(f"{order}H", 2) + b"".join(entries) + bytes(4) + struct.pack(f"{order}6i", *values)


def phone_exif(felt_g: Sequence[float] | None, orientation: int, *, maker: str | None = "Apple") -> Image.Exif:
    """Metadata of a photograph that was taken so; without a note where the phone felt nothing."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    if maker is not None:
        exif[0x010F] = maker
    if felt_g is not None:
        exif.get_ifd(0x8769)[0x927C] = apple_note(felt_g)
    return exif


def phone_photo(path: Path, felt_g: Sequence[float] | None, orientation: int = 6) -> Path:
    """A small photograph of nothing."""
    picture = Image.fromarray(np.full((24, 32, 3), 90, np.uint8))
    picture.save(path, exif=phone_exif(felt_g, orientation).tobytes())
    return path

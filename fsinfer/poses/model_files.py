"""The files of a COLMAP model: what their counts promise, held against their sizes before COLMAP believes it.

COLMAP asks for memory by these counts, and reads on behind the end of a file as often as they say. On a full disk it
writes files that end too early, and says nothing.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from fsinfer.errors import OutputError
from fsinfer.io.files import make_folder
from fsinfer.poses.colmap_calls import ColmapError, call

#: Bytes of an image before its name, and of each of its points (COLMAP 3 and 4, binary). Source: format.
_IMAGE, _POINT2D = 4 + 7 * 8 + 4, 2 * 8 + 8
#: Bytes of a point before its track, and of an element of it. Source: format.
_POINT3D, _TRACK_ELEMENT = 8 + 3 * 8 + 3 + 8, 2 * 4
#: Bytes of a frame before its data, and of each of them. Source: format.
_FRAME, _FRAME_DATA = 4 + 4 + 7 * 8, 4 + 4 + 8
#: Bytes of a rig before its sensors, of a sensor, of the first one, which has no pose, and of a pose. Source: format.
_RIG, _SENSOR, _LEAST_SENSOR, _POSE = 4, 4 + 4 + 1, 4 + 4, 7 * 8
#: Bytes of a camera without its parameters. Source: format.
_LEAST_CAMERA = 4 + 4 + 8 + 8


def why_damaged(folder: Path) -> str:
    """Why the binary files in ``folder`` are no model, in words; empty where nothing speaks against them.

    Raises OSError where one cannot be read.
    """
    walks = {
        "cameras.bin": _cameras, "images.bin": _images, "points3D.bin": _points, "frames.bin": _frames,
        "rigs.bin": _rigs,
    }  # fmt: skip
    for name, walk in walks.items():
        path = folder / name
        if path.is_file():
            try:
                walk(_Reader(path.read_bytes()))
            except (struct.error, ValueError):
                return f"{name} is cut short, or promises more than it holds"
    return ""


def write_model(model: Any, folder: Path) -> None:
    """Write a ``pycolmap.Reconstruction`` as binary files into ``folder``, which is made if missing.

    Raises
    ------
    OutputError
        COLMAP cannot write there, or what it wrote is not whole.
    """
    try:
        call(model.write_binary, make_folder(folder))
        why = why_damaged(folder)
    except ColmapError as error:
        why = str(error)
    if why:
        msg = f"cannot write the COLMAP model to {folder} ({why}); free some space or choose another output folder"
        raise OutputError(msg)


class _Reader:
    """Goes through the bytes of a file; ValueError or struct.error where they end too early."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def skip(self, length: int) -> None:
        """Go on by so many bytes."""
        self.at += length
        if self.at > len(self.data):
            raise ValueError

    def text(self) -> None:
        """Go behind the zero that ends a text."""
        self.at = self.data.index(b"\0", self.at) + 1

    def count(self, least: int, form: str = "<Q") -> int:
        """A count of things that take at least so many bytes each."""
        (number,) = struct.unpack_from(form, self.data, self.at)
        self.skip(struct.calcsize(form))
        if number * least > len(self.data) - self.at:
            raise ValueError
        return int(number)


def _cameras(reader: _Reader) -> None:
    reader.count(_LEAST_CAMERA)


def _images(reader: _Reader) -> None:
    for _ in range(reader.count(_IMAGE)):
        reader.skip(_IMAGE)
        reader.text()
        reader.skip(_POINT2D * reader.count(_POINT2D))


def _points(reader: _Reader) -> None:
    for _ in range(reader.count(_POINT3D)):
        reader.skip(_POINT3D)
        reader.skip(_TRACK_ELEMENT * reader.count(_TRACK_ELEMENT))


def _frames(reader: _Reader) -> None:
    for _ in range(reader.count(_FRAME)):
        reader.skip(_FRAME)
        reader.skip(_FRAME_DATA * reader.count(_FRAME_DATA, "<I"))


def _rigs(reader: _Reader) -> None:
    for _ in range(reader.count(_RIG)):
        reader.skip(_RIG)
        sensors = reader.count(_LEAST_SENSOR, "<I")
        reader.skip(_LEAST_SENSOR if sensors else 0)
        for _ in range(sensors - 1):
            reader.skip(_SENSOR)
            reader.skip(_POSE if reader.data[reader.at - 1] else 0)

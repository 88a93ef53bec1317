"""Portable float maps (PFM), the field's format for depth and confidence maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.io.files import atomic_path

#: A line of the header at most. Source: format; two numbers.
_LINE_BYTES = 256


def read_pfm(path: Path | str) -> NDArray[np.float32]:
    """Read a one-channel PFM.

    Returns
    -------
    (H, W) float32, first row at the top (PFM itself stores the last row first).

    Raises
    ------
    SceneError
        The file is missing, is no one-channel PFM, or is cut short.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}"
        raise SceneError(msg) from error
    *header, body = data.split(b"\n", 3)
    width, height, dtype = _header(path, header, body_bytes=len(body))
    values = np.frombuffer(body, dtype=dtype, count=width * height).reshape(height, width)
    return np.ascontiguousarray(values[::-1]).astype(np.float32)


def read_pfm_size(path: Path | str) -> tuple[int, int]:
    """(H, W) of a one-channel PFM, from its header and its length alone; :class:`SceneError` as :func:`read_pfm`."""
    path = Path(path)
    try:
        with path.open("rb") as stream:
            header = [stream.readline(_LINE_BYTES).rstrip(b"\n") for _ in range(3)]
            return _header(path, header, body_bytes=path.stat().st_size - stream.tell())[1::-1]
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}"
        raise SceneError(msg) from error


def _header(path: Path, lines: Sequence[bytes], *, body_bytes: int) -> tuple[int, int, str]:
    """Width, height and type of the values, from the three lines: magic, "width height", scale."""
    try:
        magic, size, scale = lines
        width, height = (int(token) for token in size.split())
        dtype = "<f4" if float(scale) < 0 else ">f4"  # negative means little endian
    except ValueError as error:
        msg = f"{path} is not a PFM file; write it again or delete it"
        raise SceneError(msg) from error
    if magic.strip() != b"Pf" or min(width, height) < 1 or body_bytes < 4 * width * height:
        msg = f"{path} is not a complete one-channel PFM ({width}x{height}); delete it and run the stage again"
        raise SceneError(msg)
    return width, height, dtype


def write_pfm(path: Path | str, values: NDArray[np.float32]) -> None:
    """Write an (H, W) array as a little-endian one-channel PFM, atomically."""
    height, width = values.shape
    body = np.ascontiguousarray(values[::-1], dtype="<f4").tobytes()
    with atomic_path(Path(path)) as temporary:
        temporary.write_bytes(f"Pf\n{width} {height}\n-1.0\n".encode() + body)

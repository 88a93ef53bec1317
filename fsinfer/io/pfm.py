"""Portable float maps (PFM), the field's format for depth and confidence maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.io.files import atomic_path


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
    # Three header lines: magic, "width height", scale (negative = little endian).
    parts = data.split(b"\n", 3)
    try:
        magic, size, scale, body = parts
        width, height = (int(token) for token in size.split())
        dtype = "<f4" if float(scale) < 0 else ">f4"
    except ValueError as error:
        msg = f"{path} is not a PFM file; write it again or delete it"
        raise SceneError(msg) from error
    if magic.strip() != b"Pf" or min(width, height) < 1 or len(body) < 4 * width * height:
        msg = f"{path} is not a complete one-channel PFM ({width}x{height}); delete it and run the stage again"
        raise SceneError(msg)
    values = np.frombuffer(body, dtype=dtype, count=width * height).reshape(height, width)
    return np.ascontiguousarray(values[::-1]).astype(np.float32)


def write_pfm(path: Path | str, values: NDArray[np.float32]) -> None:
    """Write an (H, W) array as a little-endian one-channel PFM, atomically."""
    height, width = values.shape
    body = np.ascontiguousarray(values[::-1], dtype="<f4").tobytes()
    with atomic_path(Path(path)) as temporary:
        temporary.write_bytes(f"Pf\n{width} {height}\n-1.0\n".encode() + body)

"""Clouds too large for memory: read in chunks of points, from LAS, LAZ and binary PLY."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.io.las import LAS_SUFFIXES, count_las, flagged, iterate_las, sample_las
from fsinfer.io.ply import PlyTable, find_table, read_rows

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ChunkSettings:
    """How :class:`ChunkedCloud` reads.

    Attributes
    ----------
    chunk_points: points that are read at once. Source: numerics; 24 MB of coordinates, and a few times that while
        laspy unpacks them.
    sample_slices: pieces of the file that a sample is made of: a scan is stored along its path, so that few pieces see
        all of it. Source: judgement.
    slice_points: points of each piece. Source: judgement.
    """

    chunk_points: int = 1_000_000
    sample_slices: int = 256
    slice_points: int = 2000


@dataclass(frozen=True, kw_only=True)
class ChunkedCloud:
    """A cloud file that is read piece by piece; coordinates come as float64 times ``factor``.

    ``factor`` are metres per unit of the file. ``table`` describes the body of a PLY, None for LAS and LAZ.
    """

    path: Path
    points: int
    factor: float
    table: PlyTable | None
    settings: ChunkSettings

    def chunks(self, on_flagged: Callable[[int], None] | None = None) -> Iterator[Floats]:
        """All points in their order as (N, 3) arrays, without those that are not finite or :func:`flagged`.

        ``on_flagged`` is told how many of the latter each piece had. Raises
        :class:`~fsinfer.errors.CloudError` where the file is cut short or damaged.
        """
        size = self.settings.chunk_points
        if self.table is None:
            for record in iterate_las(self.path, size):
                used = ~flagged(record)
                if on_flagged is not None:
                    on_flagged(len(used) - int(used.sum()))
                yield self._finite(np.column_stack([record.x, record.y, record.z])[used])
            return
        for start in range(0, self.points, size):
            yield self._finite(self._rows(start, min(size, self.points - start)))

    def columns(self) -> Iterator[dict[str, NDArray[Any]]]:
        """The rows of a PLY with all their properties, native byte order, coordinates as they are in the file."""
        if self.table is None:
            return
        size = self.settings.chunk_points
        for start in range(0, self.points, size):
            rows = read_rows(self.path, self.table, start, min(size, self.points - start))
            yield {name: rows[name].astype(rows.dtype[name].newbyteorder("=")) for name in rows.dtype.names or ()}

    def sample(self) -> Floats:
        """Points (N, 3) from pieces spread evenly over the file: what it spans, without reading it."""
        s = self.settings
        starts = np.unique(np.linspace(0, max(self.points - s.slice_points, 0), s.sample_slices).astype(np.int64))
        count = min(s.slice_points, self.points)
        if self.table is None:
            return self._finite(sample_las(self.path, starts.tolist(), count))
        return self._finite(np.concatenate([self._rows(int(start), count) for start in starts]))

    def _rows(self, start: int, count: int) -> Floats:
        if self.table is None:
            msg = f"{self.path} is no PLY file; read it by its chunks"
            raise CloudError(msg)
        rows = read_rows(self.path, self.table, start, count)
        return np.column_stack([rows[axis].astype(np.float64) for axis in "xyz"])

    def _finite(self, xyz: Floats) -> Floats:
        good = np.isfinite(xyz).all(axis=1)
        return np.asarray((xyz if good.all() else xyz[good]) * self.factor)


def open_chunks(path: Path | str, *, factor: float = 1.0, settings: ChunkSettings | None = None) -> ChunkedCloud | None:
    """Open a cloud for reading in chunks; None for kinds that are only read whole (text, ascii PLY).

    Raises
    ------
    CloudError
        The file is missing, is no cloud, or is cut short as far as its header tells.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    settings = settings or ChunkSettings()
    if suffix not in (".ply", *LAS_SUFFIXES):
        return None
    if not path.is_file():
        msg = f"there is no file {path}; check the path"
        raise CloudError(msg)
    if suffix != ".ply":
        return ChunkedCloud(path=path, points=count_las(path), factor=factor, table=None, settings=settings)
    table = find_table(path)
    if table is None or not {"x", "y", "z"} <= set(table.dtype.names or ()):
        return None
    return ChunkedCloud(path=path, points=table.count, factor=factor, table=table, settings=settings)

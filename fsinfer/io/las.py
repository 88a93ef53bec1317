"""Reading LAS and LAZ by laspy with lazrs; writing them is :mod:`fsinfer.io.las_writing`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import CloudError, FsinferError
from fsinfer.io.crs import horizontal_epsg
from fsinfer.io.las_header import why_damaged
from fsinfer.io.linear_units import (
    GEOGRAPHIC_KEY,
    PROJECTED_KEY,
    LinearUnits,
    keys_in_degrees,
    keys_on_map,
    units_of_geo_keys,
    units_of_wkt,
    wkt_in_degrees,
)

LAS_SUFFIXES = (".las", ".laz")
# Names under which CloudCompare stores and finds normals in LAS extra dimensions.
NORMAL_NAMES = ("NormalX", "NormalY", "NormalZ")
#: Standard dimensions worth keeping when they say anything (are not all zero), and their types. Source: format; LAS.
KEPT_DIMENSIONS: dict[str, np.dtype[Any]] = {"intensity": np.dtype(np.uint16), "classification": np.dtype(np.uint8)}
_COLOURS = ("red", "green", "blue")
#: Points that are unpacked at once. Source: numerics; a header that lies costs no more memory than so many.
_PIECE_POINTS, _PIECE_BYTES = 1_000_000, 1 << 28
#: Classes of points that are noise, below and above; in point formats before the sixth the latter means nothing.
#: Source: format; LAS 1.4, tables 9 and 17.
_LOW_NOISE, _HIGH_NOISE, _HIGH_NOISE_FROM = 7, 18, 6
#: Value of a GeoTIFF key for "user defined". Source: format; GeoTIFF 1.1.
_USER_DEFINED = 32767


def flagged(record: Any) -> NDArray[np.bool_]:
    """(N,) which points of a laspy record are not to be used: marked as withheld (deleted), or classed as noise."""
    classes = np.asarray(record.classification)
    noise = classes == _LOW_NOISE
    if record.point_format.id >= _HIGH_NOISE_FROM:
        noise |= classes == _HIGH_NOISE
    return np.asarray(np.asarray(record.withheld, dtype=bool) | noise)


def read_las(path: Path) -> tuple[dict[str, NDArray[Any]], int]:
    """Read a LAS or LAZ file, without the points that are :func:`flagged`.

    Returns
    -------
    Columns ``x, y, z`` (float64), ``red, green, blue`` (uint8, where the file has colour), extra dimensions and the
    non-zero ones among intensity and classification; and how many points were flagged.

    Raises
    ------
    CloudError
        The file is missing, is no LAS/LAZ, or is cut short.
    """
    pieces: dict[str, list[NDArray[Any]]] = {axis: [] for axis in ("x", "y", "z")}
    extra: list[str] = []
    left_out = 0
    # Piece by piece: a header that promises more than the file holds is found out before it takes all the memory.
    for record in iterate_las(path, _PIECE_POINTS):
        extra = list(record.point_format.extra_dimension_names)
        try:
            used = ~flagged(record)
            left_out += len(used) - int(used.sum())
            for axis in ("x", "y", "z"):
                pieces[axis].append(np.array(record[axis], dtype=np.float64)[used])
            for name in record.point_format.dimension_names:
                if name in _COLOURS or name in KEPT_DIMENSIONS or name in extra:
                    pieces.setdefault(name, []).append(np.array(record[name])[used])
        except (ValueError, KeyError, TypeError) as error:  # names and types of extra dimensions that make no sense
            raise damaged(path, str(error)) from error
    whole: dict[str, NDArray[Any]] = {
        name: np.concatenate(parts) if parts else np.empty(0) for name, parts in pieces.items()
    }
    columns = {axis: whole[axis] for axis in ("x", "y", "z")}
    if set(_COLOURS) <= set(whole):
        colours = {name: whole[name] for name in _COLOURS}
        peak = max((int(c.max()) for c in colours.values() if c.size), default=0)
        # The standard says 16 bit; many programs write 8-bit values all the same.
        if peak > 0:
            columns |= {name: (c >> 8 if peak > 255 else c).astype(np.uint8) for name, c in colours.items()}
    for name in KEPT_DIMENSIONS:
        if name in whole and whole[name].any():
            columns[name] = whole[name]
    # Vectors (an extra dimension of several numbers a point) have no place in a table of points.
    return columns | {name: whole[name] for name in extra if whole[name].ndim == 1}, left_out


@contextmanager
def open_las(path: Path) -> Iterator[Any]:
    """A laspy reader of ``path``; whatever goes wrong while it is used is told as a :class:`CloudError`."""
    import laspy

    with _told(path):
        # Before laspy and lazrs believe the header.
        why = why_damaged(path)
        if why:
            raise damaged(path, why)
        with laspy.open(path) as reader:
            yield reader


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Whatever laspy cannot do inside is told as damage of ``path``."""
    try:
        yield
    except (FsinferError, MemoryError, GeneratorExit, KeyboardInterrupt, SystemExit):
        raise
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}; check the path"
        raise CloudError(msg) from error
    # laspy, lazrs and struct each raise their own kinds on a damaged file; a panic of lazrs is no Exception.
    except BaseException as error:
        raise damaged(path, str(error)) from error


def count_las(path: Path) -> int:
    """Number of points that the header of a LAS or LAZ file gives."""
    with open_las(path) as reader:
        return int(reader.header.point_count)


def iterate_las(path: Path, chunk_points: int) -> Iterator[Any]:
    """The points of a LAS or LAZ file as laspy records of up to ``chunk_points``; raises where some are missing."""
    with open_las(path) as reader:
        expected, have = int(reader.header.point_count), 0
        # Points may be as long as a header says.
        chunk_points = max(1, min(chunk_points, _PIECE_BYTES // max(int(reader.header.point_format.size), 1)))
        for record in reader.chunk_iterator(chunk_points):
            have += len(record)
            yield record
        if have < expected:
            raise damaged(path, f"{have} of {expected} points are there")


def sample_las(path: Path, starts: Sequence[int], count: int) -> NDArray[np.float64]:
    """Coordinates (N, 3) of ``count`` points from each of ``starts`` on, if possible without those :func:`flagged`."""
    pieces = []
    with open_las(path) as reader:
        for start in starts:
            reader.seek(start)
            record = reader.read_points(count)
            pieces.append((np.column_stack([record.x, record.y, record.z]), ~flagged(record)))
    if not pieces:
        return np.zeros((0, 3))
    xyz, used = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    # Pieces may all be of a stretch that is flagged.
    return np.asarray(xyz[used] if used.any() else xyz)


def read_epsg(path: Path) -> int | None:
    """EPSG code of the horizontal frame that a LAS or LAZ header names, None where it names none.

    Looks at the WKT records, and after them at the GeoTIFF keys (projected, then geographic).
    """
    texts, keys = _frame_records(path)
    code = next((code for text in texts if (code := horizontal_epsg(text)) is not None), None)
    if code is not None:
        return code
    # On the map longitude and latitude are those that a projection without a code is based on.
    for key_id in (PROJECTED_KEY,) if keys_on_map(keys) else (GEOGRAPHIC_KEY,):
        if keys.get(key_id, 0) not in (0, _USER_DEFINED):
            return keys[key_id]
    return None


def is_in_degrees(path: Path) -> bool:
    """Whether x and y of a LAS or LAZ file are longitude and latitude, as its header has it."""
    texts, keys = _frame_records(path)
    told = next((told for text in texts if (told := wkt_in_degrees(text)) is not None), None)
    return keys_in_degrees(keys) if told is None else told


def read_units_m(path: Path) -> LinearUnits:
    """Metres in the units of a LAS or LAZ file's coordinates, as far as its header tells them."""
    texts, keys = _frame_records(path)
    by_text = next((units for text in texts if (units := units_of_wkt(text)) != LinearUnits()), LinearUnits())
    by_keys = units_of_geo_keys(keys)
    return LinearUnits(
        horizontal_m=by_text.horizontal_m or by_keys.horizontal_m, vertical_m=by_text.vertical_m or by_keys.vertical_m
    )


def _frame_records(path: Path) -> tuple[list[str], dict[int, int]]:
    """The WKT texts of a header and its GeoTIFF keys with their short values."""
    with open_las(path) as reader:
        records = records_of(reader.header)
    texts = [getattr(record, "string", "") for record in records]
    keys = {int(key.id): int(key.value_offset) for record in records for key in getattr(record, "geo_keys", ())}
    return [text.rstrip("\x00") for text in texts if isinstance(text, str) and "[" in text], keys


def records_of(header: Any) -> list[Any]:
    """All records of a laspy header, those behind the points too."""
    return [*header.vlrs, *(header.evlrs or [])]


def damaged(path: Path, why: str) -> CloudError:
    """The error of a file that is not what its name says."""
    return CloudError(f"{path} is no LAS/LAZ file, or is cut short or damaged ({why}); export or copy it again")

"""LAS and LAZ by laspy with lazrs: columns in, columns out."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import CloudError, FsinferError
from fsinfer.io.crs import horizontal_epsg
from fsinfer.io.files import atomic_path, is_disk_full
from fsinfer.io.las_header import why_damaged
from fsinfer.io.linear_units import LinearUnits, units_of_geo_keys, units_of_wkt

LAS_SUFFIXES = (".las", ".laz")
# Names under which CloudCompare stores and finds normals in LAS extra dimensions.
NORMAL_NAMES = ("NormalX", "NormalY", "NormalZ")
#: Standard dimensions worth keeping when they say anything (are not all zero), and their types. Source: format; LAS.
_KEPT_DIMENSIONS: dict[str, np.dtype[Any]] = {"intensity": np.dtype(np.uint16), "classification": np.dtype(np.uint8)}
_COLOURS = ("red", "green", "blue")
#: Steps of the stored integers in the extent of a cloud, at least: 0.1 mm on a plot of 30 m. Source: numerics.
_STEPS_PER_EXTENT = 1e5
#: Finest and coarsest step, metres: a millimetre is told of any forest. Source: numerics.
_STEP_RANGE_M = (1e-7, 1e-3)
#: Steps that a stored integer can count. Source: format; LAS stores 32 bits with a sign.
_MOST_STEPS = 2e9
#: Longest name of an extra dimension, bytes. Source: format; LAS 1.4.
_NAME_BYTES = 32
#: Most bytes of a record in the header. Source: format; LAS 1.4.
_RECORD_BYTES = 65_535
#: Factor from 8-bit colours to those of 16 bits. Source: format; LAS 1.4, 65535 over 255.
_COLOUR_FACTOR = 257
#: Points that are unpacked at once. Source: numerics; a header that lies costs no more memory than so many.
_PIECE_POINTS, _PIECE_BYTES = 1_000_000, 1 << 28
#: Classes of points that are noise, below and above; in point formats before the sixth the latter means nothing.
#: Source: format; LAS 1.4, tables 9 and 17.
_LOW_NOISE, _HIGH_NOISE, _HIGH_NOISE_FROM = 7, 18, 6
#: Keys ProjectedCSTypeGeoKey and GeographicTypeGeoKey, and the value for "user defined". Source: format; GeoTIFF 1.1.
_PROJECTED_KEY, _GEOGRAPHIC_KEY, _USER_DEFINED = 3072, 2048, 32767

_log = logging.getLogger(__name__)


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
                if name in _COLOURS or name in _KEPT_DIMENSIONS or name in extra:
                    pieces.setdefault(name, []).append(np.array(record[name])[used])
        except (ValueError, KeyError, TypeError) as error:  # names and types of extra dimensions that make no sense
            raise _damaged(path, str(error)) from error
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
    for name in _KEPT_DIMENSIONS:
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
            raise _damaged(path, why)
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
        raise _damaged(path, str(error)) from error


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
            raise _damaged(path, f"{have} of {expected} points are there")


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
    for key_id in (_PROJECTED_KEY, _GEOGRAPHIC_KEY):
        if keys.get(key_id, 0) not in (0, _USER_DEFINED):
            return keys[key_id]
    return None


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
        records = _records(reader.header)
    texts = [getattr(record, "string", "") for record in records]
    keys = {int(key.id): int(key.value_offset) for record in records for key in getattr(record, "geo_keys", ())}
    return [text.rstrip("\x00") for text in texts if isinstance(text, str) and "[" in text], keys


def write_las(
    path: Path,
    xyz: NDArray[np.float64],
    rgb: NDArray[np.uint8] | None,
    extra: dict[str, Any],
    *,
    frame_of: Path | None = None,
) -> None:
    """Write LAS 1.4 (compressed when the suffix is .laz), atomically.

    The step of the stored integers is a power of ten between 1e-7 and 0.001 that follows from the extent (0.1 mm for
    a plot of 10 to 99 m); coordinates are stored from an offset, so georeferenced ones keep that precision.

    Parameters
    ----------
    xyz: (N, 3) float64.
    rgb: (N, 3) uint8 or None; stored as 16 bit (x257).
    extra: name -> (N,) values in a LAS scalar type. ``intensity`` and ``classification`` go to the standard dimensions
        where they are whole numbers that fit. Others that are named like a standard dimension get a ``_`` at their end,
        and names of more than 32 bytes are cut.
    frame_of: a LAS or LAZ file whose header names the frame that the coordinates are in.
    """
    extra = {name: _as_kept(name, values) for name, values in extra.items()}
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    kinds = {name: values.dtype for name, values in extra.items()}
    with las_writer(path, low, high, colour=rgb is not None, kinds=kinds, frame_of=frame_of) as append:
        append(xyz, rgb, extra)


@contextmanager
def las_writer(
    path: Path,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    *,
    colour: bool,
    kinds: Mapping[str, np.dtype[Any]],
    frame_of: Path | None = None,
) -> Iterator[Callable[[NDArray[np.float64], NDArray[np.uint8] | None, Mapping[str, Any]], None]]:
    """Write as :func:`write_las` does, in pieces: gives a function that appends xyz, rgb and extra.

    ``low`` and ``high`` (3,) are the corners of the cloud, ``kinds`` the types of ``extra``. Points so far outside of
    the corners that no stored integer reaches them are left out, with a warning in the log.
    """
    import laspy

    extent = float((high - low).max())
    step = 10.0 ** math.floor(math.log10(extent / _STEPS_PER_EXTENT)) if extent > 0 else 1e-4
    step = min(max(step, _STEP_RANGE_M[0]), _STEP_RANGE_M[1])
    # Beyond 2^31 steps the integers overflow; no forest is 2,000 km wide, but broken poses can be.
    step = max(step, extent / _MOST_STEPS)
    header = laspy.LasHeader(point_format=7 if colour else 6, version="1.4")
    header.scales = np.full(3, step)
    header.offsets = np.floor(low)
    if frame_of is not None:
        with open_las(frame_of) as reader:
            _take_frame(header, reader.header)
    own = _own_names(kinds, laspy.ScaleAwarePointRecord.zeros(1, header=header))
    header.add_extra_dims([laspy.ExtraBytesParams(name=short, type=kinds[name]) for name, short in own.items()])
    reach = step * (np.iinfo(np.int32).max - 1)
    lowest, highest, left_out = header.offsets - reach, header.offsets + reach, 0

    with atomic_path(path) as temporary, laspy.open(str(temporary), mode="w", header=header) as writer:

        def append(xyz: NDArray[np.float64], rgb: NDArray[np.uint8] | None, extra: Mapping[str, Any]) -> None:
            nonlocal left_out
            held = ((xyz >= lowest) & (xyz <= highest)).all(axis=1)
            if not held.all():
                left_out += len(xyz) - int(held.sum())
                xyz, rgb = xyz[held], None if rgb is None else rgb[held]
                extra = {name: values[held] for name, values in extra.items()}
            record = laspy.ScaleAwarePointRecord.zeros(len(xyz), header=header)
            record.x, record.y, record.z = xyz.T
            if rgb is not None:
                record.red, record.green, record.blue = rgb.T.astype(np.uint16) * _COLOUR_FACTOR
            for name, values in extra.items():
                record[own.get(name, name)] = values
            writer.write_points(record)

        yield append
    if left_out:
        _log.warning("%s: %d points lie too far from the others to be stored and were left out", path, left_out)


def _as_kept(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Values (N,) in the type of the standard dimension ``name``, where there is one and it holds them."""
    kind = _KEPT_DIMENSIONS.get(name)
    if kind is None or np.can_cast(values.dtype, kind):
        return values
    fits = np.all((values >= 0) & (values <= np.iinfo(kind).max) & (values == np.floor(values)))
    return values.astype(kind) if fits else values


def _own_names(kinds: Mapping[str, np.dtype[Any]], record: Any) -> dict[str, str]:
    """Names of the extra dimensions for columns of these types; those that go to standard dimensions are not in it.

    ``record`` is one of laspy without any: what it finds by a name, it would write over.
    """
    own: dict[str, str] = {}
    taken = {name for name, kind in _KEPT_DIMENSIONS.items() if name in kinds and np.can_cast(kinds[name], kind)}
    for name in kinds:
        if name in taken:
            continue
        short, tail = _cut(name, _NAME_BYTES), ""
        while short in own.values() or _has(record, short):
            tail += "_"
            short = _cut(name, _NAME_BYTES - len(tail)) + tail
        own[name] = short
        if tail:
            _log.info("column %s is stored as %s: LAS has a dimension of its name", name, short)
    return own


def _cut(name: str, size: int) -> str:
    return name.encode()[:size].decode(errors="ignore")


def _has(record: Any, name: str) -> bool:
    try:
        record[name]
    except (ValueError, KeyError, IndexError):
        return False
    return True


def copy_las(
    source: Path,
    target: Path,
    name: str,
    label: Callable[[NDArray[np.float64]], NDArray[np.int32]],
    *,
    chunk_points: int,
    factor: float = 1.0,
) -> None:
    """Copy a LAS or LAZ file piece by piece with one more dimension ``name``: ``label`` of its points (N, 3).

    Points that are :func:`flagged` get 0.

    Stored integers stay as they are: ``factor`` (metres per unit of the source, which ``label`` gets) goes into their
    step, and takes the frame away that the header names, which is no longer that of the coordinates.
    """
    import laspy

    with open_las(source) as reader:
        old = reader.header
        header = laspy.LasHeader(point_format=old.point_format, version=old.version)
        # One dimension of that name may be there from an earlier run; then it is written over.
        if name not in set(header.point_format.dimension_names):
            header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=np.int32))
        header.scales, header.offsets = old.scales * factor, old.offsets * factor
        if factor == 1.0:
            _take_frame(header, old)
    with atomic_path(target) as temporary, ExitStack() as open_file:
        with _writing(source, target):
            writer = open_file.enter_context(laspy.open(str(temporary), mode="w", header=header))
        for points in iterate_las(source, chunk_points):
            numbers = label(np.column_stack([points.x, points.y, points.z]) * factor)
            numbers = np.where(flagged(points), np.int32(0), numbers)
            with _writing(source, target):
                record = laspy.ScaleAwarePointRecord.zeros(len(points), header=header)
                for dimension in points.point_format.dimension_names:
                    record[dimension] = points[dimension]
                record[name] = numbers
                writer.write_points(record)
        with _writing(source, target):
            open_file.close()


@contextmanager
def _writing(source: Path, target: Path) -> Iterator[None]:
    """As :func:`_told`, but what cannot be written is no fault of ``source``: such errors pass."""
    try:
        yield
    except (OSError, MemoryError):
        raise
    except Exception as error:
        # Points are unpacked elsewhere: what lazrs says here is that it cannot write.
        if is_disk_full(target.parent) or type(error).__name__ == "LazrsError":
            raise
        raise _damaged(source, str(error)) from error


def _take_frame(header: Any, old: Any) -> None:
    """Put what the header ``old`` says of its frame into ``header``, both of laspy."""
    named = [record for record in _records(old) if str(getattr(record, "user_id", "")) == "LASF_Projection"]
    # Behind the points there is room for more; before them a record holds so many bytes.
    header.vlrs.extend(record for record in named if len(record.record_data_bytes()) <= _RECORD_BYTES)
    header.global_encoding.wkt = old.global_encoding.wkt


def _records(header: Any) -> list[Any]:
    """All records of a laspy header, those behind the points too."""
    return [*header.vlrs, *(header.evlrs or [])]


def _damaged(path: Path, why: str) -> CloudError:
    return CloudError(f"{path} is no LAS/LAZ file, or is cut short or damaged ({why}); export or copy it again")

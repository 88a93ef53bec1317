"""Writing LAS and LAZ by laspy with lazrs; reading them is :mod:`fsinfer.io.las`."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.files import atomic_path, is_disk_full
from fsinfer.io.las import KEPT_DIMENSIONS, damaged, flagged, is_in_degrees, iterate_las, open_las, records_of

_log = logging.getLogger(__name__)


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
    kind = KEPT_DIMENSIONS.get(name)
    if kind is None or np.can_cast(values.dtype, kind):
        return values
    fits = np.all((values >= 0) & (values <= np.iinfo(kind).max) & (values == np.floor(values)))
    return values.astype(kind) if fits else values


def _own_names(kinds: Mapping[str, np.dtype[Any]], record: Any) -> dict[str, str]:
    """Names of the extra dimensions for columns of these types; those that go to standard dimensions are not in it.

    ``record`` is one of laspy without any: what it finds by a name, it would write over.
    """
    own: dict[str, str] = {}
    taken = {name for name, kind in KEPT_DIMENSIONS.items() if name in kinds and np.can_cast(kinds[name], kind)}
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
    step, and takes the frame away that the header names, which is no longer that of the coordinates. So goes a frame in
    degrees, which is not that of metres.
    """
    import laspy

    with open_las(source) as reader:
        old = reader.header
        header = laspy.LasHeader(point_format=old.point_format, version=old.version)
        # One dimension of that name may be there from an earlier run; then it is written over, or makes room where
        # another program's is too narrow for the numbers.
        there = next((found for found in header.point_format.extra_dimensions if found.name == name), None)
        if there is not None and not _holds_numbers(there):
            header.remove_extra_dim(name)
            there = None
        if there is None:
            header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=np.int32))
        header.scales, header.offsets = old.scales * factor, old.offsets * factor
        if factor == 1.0 and not is_in_degrees(source):
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
                    if dimension != name:
                        record[dimension] = points[dimension]
                record[name] = numbers
                writer.write_points(record)
        with _writing(source, target):
            open_file.close()


def _holds_numbers(dimension: Any) -> bool:
    """Whether a dimension of laspy is one value a point that is any int32 exactly."""
    scalar = dimension.num_elements == 1 and dimension.scales is None and dimension.offsets is None
    return scalar and dimension.dtype is not None and np.can_cast(np.int32, dimension.dtype)


@contextmanager
def _writing(source: Path, target: Path) -> Iterator[None]:
    """As :func:`~fsinfer.io.las.open_las` tells, but what cannot be written is no fault of ``source`` and passes."""
    try:
        yield
    except (OSError, MemoryError):
        raise
    except Exception as error:
        # Points are unpacked elsewhere: what lazrs says here is that it cannot write.
        if is_disk_full(target.parent) or type(error).__name__ == "LazrsError":
            raise
        raise damaged(source, str(error)) from error


def _take_frame(header: Any, old: Any) -> None:
    """Put what the header ``old`` says of its frame into ``header``, both of laspy."""
    named = [record for record in records_of(old) if str(getattr(record, "user_id", "")) == "LASF_Projection"]
    # Behind the points there is room for more; before them a record holds so many bytes.
    header.vlrs.extend(record for record in named if len(record.record_data_bytes()) <= _RECORD_BYTES)
    header.global_encoding.wkt = old.global_encoding.wkt

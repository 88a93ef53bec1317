"""Point clouds: one type, read from and written to PLY, LAS and LAZ (and read from plain text)."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.io.las import LAS_SUFFIXES, NORMAL_NAMES, read_las
from fsinfer.io.las_writing import write_las
from fsinfer.io.ply import read_ply, write_ply
from fsinfer.io.text_cloud import read_text_cloud

TEXT_SUFFIXES = (".xyz", ".txt", ".asc", ".csv", ".pts")
#: Of ``PointCloud.extra``: standard deviation of a point along its line of sight, in the unit of the cloud.
DEPTH_STD = "depth_std"
#: Of ``PointCloud.extra``: length that a pixel of its depth maps has at a point, in the unit of the cloud; their object
#: sampling distance.
PIXEL_SIZE = "pixel_size"
#: Those of ``PointCloud.extra`` that are lengths.
LENGTHS = (DEPTH_STD, PIXEL_SIZE)
SUFFIXES = (".ply", *LAS_SUFFIXES, *TEXT_SUFFIXES)
#: Columns that a message names. Source: layout.
_MOST_COLUMNS = 8
#: PLY coordinates become double when the step of float32 at the largest coordinate exceeds this part of the extent:
#: georeferenced clouds need it, local ones stay small and open everywhere. Source: numerics; 0.03 mm on a plot of 30 m.
_FLOAT_STEP_PER_EXTENT = 1e-6
_COLOUR_NAMES = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_NORMAL_SETS = (("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z"), NORMAL_NAMES)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PointCloud:
    """Points with what is known of each.

    Attributes
    ----------
    xyz: (N, 3) float64.
    rgb: (N, 3) uint8, or None.
    normals: (N, 3) float32 unit vectors, or None.
    extra: name -> (N,) values, e.g. ``views`` (int32), ``confidence``, ``depth_std`` and ``pixel_size`` (float32),
        ``TreeID`` (int32).

    Raises
    ------
    CloudError
        The shapes do not fit each other.
    """

    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8] | None = None
    normals: NDArray[np.float32] | None = None
    extra: dict[str, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.xyz.ndim != 2 or self.xyz.shape[1] != 3:
            msg = f"a cloud needs points of shape (N, 3), not {self.xyz.shape}"
            raise CloudError(msg)
        for name, values in (("rgb", self.rgb), ("normals", self.normals)):
            if values is not None and values.shape != self.xyz.shape:
                msg = f"{name} has shape {values.shape}, but the cloud has {len(self.xyz)} points; give one row a point"
                raise CloudError(msg)
        for name, values in self.extra.items():
            if values.shape != (len(self.xyz),):
                msg = f"{name} has shape {values.shape}, but the cloud has {len(self.xyz)} points; give one value each"
                raise CloudError(msg)

    def __len__(self) -> int:
        return len(self.xyz)

    def select(self, chosen: NDArray[Any]) -> PointCloud:
        """Return the cloud of ``chosen`` points: an (N,) mask or an array of indices."""
        return PointCloud(
            xyz=self.xyz[chosen],
            rgb=None if self.rgb is None else self.rgb[chosen],
            normals=None if self.normals is None else self.normals[chosen],
            extra={name: values[chosen] for name, values in self.extra.items()},
        )


@dataclass(frozen=True, kw_only=True)
class ReadCloud:
    """A cloud and what was dropped of its file.

    Attributes
    ----------
    not_finite: points with a coordinate that is none.
    flagged: points that a LAS or LAZ marks as withheld or classes as noise (:func:`fsinfer.io.las.flagged`).
    """

    cloud: PointCloud
    not_finite: int = 0
    flagged: int = 0


def read_cloud(path: Path | str) -> PointCloud:
    """Read a cloud from .ply, .las, .laz, or text (.xyz, .txt, .asc, .csv: x y z [red green blue]).

    Points with a coordinate that is not finite are dropped, and so are those that a LAS or LAZ marks as withheld or
    classes as noise, with a warning in the log.

    Raises
    ------
    CloudError
        As :func:`read_and_tell`.
    """
    path = Path(path)
    read = read_and_tell(path)
    if read.not_finite:
        of = len(read.cloud) + read.not_finite
        _log.warning("%s: %d of %d points have no finite coordinates and were dropped", path, read.not_finite, of)
    if read.flagged:
        _log.warning("%s: %d points are marked as withheld or as noise and were dropped", path, read.flagged)
    return read.cloud


def read_and_tell(path: Path) -> ReadCloud:
    """As :func:`read_cloud`, with how many points were dropped.

    Raises
    ------
    CloudError
        The file is missing, of another kind, cut short, or holds no point that can be used.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        msg = f"{path}: cannot read clouds of kind '{path.suffix}'; give a .ply, .las, .laz or .xyz file"
        raise CloudError(msg)
    if not path.is_file():
        msg = f"there is no file {path}; check the path"
        raise CloudError(msg)
    flagged = 0
    if suffix == ".ply":
        columns = read_ply(path)
    elif suffix in LAS_SUFFIXES:
        columns, flagged = read_las(path)
    else:
        columns = read_text_cloud(path)
    cloud = cloud_of_columns(path, columns)
    finite = np.asarray(np.isfinite(cloud.xyz).all(axis=1))
    dropped = len(cloud) - int(finite.sum())
    if dropped:
        cloud = cloud.select(finite)
    if not len(cloud):
        raise nothing_usable(path, flagged)
    return ReadCloud(cloud=cloud, not_finite=dropped, flagged=flagged)


def nothing_usable(path: Path, flagged: int = 0) -> CloudError:
    """What to say of a file without a point that can be used, where so many are ``flagged`` (:class:`ReadCloud`)."""
    why = f": {flagged} are marked as withheld or as noise" if flagged else ""
    return CloudError(f"{path} holds no points that can be used{why}; export the cloud again")


def write_cloud(path: Path | str, cloud: PointCloud, *, frame_of: Path | None = None) -> None:
    """Write a cloud to .ply (binary), .las or .laz, atomically; the suffix decides.

    PLY coordinates are float, or double where float would lose precision (far from the origin). LAS and LAZ colours
    are 16 bit; normals and ``extra`` become extra dimensions. ``frame_of`` is a LAS or LAZ file whose header names the
    frame that the coordinates are in; a LAS or LAZ gets what it says.

    Raises
    ------
    CloudError
        The suffix is unknown, or the cloud is empty or not finite.
    OutputError
        The file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".ply", *LAS_SUFFIXES):
        msg = f"{path}: cannot write clouds of kind '{path.suffix}'; name the file .ply, .las or .laz"
        raise CloudError(msg)
    if not len(cloud):
        msg = f"there are no points to write into {path}; run the stage before this one again"
        raise CloudError(msg)
    if not np.isfinite(cloud.xyz).all():
        msg = f"some points for {path} have no finite coordinates; drop them before writing"
        raise CloudError(msg)
    extra = {name: storable(name, values, wide=suffix != ".ply") for name, values in cloud.extra.items()}
    if suffix == ".ply":
        columns: dict[str, NDArray[Any]] = dict(zip("xyz", _ply_coordinates(cloud.xyz).T, strict=True))
        if cloud.normals is not None:
            columns |= dict(zip(("nx", "ny", "nz"), cloud.normals.astype(np.float32).T, strict=True))
        if cloud.rgb is not None:
            columns |= dict(zip(_COLOUR_NAMES[0], cloud.rgb.astype(np.uint8).T, strict=True))
        # A PLY property name ends at the first space.
        columns |= {"_".join(name.split()): values for name, values in extra.items()}
        write_ply(path, columns, comments=("written by fsinfer",))
    else:
        if cloud.normals is not None:
            extra |= dict(zip(NORMAL_NAMES, cloud.normals.astype(np.float32).T, strict=True))
        write_las(path, cloud.xyz, cloud.rgb, extra, frame_of=frame_of)


def _ply_coordinates(xyz: NDArray[np.float64]) -> NDArray[Any]:
    extent = float(np.ptp(xyz, axis=0).max())
    step = float(np.spacing(np.float32(np.abs(xyz).max())))
    return xyz if step > _FLOAT_STEP_PER_EXTENT * extent else xyz.astype(np.float32)


def storable(name: str, values: NDArray[Any], *, wide: bool = False) -> NDArray[Any]:
    """Convert to a type that PLY and LAS have: not booleans, and 64-bit integers only in LAS (``wide``)."""
    if values.dtype == np.bool_:
        return values.astype(np.uint8)
    if values.dtype.kind in "iu" and values.dtype.itemsize == 8:
        limits = np.iinfo(np.int32)
        if values.size and (values.min() < limits.min or values.max() > limits.max):
            if wide:
                return values
            msg = f"the values of {name} do not fit into 32-bit integers; store smaller numbers or floats"
            raise CloudError(msg)
        return values.astype(np.int32)
    if values.dtype == np.float16:
        return values.astype(np.float32)
    if values.dtype.kind not in "iuf" or values.dtype.itemsize > 8:
        msg = f"{name} holds {values.dtype}, which a cloud file cannot; give numbers"
        raise CloudError(msg)
    return values


def cloud_of_columns(path: Path, columns: dict[str, NDArray[Any]]) -> PointCloud:
    """A cloud of (N,) columns by name, as a file has them; ``path`` is for the message where x, y or z is missing."""
    lower = {name.lower(): name for name in columns}
    if not all(axis in lower for axis in "xyz"):
        names = ", ".join(list(columns)[:_MOST_COLUMNS]) + (", ..." if len(columns) > _MOST_COLUMNS else "")
        msg = f"{path} has no x, y and z for its points (but {names or 'nothing'}); name them so, or export it again"
        raise CloudError(msg)
    columns = dict(columns)

    def take(names: tuple[str, ...]) -> NDArray[Any] | None:
        if not all(name.lower() in lower and lower[name.lower()] in columns for name in names):
            return None
        return np.stack([columns.pop(lower[name.lower()]) for name in names], axis=1)

    xyz = take(("x", "y", "z"))
    colour = next((c for c in map(take, _COLOUR_NAMES) if c is not None), None)
    normals = next((n for n in map(take, _NORMAL_SETS) if n is not None), None)
    return PointCloud(
        xyz=np.asarray(xyz, dtype=np.float64),
        rgb=None if colour is None else _eight_bit(colour),
        normals=None if normals is None else np.nan_to_num(normals).astype(np.float32),
        extra=columns,
    )


def _eight_bit(colour: NDArray[Any]) -> NDArray[np.uint8]:
    if colour.dtype.kind == "f":
        # Some programs write colour as 0..1 floats; nothing that is really 0..255 stays below 1 everywhere.
        colour = np.nan_to_num(colour)
        colour = np.rint(colour * (255 if colour.size and colour.max() <= 1 else 1))
    elif colour.dtype.itemsize > 1 and colour.size and colour.max() > 255:
        colour = colour >> 8
    return np.asarray(np.clip(colour, 0, 255), dtype=np.uint8)

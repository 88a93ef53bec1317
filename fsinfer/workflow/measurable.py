"""Cloud files that would be measured wrongly, told before anything is computed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fsinfer.errors import CloudError
from fsinfer.io.las import LAS_SUFFIXES, is_in_degrees, open_las, read_epsg, read_units_m
from fsinfer.output.layout import RECORDS_FOLDER, TREES_LAZ, OutputFolder

#: Lengths of two units that differ by less, metres, are the same: feet of the US survey are 0.6 micrometres longer than
#: others. Source: numerics.
_SAME_UNIT_M = 1e-6
#: Frames whose metres are none on the ground, or whose z is not up, and why. Source: format; EPSG registry.
_NO_METRES = {
    3857: "whose metres are longer than those on the ground (Web Mercator, half as long again at 48 degrees)",
    3785: "whose metres are longer than those on the ground (Web Mercator)",
    900913: "whose metres are longer than those on the ground (Web Mercator)",
    4978: "whose z is not up (coordinates from the middle of the earth)",
}
#: No degree is beyond, and no plot is wider, degrees. Source: definition; judgement, 11 km.
_MOST_DEGREES, _WIDEST_DEGREES = 360.0, 0.1

#: What in a folder is a cloud; a text may be any table. Source: format.
_SHOWN_SUFFIXES = (".ply", *LAS_SUFFIXES)


def refuse_no_file(cloud_path: Path) -> None:
    """Refuse what is not there, and a folder, as ``fsinfer run`` and ``fsinfer report`` take one: its clouds are named.

    Raises
    ------
    CloudError
        There is no such file.
    """
    if not cloud_path.exists():
        msg = f"there is no file {cloud_path}; check the path"
        raise CloudError(msg)
    if not cloud_path.is_dir():
        return
    try:
        inside = sorted(path for path in cloud_path.iterdir() if path.suffix.lower() in _SHOWN_SUFFIXES)
    except OSError:
        inside = []
    finished = OutputFolder(cloud_path).cloud_ply
    # The points with numbers of trees are a result.
    clouds = [finished] if finished in inside else [path for path in inside if path.name != TREES_LAZ]
    if not clouds:
        way_out = "a point cloud (.ply, .las, .laz or .xyz); a folder of photos is for fsinfer run"
    elif len(clouds) == 1:
        way_out = f"the cloud in it, {clouds[0]}"
    else:
        way_out = f"one of the {len(clouds)} clouds in it, such as {clouds[0]}"
    msg = f"{cloud_path} is a folder; give {way_out}"
    raise CloudError(msg)


def refuse_fused(cloud_path: Path) -> None:
    """Refuse the cloud of the stage ``fuse``: it is in the scene's frame and units."""
    folder = cloud_path.parent.resolve()
    if folder.name == "fused" and (folder.parent / RECORDS_FOLDER).is_dir():
        finished = folder.parent / "cloud.ply"
        msg = f"{cloud_path} is what a run made before it knew what is up and how long a metre is; give {finished}"
        raise CloudError(msg)


def refuse_other_units(cloud_path: Path) -> None:
    """Refuse a cloud whose header says that it is not in metres; many headers say nothing."""
    if cloud_path.suffix.lower() not in LAS_SUFFIXES:
        return
    epsg = read_epsg(cloud_path)
    if epsg in _NO_METRES:
        msg = f"{cloud_path} is in EPSG:{epsg} by its header, {_NO_METRES[epsg]}; convert it to UTM or a national grid"
        raise CloudError(msg)
    if is_in_degrees(cloud_path) and _within_degrees(cloud_path):
        code = "" if epsg is None else f" (EPSG:{epsg})"
        msg = f"{cloud_path} is in degrees by its header{code}; convert it to UTM or a national grid"
        raise CloudError(msg)
    units = read_units_m(cloud_path)
    lengths = [unit for unit in (units.horizontal_m, units.vertical_m) if unit is not None]
    if all(abs(unit - 1.0) < _SAME_UNIT_M for unit in lengths):
        return
    if max(lengths) - min(lengths) < _SAME_UNIT_M:
        way_out = f"give --scale {lengths[0]:.10g}, its metres per unit"
    else:
        way_out = f"its units on the map and of the heights differ ({lengths[0]:g} and {lengths[1]:g} m): convert it"
    msg = f"{cloud_path} is not in metres, by its header; {way_out}"
    raise CloudError(msg)


def _within_degrees(cloud_path: Path) -> bool:
    """Whether x and y can be degrees at all: some headers name such a frame of coordinates that are metres."""
    with open_las(cloud_path) as reader:
        low, high = np.asarray(reader.header.mins[:2]), np.asarray(reader.header.maxs[:2])
    small = 0.0 < float((high - low).max()) < _WIDEST_DEGREES
    return small and float(np.abs([low, high]).max()) <= _MOST_DEGREES

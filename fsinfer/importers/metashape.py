"""Cameras of Agisoft Metashape, exported as XML (File > Export > Export Cameras, format Agisoft XML).

A camera's ``transform`` leads from the camera (x right, y down, z forward) to the chunk, row by row; that of the chunk
or of its component (rotation, translation, scale) from there to metres: geocentric where the chunk has a coordinate
system of the Earth, else local. Intrinsics: ``u = w/2 + cx + f x' + b1 x' + b2 y'``, ``v = h/2 + cy + f y'``, with
``x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸) + p1 (r² + 2 x²) + 2 p2 x y`` and
``y' = y (...) + p2 (r² + 2 y²) + 2 p1 x y``; the centre of the top left pixel lies at (0.5, 0.5). Source: Metashape's
user manual, appendix "Camera models", and Agisoft's forum (axes of the camera, transform of the chunk).
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fsinfer.errors import SceneError
from fsinfer.importers.files import numbers, read_bytes, unfit
from fsinfer.importers.foreign import (
    Floats,
    ForeignScene,
    centers_of,
    exact_rotation,
    moved,
    near_origin,
    pose_from_center,
)
from fsinfer.importers.lens import Lens
from fsinfer.importers.metashape_scale import doubt_of_scale
from fsinfer.importers.photos import Registered, gather

PROGRAM = "Metashape"
#: Kinds of sensors whose lens is the one above.
_FRAME = "frame"
#: Distances from the middle of the Earth to places where trees stand, metres. Source: format; WGS84's half axes, less
#: and more 20 km.
_EARTH_NEAR, _EARTH_FAR = 6_336_000.0, 6_399_000.0
#: Half axes of WGS84, metres. Source: format; EPSG 7030.
_HALF_AXES = (6_378_137.0, 6_378_137.0, 6_356_752.314)


def is_metashape(path: Path) -> bool:
    """Whether an XML file holds cameras of Metashape."""
    if path.suffix.lower() != ".xml":
        return False
    try:
        with path.open("rb") as stream:
            head = stream.read(4096)
    except OSError:
        return False
    return b"<document" in head and b"<chunk" in head


def read_metashape(path: Path, photos: Sequence[Path]) -> ForeignScene:
    """Read exported cameras; ``photos`` are the folders in which the photographs may lie.

    Raises
    ------
    SceneError
        It is damaged, no camera has a place, a sensor is no frame camera, or no photograph is found.
    """
    chunk = _chunk(path)
    lenses: dict[str, Lens | None] = {
        sensor.get("id", ""): _lens(sensor, path) for sensor in chunk.findall("./sensors/sensor")
    }
    remarks, left_out, placed = [], [], []
    for group, camera in _cameras(chunk):
        transform = camera.find("transform")
        label = camera.get("label") or f"camera {camera.get('id')}"
        # Groups are mostly made of folders, and labels have none: IMG_0001 of two of them are two photographs.
        label = f"{group}/{label}" if group else label
        if transform is None or camera.get("enabled") in ("false", "0"):
            left_out.append(label)
            continue
        placed.append((label, camera, numbers(transform.text or "", 16, path, f"the place of {label}").reshape(4, 4)))
    component = Counter(camera.get("component_id", "") for _, camera, _ in placed).most_common(1)
    chosen = component[0][0] if component else ""
    similarity = _similarity(chunk, chosen, path)
    scale = 1.0 if similarity is None else float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    registered = []
    for label, camera, chunk_from_cam in placed:
        if camera.get("component_id", "") != chosen:
            left_out.append(label)
            continue
        lens = lenses.get(camera.get("sensor_id", ""))
        if lens is None:
            raise unfit(path, f"{label} has a sensor without a calibration")
        world_from_cam = chunk_from_cam if similarity is None else similarity @ chunk_from_cam
        world_from_cam = world_from_cam.copy()
        world_from_cam[:3, :3] /= scale
        pose = pose_from_center(world_from_cam, f"{path}, {label}")
        registered.append(Registered(name=label, lens=lens, cam_from_world=pose))
    gathered = gather(registered, photos, source=path)
    if len(component) and len({camera.get("component_id", "") for _, camera, _ in placed}) > 1:
        remarks.append("of the components of the chunk the one with the most photographs is used")
    if similarity is None:
        remarks.append("the chunk has no scale (no markers, scale bars or GNSS), so that lengths are in its own units")
    else:
        doubt = doubt_of_scale(chunk, centers_of(gathered.photos))
        remarks += [] if doubt is None else [doubt]
    scene = ForeignScene(
        program=PROGRAM,
        files=(path,),
        photos=gathered.photos,
        metric=similarity is not None,
        left_out=(*left_out, *gathered.missing),
        remarks=(*remarks, *gathered.remarks),
    )
    return _on_the_ground(scene)


def _chunk(path: Path) -> ElementTree.Element:
    """The chunk with the most cameras."""
    data = read_bytes(path)
    # No program writes entities here, and those that grow when they are read are an attack.
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise unfit(path, "it declares a document type, as no camera file does")
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise unfit(path, f"no XML: {error}") from error
    chunks = [root] if root.tag == "chunk" else root.findall("./chunk")
    if not chunks:
        raise unfit(path, "it holds no chunk")
    return max(chunks, key=lambda chunk: len(chunk.findall("./cameras//camera/transform")))


def _cameras(chunk: ElementTree.Element) -> list[tuple[str, ElementTree.Element]]:
    """The cameras of a chunk, each with the name of its group, which may be empty."""
    group_of = {
        camera: group.get("label", "")
        for group in chunk.findall("./cameras//group")
        for camera in group.findall("./camera")
    }
    return [(group_of.get(camera, ""), camera) for camera in chunk.findall("./cameras//camera")]


def _lens(sensor: ElementTree.Element, path: Path) -> Lens | None:
    """The adjusted calibration of a sensor, else its initial one; None where it has none."""
    found = sensor.findall("calibration")
    calibration = next((item for item in found if item.get("class") == "adjusted"), found[0] if found else None)
    if calibration is None:
        return None
    what = f"sensor {sensor.get('label') or sensor.get('id')}"
    for kind in (sensor.get("type", _FRAME), calibration.get("type", _FRAME)):
        if kind != _FRAME:
            msg = (
                f"{path}: {what} is of the type {kind}, only frame cameras are read; in Metashape convert the images "
                "(Export > Convert Images) or undistort them, and export the cameras again"
            )
            raise SceneError(msg)
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    if resolution is None:
        raise unfit(path, f"{what} has no resolution")
    size = numbers([resolution.get("width"), resolution.get("height")], 2, path, f"the resolution of {what}")
    if calibration.find("f") is None:
        raise unfit(path, f"{what} has no focal length f; it was written by a version before 1.3")
    names = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
    given = [calibration.findtext(name) or "0" for name in names]
    f, cx, cy, b1, b2, k1, k2, k3, k4, p1, p2, p3, p4 = (
        float(v) for v in numbers(given, len(names), path, f"the calibration of {what}")
    )
    if p3 or p4:
        raise unfit(path, f"{what} has the coefficients p3 and p4; adjust it without them")
    return Lens(
        width=int(size[0]),
        height=int(size[1]),
        fx=f + b1,
        fy=f,
        cx=size[0] / 2 + cx - 0.5,
        cy=size[1] / 2 + cy - 0.5,
        skew=b2,
        radial=(k1, k2, k3, k4),
        # Metashape's p1 belongs to x, OpenCV's to y.
        tangential=(p2, p1),
    )


def _similarity(chunk: ElementTree.Element, component: str, path: Path) -> Floats | None:
    """(4, 4) from the chunk's own coordinates to metres; None where it has no scale."""
    found = chunk.find("transform")
    for item in chunk.findall("./components/component"):
        if item.get("id", "") == component and item.find("transform") is not None:
            found = item.find("transform")
    if found is None or found.find("scale") is None:
        return None
    scale = float(numbers(found.findtext("scale") or "", 1, path, "the scale of the chunk")[0])
    if not scale > 0:
        raise unfit(path, f"the scale of the chunk is {scale}")
    matrix = np.eye(4)
    rotation = found.findtext("rotation")
    if rotation is not None:
        matrix[:3, :3] = exact_rotation(
            numbers(rotation, 9, path, "the rotation of the chunk").reshape(3, 3), f"{path}, transform"
        )
    matrix[:3, :3] *= scale
    translation = found.findtext("translation")
    if translation is not None:
        matrix[:3, 3] = numbers(translation, 3, path, "the translation of the chunk")
    return matrix


def _on_the_ground(scene: ForeignScene) -> ForeignScene:
    """The scene with small coordinates, and with z up where it lies on the Earth's ellipsoid."""
    middle = np.median(centers_of(scene.photos), axis=0)
    if not (scene.metric and _EARTH_NEAR < np.linalg.norm(middle) < _EARTH_FAR):
        return near_origin(scene)
    up = middle / np.square(_HALF_AXES)
    up /= np.linalg.norm(up)
    east = np.cross([0.0, 0.0, 1.0], up)
    length = float(np.linalg.norm(east))
    east = east / length if length > 0 else np.array([1.0, 0.0, 0.0])
    local = np.eye(4)
    local[:3, :3] = np.stack([east, np.cross(up, east), up])
    return replace(moved(near_origin(scene), local), z_up=True)

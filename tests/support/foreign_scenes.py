"""One small scene with known cameras, written as the programs that fsinfer reads would write it.

The world is in metres, z up: a textured wall at y = 3, seen by cameras that walk along it. Photographs are rendered
through a lens whose distortion OpenCV computes. The writers follow the formats' descriptions, not the readers.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.io.images import write_image

Floats = NDArray[np.float64]

SIZE = (160, 120)
WALL_M = 3.0
VIEWS = 4
#: From a world with z up to ARKit's with y up, and the camera axes of OpenGL.
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
#: What a chunk of Metashape makes of its own coordinates: turned, scaled, far from the origin.
CHUNK_SCALE = 2.5


@dataclass(frozen=True, kw_only=True)
class TrueLens:
    """Pixel centres at integers; ``bent`` is OpenCV's k1, k2, p1, p2, k3, k4, k5, k6."""

    fx: float = 130.0
    fy: float = 130.0
    cx: float = 81.3
    cy: float = 58.9
    bent: tuple[float, ...] = ()

    @property
    def matrix(self) -> Floats:
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])


PINHOLE = TrueLens()
BROWN = TrueLens(bent=(-0.12, 0.05, 0.002, -0.003, 0.01))


@dataclass(frozen=True, kw_only=True)
class TruePhoto:
    name: str
    cam_from_world: Floats


@dataclass(frozen=True, kw_only=True)
class Truth:
    lens: TrueLens
    photos: tuple[TruePhoto, ...]
    points: Floats


def truth(lens: TrueLens = PINHOLE, views: int = VIEWS) -> Truth:
    """Cameras 0.3 m apart, each turned a little another way; points lie on the wall."""
    photos = []
    for index in range(views):
        degrees = [2.0 * index - 3.0, -4.0 + 2.5 * index, 1.5 * index]
        turn = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
        rotation = turn @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        center = np.array([0.3 * index, 0.05 * index**2 - 0.1, 1.4 + 0.02 * index])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
        photos.append(TruePhoto(name=f"IMG_{index:04d}", cam_from_world=pose))
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-1.5, 2.5, 900), np.full(900, WALL_M), rng.uniform(0.2, 2.8, 900)])
    return Truth(lens=lens, photos=tuple(photos), points=points)


def project(photo: TruePhoto, lens: TrueLens, points: Floats) -> tuple[Floats, Floats]:
    """Pixels (N, 2) and z depths (N,) by OpenCV."""
    rotation, _ = cv2.Rodrigues(photo.cam_from_world[:3, :3])
    bent = np.array([*lens.bent, *[0.0] * (8 - len(lens.bent))])
    pixels, _ = cv2.projectPoints(points, rotation, photo.cam_from_world[:3, 3], lens.matrix, bent)
    depth = np.asarray(points @ photo.cam_from_world[:3, :3].T + photo.cam_from_world[:3, 3])[:, 2]
    return np.asarray(pixels[:, 0], dtype=np.float64), depth


def visible(scene: Truth) -> list[NDArray[np.int64]]:
    """For each photo the points that it sees."""
    seen = []
    for photo in scene.photos:
        pixels, depth = project(photo, scene.lens, scene.points)
        inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels <= np.array(SIZE) - 1).all(axis=1)
        seen.append(np.flatnonzero(inside))
    return seen


def render(photo: TruePhoto, lens: TrueLens, size: tuple[int, int] = SIZE) -> NDArray[np.uint8]:
    """The wall as the photo shows it."""
    u, v = np.meshgrid(np.arange(size[0], dtype=np.float64), np.arange(size[1], dtype=np.float64))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    bent = np.array([*lens.bent, *[0.0] * (8 - len(lens.bent))])
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    rays = cv2.undistortPoints(pixels, lens.matrix, bent, criteria=criteria)[:, 0]
    rotation = photo.cam_from_world[:3, :3]
    center = -rotation.T @ photo.cam_from_world[:3, 3]
    directions = np.column_stack([rays, np.ones(len(rays))]) @ rotation
    on_wall = center + directions * ((WALL_M - center[1]) / directions[:, 1])[:, None]
    x = ((on_wall[:, 0] + 4.0) * 100).astype(np.float32).reshape(size[1], size[0])
    y = ((on_wall[:, 2] + 2.0) * 100).astype(np.float32).reshape(size[1], size[0])
    return np.asarray(cv2.remap(_texture(), x, y, cv2.INTER_LINEAR), dtype=np.uint8)


@cache
def _texture() -> NDArray[np.uint8]:
    rng = np.random.default_rng(11)
    image = np.full((800, 1000, 3), 128.0)
    for cell in (6, 14, 40):
        noise = rng.uniform(-1, 1, (800 // cell + 2, 1000 // cell + 2, 3)).astype(np.float32)
        image += 45 * cv2.resize(noise, (1000, 800), interpolation=cv2.INTER_CUBIC)
    return image.clip(0, 255).astype(np.uint8)


def write_photos(scene: Truth, folder: Path, names: Sequence[str] | None = None, suffix: str = ".png") -> None:
    for photo, name in zip(scene.photos, names or [p.name for p in scene.photos], strict=True):
        write_image(folder / f"{name}{suffix}", render(photo, scene.lens))


def world_from_cam(photo: TruePhoto) -> Floats:
    return np.asarray(np.linalg.inv(photo.cam_from_world), dtype=np.float64)


def quaternion(rotation: Floats) -> tuple[float, float, float, float]:
    """w, x, y, z."""
    x, y, z, w = (float(v) for v in Rotation.from_matrix(rotation).as_quat())
    return w, x, y, z


#: Parameters of each COLMAP model of a lens, with its number.
COLMAP_MODELS: dict[str, tuple[int, Callable[[TrueLens], list[float]]]] = {
    "SIMPLE_PINHOLE": (0, lambda lens: [lens.fx, lens.cx + 0.5, lens.cy + 0.5]),
    "PINHOLE": (1, lambda lens: [lens.fx, lens.fy, lens.cx + 0.5, lens.cy + 0.5]),
    "SIMPLE_RADIAL": (2, lambda lens: [lens.fx, lens.cx + 0.5, lens.cy + 0.5, *lens.bent[:1]]),
    "RADIAL": (3, lambda lens: [lens.fx, lens.cx + 0.5, lens.cy + 0.5, *lens.bent[:2]]),
    "OPENCV": (4, lambda lens: [lens.fx, lens.fy, lens.cx + 0.5, lens.cy + 0.5, *lens.bent[:4]]),
    "FULL_OPENCV": (6, lambda lens: [lens.fx, lens.fy, lens.cx + 0.5, lens.cy + 0.5, *lens.bent]),
}
#: A lens that each of them can say.
COLMAP_LENSES = {
    "SIMPLE_PINHOLE": PINHOLE,
    "PINHOLE": replace(PINHOLE, fy=128.0),
    "SIMPLE_RADIAL": replace(PINHOLE, bent=(-0.1,)),
    "RADIAL": replace(PINHOLE, bent=(-0.1, 0.04)),
    "OPENCV": replace(PINHOLE, fy=128.0, bent=(-0.1, 0.04, 0.002, -0.003)),
    "FULL_OPENCV": replace(PINHOLE, fy=128.0, bent=(-0.1, 0.04, 0.002, -0.003, 0.01, 0.02, -0.01, 0.003)),
}


def write_colmap(scene: Truth, model: Path, *, kind: str = "OPENCV", binary: bool = False) -> None:
    """``cameras``, ``images`` and ``points3D`` as COLMAP writes them; photographs are numbered from 3 on."""
    model.mkdir(parents=True, exist_ok=True)
    number, parameters = COLMAP_MODELS[kind]
    values = parameters(scene.lens)
    seen = visible(scene)
    if binary:
        cameras = struct.pack("<QiiQQ", 1, 7, number, *SIZE) + struct.pack(f"<{len(values)}d", *values)
        images = struct.pack("<Q", len(scene.photos))
        for index, photo in enumerate(scene.photos):
            pose = (*quaternion(photo.cam_from_world[:3, :3]), *photo.cam_from_world[:3, 3])
            images += struct.pack("<i7di", index + 3, *pose, 7) + f"{photo.name}.png".encode() + b"\0"
            pixels, _ = project(photo, scene.lens, scene.points[seen[index]])
            images += struct.pack("<Q", len(pixels))
            for (u, v), point in zip(pixels + 0.5, seen[index], strict=True):
                images += struct.pack("<ddq", u, v, int(point) + 10)
        points = struct.pack("<Q", len(scene.points))
        for rank, point in enumerate(scene.points):
            track = [(i + 3, int(np.searchsorted(seen[i], rank))) for i in range(len(seen)) if rank in seen[i]]
            points += struct.pack("<Q3d3BdQ", rank + 10, *point, 1, 2, 3, 0.4, len(track))
            points += b"".join(struct.pack("<II", *item) for item in track)
        for name, content in (("cameras", cameras), ("images", images), ("points3D", points)):
            (model / f"{name}.bin").write_bytes(content)
        return
    lines = ["# Camera list with one line of data per camera:", f"7 {kind} {SIZE[0]} {SIZE[1]} {_words(values)}"]
    (model / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lines = ["# Image list with two lines of data per image:"]
    for index, photo in enumerate(scene.photos):
        pose = (*quaternion(photo.cam_from_world[:3, :3]), *photo.cam_from_world[:3, 3])
        pixels, _ = project(photo, scene.lens, scene.points[seen[index]])
        lines.append(f"{index + 3} {_words(pose)} 7 {photo.name}.png")
        # A photo whose points are not told has an empty line.
        told = zip(pixels + 0.5, seen[index], strict=True) if index else ()
        lines.append(" ".join(f"{u} {v} {int(point) + 10}" for (u, v), point in told))
    (model / "images.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    lines = ["# 3D point list with one line of data per point:"]
    for rank, point in enumerate(scene.points):
        told_track = [f"{i + 3} {int(np.searchsorted(seen[i], rank))}" for i in range(len(seen)) if rank in seen[i]]
        lines.append(f"{rank + 10} {_words(point)} 1 2 3 0.4 {' '.join(told_track)}")
    (model / "points3D.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_openmvs(
    scene: Truth, path: Path, *, version: int = 7, normalized: bool = False, from_corner: bool = False
) -> None:
    """The interface format; the camera sits turned and shifted on its platform.

    ``from_corner``: normalized as newer versions of OpenMVS do it, from the corner of the picture and back by half.
    """
    mounted = Rotation.from_euler("xyz", [3.0, -2.0, 5.0], degrees=True).as_matrix()
    place = np.array([0.05, -0.02, 0.1])
    normalized = normalized or version == 0

    def text(value: str) -> bytes:
        return struct.pack("<Q", len(value.encode())) + value.encode()

    def reals(values: Any) -> bytes:
        return np.asarray(values, dtype="<f8").tobytes()

    matrix = scene.lens.matrix.copy()
    if normalized:
        matrix[:2] /= max(SIZE)
        matrix[:2, 2] += 0.5 / max(SIZE) - 0.5 if from_corner else 0.0
    data = b"MVSI" + struct.pack("<II", version, 0) + struct.pack("<Q", 1) + text("phone")
    data += struct.pack("<Q", 1) + text("main") + (text("RGB") if version > 3 else b"")
    data += struct.pack("<II", *((0, 0) if normalized else SIZE)) + reals(matrix) + reals(mounted) + reals(place)
    data += struct.pack("<Q", len(scene.photos))
    for photo in scene.photos:
        # x_cam = mounted (R (x - C) - place)
        rotation = mounted.T @ photo.cam_from_world[:3, :3]
        center = -photo.cam_from_world[:3, :3].T @ photo.cam_from_world[:3, 3] - rotation.T @ place
        data += reals(rotation) + reals(center)
    data += struct.pack("<Q", len(scene.photos) + 1)
    for index in range(len(scene.photos) + 1):
        last = index == len(scene.photos)
        data += text("images\\unplaced.png" if last else f"images/{scene.photos[index].name}.png")
        data += text("") if version > 4 else b""
        data += struct.pack("<III", 0, 0, 0xFFFFFFFF if last else index)
        data += struct.pack("<I", index) if version > 2 else b""
        if version > 6:
            data += struct.pack("<3fQ", 1.0, 2.0, 3.0, 1) + struct.pack("<II4f", 0, 5, 1.0, 0.1, 0.5, 2.0)
    seen = visible(scene)
    data += struct.pack("<Q", len(scene.points))
    for rank, point in enumerate(scene.points):
        views = [i for i in range(len(seen)) if rank in seen[i]]
        data += struct.pack("<3fQ", *point, len(views)) + b"".join(struct.pack("<If", i, 0.5) for i in views)
    data += struct.pack("<QQQQQ", 0, 0, 0, 0, 0) + reals(np.eye(4))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def write_metashape(
    scene: Truth, path: Path, *, world_from_truth: Floats | None = None, component: bool = True, scaled: bool = True
) -> None:
    """Exported cameras; ``world_from_truth`` is a rigid motion that puts the scene somewhere else, as on the Earth."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("xyz", [40.0, -15.0, 70.0], degrees=True).as_matrix()
    turn[:3, 3] = [3.0, -1.0, 2.0]
    world = np.eye(4) if world_from_truth is None else world_from_truth
    world_from_chunk = world @ np.linalg.inv(turn)  # then lengths in the chunk are divided by its scale
    lens = scene.lens
    k1, k2, p1, p2, k3 = (*lens.bent, *[0.0] * (5 - len(lens.bent)))[:5]
    # Metashape's p1 belongs to x; cx and cy count from the middle of the picture, whose corner is (0, 0).
    calibration = {
        "f": lens.fy, "cx": lens.cx + 0.5 - SIZE[0] / 2, "cy": lens.cy + 0.5 - SIZE[1] / 2, "b1": lens.fx - lens.fy,
        "k1": k1, "k2": k2, "k3": k3, "p1": p2, "p2": p1,
    }  # fmt: skip
    similarity = (
        f'<transform><rotation locked="true">{_words(world_from_chunk[:3, :3].ravel())}</rotation>'
        f'<translation locked="true">{_words(world_from_chunk[:3, 3])}</translation>'
        + (f'<scale locked="true">{CHUNK_SCALE!r}</scale>' if scaled else "")
        + "</transform>"
    )
    cameras = ""
    for index, photo in enumerate(scene.photos):
        chunk_from_cam = turn @ world_from_cam(photo)
        chunk_from_cam[:3, 3] /= CHUNK_SCALE
        cameras += (
            f'<camera id="{index}" sensor_id="4" component_id="0" label="{photo.name}">'
            f"<transform>{_words(chunk_from_cam.ravel())}</transform><orientation>1</orientation></camera>"
        )
    numbers = "".join(f"<{name}>{value!r}</{name}>" for name, value in calibration.items())
    initial = '<calibration type="frame" class="initial"><resolution width="9" height="9"/><f>5</f></calibration>'
    within = f'<components><component id="0" label="Component 1">{similarity}</component></components>'
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0"><chunk label="Chunk 1" enabled="true">'
        '<sensors next_id="5"><sensor id="4" label="unknown" type="frame">'
        f'<resolution width="{SIZE[0]}" height="{SIZE[1]}"/>{initial}'
        f'<calibration type="frame" class="adjusted"><resolution width="{SIZE[0]}" height="{SIZE[1]}"/>{numbers}'
        f"</calibration></sensor></sensors>{within if component else ''}"
        f'<cameras next_id="9"><group id="0" label="walk">{cameras}</group>'
        '<camera id="8" sensor_id="4" label="not aligned"><orientation>1</orientation></camera></cameras>'
        f"{'' if component else similarity}</chunk></document>",
        encoding="utf-8",
    )


def write_transforms(scene: Truth, path: Path, *, folder: str = "./images") -> None:
    lens = scene.lens
    k1, k2, p1, p2, k3 = (*lens.bent, *[0.0] * (5 - len(lens.bent)))[:5]
    content = {
        "camera_model": "OPENCV", "fl_x": lens.fx, "fl_y": lens.fy, "cx": lens.cx + 0.5, "cy": lens.cy + 0.5,
        "w": SIZE[0], "h": SIZE[1], "k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2,
        "frames": [
            {"file_path": f"{folder}/{photo.name}.png", "transform_matrix": (world_from_cam(photo) @ OPENGL).tolist()}
            for photo in scene.photos
        ],
    }  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content), encoding="utf-8")


def write_polycam(scene: Truth, folder: Path) -> None:
    write_photos(scene, folder / "keyframes" / "images", suffix=".jpg")
    (folder / "keyframes" / "cameras").mkdir(parents=True)
    for photo in scene.photos:
        matrix = Y_UP @ world_from_cam(photo) @ OPENGL
        lens = scene.lens
        values: dict[str, Any] = {f"t_{r}{c}": matrix[r, c] for r in range(3) for c in range(4)}
        values |= {"fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy, "width": SIZE[0], "height": SIZE[1]}
        (folder / "keyframes" / "cameras" / f"{photo.name}.json").write_text(json.dumps(values), encoding="utf-8")


def write_scanner_app(scene: Truth, folder: Path) -> None:
    folder.mkdir(parents=True)
    for index, photo in enumerate(scene.photos):
        write_image(folder / f"frame_{index:05d}.jpg", render(photo, scene.lens))
        values = {
            "cameraPoseARFrame": (Y_UP @ world_from_cam(photo) @ OPENGL).ravel().tolist(),
            "intrinsics": scene.lens.matrix.ravel().tolist(),
        }
        (folder / f"frame_{index:05d}.json").write_text(json.dumps(values), encoding="utf-8")
    # A frame with depth only, as most are.
    (folder / "frame_99999.json").write_text(json.dumps(values), encoding="utf-8")


def write_record3d(scene: Truth, folder: Path) -> None:
    write_photos(scene, folder / "rgb", [str(i) for i in range(len(scene.photos))], suffix=".jpg")
    poses = []
    for photo in scene.photos:
        matrix = world_from_cam(photo) @ OPENGL
        w, x, y, z = quaternion(matrix[:3, :3])
        poses.append([x, y, z, w, *matrix[:3, 3].tolist()])
    content = {"poses": poses, "K": scene.lens.matrix.T.ravel().tolist(), "w": SIZE[0], "h": SIZE[1], "fps": 60}
    (folder / "metadata.json").write_text(json.dumps(content), encoding="utf-8")


def write_rtabmap(scene: Truth, folder: Path) -> None:
    write_photos(scene, folder / "map_rgb", [str(i + 1) for i in range(len(scene.photos))], suffix=".jpg")
    (folder / "map_calib").mkdir()
    lens = scene.lens
    lines = ["#timestamp x y z qx qy qz qw id"]
    for index, photo in enumerate(scene.photos):
        matrix = world_from_cam(photo)
        w, x, y, z = quaternion(matrix[:3, :3])
        lines.append(f"1700000000.{index} {_words(matrix[:3, 3])} {_words([x, y, z, w])} {index + 1}")
        bent = [*lens.bent, *[0.0] * (5 - len(lens.bent))]
        matrix_words = ", ".join(map(repr, lens.matrix.ravel().tolist()))
        (folder / "map_calib" / f"{index + 1}.yaml").write_text(
            f'%YAML:1.0\n---\ncamera_name: "{index}"\nimage_width: {SIZE[0]}\nimage_height: {SIZE[1]}\n'
            f"camera_matrix:\n   rows: 3\n   cols: 3\n   data: [ {matrix_words} ]\n"
            f"distortion_coefficients:\n   rows: 1\n   cols: 5\n   data: [ {', '.join(map(repr, bent))} ]\n"
            "distortion_model: plumb_bob\n",
            encoding="utf-8",
        )
    lines.append("1700000009.0 0 0 0 0 0 0 1 99")  # a node without a photograph
    (folder / "map_camera_poses.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)

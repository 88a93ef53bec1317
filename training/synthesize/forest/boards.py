"""Scale targets: ArUco boards on posts and a red and white stick of exactly one metre."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.clutter import box
from training.synthesize.forest.material import Material, pyramid
from training.synthesize.forest.mesh import Mesh, make_mesh, tubes
from training.synthesize.forest.terrain import Terrain

#: Side of a board, metres. Source: the largest that fsinfer marker prints.
SIDE_M = 0.25
#: A 4X4 marker has 4 + 2 modules; one more white module on each side is the quiet zone that detectors need.
#: Source: OpenCV.
MODULES, MODULES_WITH_MARGIN = 6, 8
#: Texels of a module. Source: numerics.
MODULE_PX = 64
#: Length of the stick, metres. Source: judgement; what people put up.
STICK_M = 1.0


@dataclass(frozen=True, kw_only=True)
class Target:
    """Meshes of one target and its entry in markers.json."""

    meshes: list[Mesh]
    record: dict[str, Any]


def board_material(marker_id: int) -> Material:
    """The printed sheet of a 4X4_50 marker with a pale margin of one module; black is not quite black."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    marker = cv2.aruco.generateImageMarker(dictionary, marker_id, MODULES * MODULE_PX, borderBits=1)
    sheet = np.pad(marker, MODULE_PX, constant_values=255)
    # Matt grey paper: glaring white would be clipped by the sensor, and its edges would creep over the black.
    grey = (28 + (176 - 28) * (sheet > 127)).astype(np.uint8)
    side = SIDE_M * MODULES_WITH_MARGIN / MODULES
    # Mips end at 8 pixels a module, where module borders still fall on texel borders.
    return Material(levels=pyramid(np.dstack([grey] * 3))[:4], tile_m=side)


def stick_material() -> Material:
    """Bands of red and white, each half a tile high."""
    image = np.zeros((64, 64, 3), np.uint8)
    image[:32], image[32:] = (196, 36, 30), (226, 224, 218)
    return Material(levels=pyramid(image)[:4], tile_m=0.2)


def board_pair(
    terrain: Terrain,
    xy: NDArray[np.floating],
    facing_rad: float,
    ids: tuple[int, int],
    materials: tuple[int, int],
    wood: int,
    *,
    center_m: float = 1.25,
) -> list[Target]:
    """Two sheets back to back on a post at ``xy``, the first facing ``facing_rad`` and ``center_m`` up."""
    ground = float(terrain.height(xy[0], xy[1]))
    middle = np.array([xy[0], xy[1], ground + center_m])
    out = np.array([np.cos(facing_rad), np.sin(facing_rad), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    post_h = np.linspace(-0.2, center_m, 4)
    post = tubes(
        (np.array([xy[0], xy[1], ground]) + post_h[:, None] * up)[None],
        np.full((1, 4), 0.02),
        16,
        wood,
        tile_m=0.5,
        tint=(0.7, 0.6, 0.5),
    )
    half = SIDE_M * MODULES_WITH_MARGIN / MODULES / 2
    plate = box(middle, np.stack([out * 0.024, np.cross(up, out) * (half + 0.005), up * (half + 0.005)]), wood, 0.6)
    targets = []
    for number, (marker_id, material) in enumerate(zip(ids, materials, strict=True)):
        normal = out if number == 0 else -out
        right = np.cross(up, normal)  # to the right for one who looks at the sheet
        center = middle + normal * 0.025
        corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]], dtype=np.float64)  # TL, TR, BR, BL
        sheet = center + corners[:, :1] * right * half + corners[:, 1:] * up * half
        uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
        mesh = make_mesh(sheet, np.array([[0, 3, 2], [0, 2, 1]]), uv, material, normals=np.tile(normal, (4, 1)))
        black = center + (sheet - center) * MODULES / MODULES_WITH_MARGIN
        record = {"id": marker_id, "side_m": SIDE_M, "corners_world_m": black.round(6).tolist()}
        targets.append(Target(meshes=[mesh, post, plate] if number == 0 else [mesh], record=record))
    return targets


def stick(terrain: Terrain, xy: NDArray[np.floating], material: int, wood: int) -> Target:
    """A 1 m stick, 3 cm thick, standing upright on a spike."""
    ground = float(terrain.height(xy[0], xy[1]))
    low = np.array([xy[0], xy[1], ground + 0.08])
    h = np.array([0.0, 0.0, *np.linspace(0, STICK_M, 11), STICK_M])[1:]
    points = low + h[:, None] * np.array([0.0, 0.0, 1.0])
    radii = np.full(len(h), 0.015)
    radii[[0, -1]] = 1e-4  # flat, closed ends
    tangent_safe = points.copy()
    tangent_safe[0, 2] -= 1e-5
    tangent_safe[-1, 2] += 1e-5
    body = tubes(tangent_safe[None], radii[None], 24, material, tile_m=0.2)
    spike_z = np.array([-0.1, 0.04, 0.08])
    spike = tubes(
        (np.array([xy[0], xy[1], ground]) + spike_z[:, None] * np.array([0.0, 0.0, 1.0]))[None],
        np.array([[0.004, 0.004, 0.004]]),
        8,
        wood,
        tile_m=0.5,
        tint=(0.4, 0.4, 0.4),
    )
    ends = [low.round(6).tolist(), (low + np.array([0, 0, STICK_M])).round(6).tolist()]
    return Target(meshes=[body, spike], record={"length_m": STICK_M, "endpoints_world_m": ends})

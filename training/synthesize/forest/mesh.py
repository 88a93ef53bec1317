"""Triangle meshes with the attributes that the renderer needs, and the shapes everything is built of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Triangles in world metres (z up).

    Attributes
    ----------
    vertices, normals, tint: (N, 3) float32; ``tint`` multiplies the albedo.
    faces: (M, 3) int32. uv: (M, 3, 2) float32, one texture tile a unit. material: (M,) int32.
    """

    vertices: Floats
    faces: NDArray[np.int32]
    uv: Floats
    normals: Floats
    tint: Floats
    material: NDArray[np.int32]


def make_mesh(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    uv: NDArray[np.floating],
    material: int | NDArray[np.integer],
    *,
    tint: NDArray[np.floating] | Sequence[float] = (1.0, 1.0, 1.0),
    normals: NDArray[np.floating] | None = None,
) -> Mesh:
    """Build a mesh; ``uv`` is (N, 2) per vertex or (M, 3, 2) per corner; normals default to smooth ones."""
    corners = np.ascontiguousarray(vertices, dtype=np.float32)
    triangles = np.ascontiguousarray(faces, dtype=np.int32)
    corner_uv = uv[triangles] if uv.ndim == 2 else uv
    return Mesh(
        vertices=corners,
        faces=triangles,
        uv=np.ascontiguousarray(corner_uv, dtype=np.float32),
        normals=smooth_normals(corners, triangles) if normals is None else normals.astype(np.float32),
        tint=np.broadcast_to(np.asarray(tint, dtype=np.float32), corners.shape).copy(),
        material=np.broadcast_to(np.asarray(material, dtype=np.int32), (len(triangles),)).copy(),
    )


def smooth_normals(vertices: Floats, faces: NDArray[np.int32]) -> Floats:
    """Area-weighted vertex normals, (N, 3)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.empty_like(vertices)
    flat = faces.ravel()
    for axis in range(3):
        weights = np.repeat(face_normals[:, axis], 3)
        normals[:, axis] = np.bincount(flat, weights=weights, minlength=len(vertices))
    unit: Floats = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    return unit


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Concatenate meshes."""
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])[:-1]
    return Mesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        faces=np.concatenate([m.faces + int(o) for m, o in zip(meshes, offsets, strict=True)]).astype(np.int32),
        uv=np.concatenate([m.uv for m in meshes]),
        normals=np.concatenate([m.normals for m in meshes]),
        tint=np.concatenate([m.tint for m in meshes]),
        material=np.concatenate([m.material for m in meshes]),
    )


def grid_faces(rows: int, columns: int) -> NDArray[np.int32]:
    """Triangles of a (rows, columns) vertex grid, counter-clockwise seen from +z when x is the column axis."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])


def tubes(
    points: NDArray[np.floating],
    radii: NDArray[np.floating],
    sides: int,
    material: int,
    *,
    tile_m: float,
    tint: NDArray[np.floating] | Sequence[float] = (1.0, 1.0, 1.0),
) -> Mesh:
    """Build B tubes along polylines: points (B, S, 3), radii (B, S); seam vertices are double so that uv fits."""
    count, steps = radii.shape
    tangent = np.gradient(points, axis=1)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=-1, keepdims=True), 1e-9)
    helper = np.where(np.abs(tangent[:, :1, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    right = np.cross(np.broadcast_to(helper, tangent.shape), tangent)
    right /= np.maximum(np.linalg.norm(right, axis=-1, keepdims=True), 1e-9)
    up = np.cross(tangent, right)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.cos(angle)[:, None] * right[:, :, None] + np.sin(angle)[:, None] * up[:, :, None]
    vertices = points[:, :, None] + ring * radii[:, :, None, None]
    length = np.cumsum(np.linalg.norm(np.diff(points, axis=1, prepend=points[:, :1]), axis=-1), axis=1)
    around = np.maximum(1.0, np.round(2 * np.pi * radii.mean(1) / tile_m))[:, None, None] if sides > 12 else 1.0
    u = np.broadcast_to(angle / (2 * np.pi) * around, (count, steps, sides + 1))
    if sides <= 12:  # thin twigs show a strip of the tile, not all of it squeezed into a few millimetres
        u = u * np.clip(2 * np.pi * radii.mean(1) / tile_m, 0.02, 1.0)[:, None, None] * 1.0
    v = np.broadcast_to((length / tile_m)[:, :, None], u.shape) + np.arange(count)[:, None, None] * 0.37
    per_tube = steps * (sides + 1)
    faces = grid_faces(steps, sides + 1)[None] + (np.arange(count) * per_tube)[:, None, None]
    tint = np.asarray(tint, dtype=np.float32)
    if tint.ndim == 2:
        tint = np.repeat(tint, per_tube, axis=0)
    return make_mesh(
        vertices.reshape(-1, 3),
        faces.reshape(-1, 3),
        np.stack([u, v], -1).reshape(-1, 2),
        material,
        tint=tint,
        normals=ring.reshape(-1, 3),
    )


def quads(
    center: NDArray[np.floating],
    right: NDArray[np.floating],
    up: NDArray[np.floating],
    material: int | NDArray[np.integer],
    *,
    tint: NDArray[np.floating] | Sequence[float] = (1.0, 1.0, 1.0),
    normals: NDArray[np.floating] | None = None,
) -> Mesh:
    """Build n rectangles with half axes ``right`` and ``up`` (n, 3); each shows one whole texture tile."""
    count = len(center)
    corners = np.stack([center - right - up, center + right - up, center + right + up, center - right + up], 1)
    base = np.arange(count)[:, None, None] * 4
    faces = (np.array([[0, 1, 2], [0, 2, 3]])[None] + base).reshape(-1, 3)
    # The image's first row is v = 0, so the lower edge of the card gets v = 1.
    uv = np.tile(np.array([[0, 1], [1, 1], [1, 0], [0, 0]]) * 0.998 + 0.001, (count, 1))
    if normals is None:
        normals = np.cross(right, up)
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    ids = np.repeat(np.broadcast_to(np.asarray(material), (count,)), 2)
    tint = np.asarray(tint, dtype=np.float32)
    if tint.ndim == 2:
        tint = np.repeat(tint, 4, axis=0)
    return make_mesh(corners.reshape(-1, 3), faces, uv, ids, tint=tint, normals=np.repeat(normals, 4, axis=0))


def sphere_grid(rows: int, columns: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Unit directions (rows * columns, 3) on a latitude grid with a double seam, and their faces."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, rows)[:, None]
    longitude = np.linspace(0, 2 * np.pi, columns)[None]
    parts = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)]
    directions = np.stack([*parts, np.broadcast_to(np.sin(latitude), parts[0].shape)], -1)
    return directions.reshape(-1, 3), grid_faces(rows, columns)


def box_uv(vertices: NDArray[np.floating], faces: NDArray[np.integer], tile_m: float) -> NDArray[np.floating]:
    """Texture coordinates (M, 3, 2) by projecting each face along its dominant axis."""
    corners = vertices[faces]
    normal = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    axis = normal.argmax(1)
    keep = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    kept = np.take_along_axis(corners, np.broadcast_to(keep[:, None], (len(faces), 3, 2)), axis=2)
    uv: NDArray[np.floating] = kept / tile_m + axis[:, None, None] * 0.31
    return uv

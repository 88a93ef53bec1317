"""Write rendered views as an MVSNet scene with exact depth and truth tables."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.io.files import atomic_path, write_text
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.scene import Camera, write_camera, write_pairs
from training.synthesize.forest.stem import Section, Stem

#: Source: format; written last.
RECORD = "synth.json"


def with_depth_range(camera: Camera, depth: NDArray[np.float32], cap_m: float) -> Camera:
    """The camera with depth_min = 0.9 x the 1st percentile and depth_max = the 98th, at most ``cap_m``."""
    seen = depth[depth > 0]
    low, high = np.percentile(seen, [1, 98]) if len(seen) else (1.0, cap_m)
    low = 0.9 * float(low)
    return replace(camera, depth_min=low, depth_max=max(min(1.05 * float(high), cap_m), 1.5 * low))


def write_view(
    folder: Path, index: int, image: NDArray[np.uint8], depth: NDArray[np.float32], camera: Camera, quality: int
) -> None:
    """Write image (RGB), depth and camera of view ``index``."""
    name = f"{index:08d}"
    with atomic_path(folder / "images" / f"{name}.jpg") as path:
        cv2.imwrite(str(path), image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    write_pfm(folder / "depths" / f"{name}.pfm", depth)
    write_camera(folder / "cams" / f"{name}_cam.txt", camera)


def score_pairs(
    cameras: Sequence[Camera], depths: Sequence[NDArray[np.float32]], most: int = 10
) -> dict[int, list[tuple[int, float]]]:
    """Sources of each view, best first.

    The score sums over a coarse grid of points of the view that the source sees too (same depth within 3 %)
    a weight of the angle between both rays, as MVSNet does: best at 5 degrees, falling faster below than above.
    """
    points, valid = [], []
    for camera, depth in zip(cameras, depths, strict=True):
        rows, columns = (np.linspace(4, n - 5, k).astype(int) for n, k in zip(depth.shape, (12, 16), strict=True))
        v, u = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
        z = depth[v, u].astype(np.float64)
        rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera.intrinsic).T * z[:, None]
        points.append((rays - camera.cam_from_world[:3, 3]) @ camera.cam_from_world[:3, :3])
        valid.append(z > 0)
    centers = np.array([c.center for c in cameras])
    pairs = {}
    for i in range(len(cameras)):
        mine = points[i][valid[i]]
        reach = np.median(np.linalg.norm(mine - centers[i], axis=1)) if len(mine) else 1.0
        scores = []
        near = np.flatnonzero(np.linalg.norm(centers - centers[i], axis=1) < max(2.0, 1.2 * reach))
        for j in near.tolist():
            if j == i or len(mine) == 0:
                continue
            seen = mine @ cameras[j].cam_from_world[:3, :3].T + cameras[j].cam_from_world[:3, 3]
            z = np.maximum(seen[:, 2], 1e-6)
            pixel = np.round((seen / z[:, None]) @ cameras[j].intrinsic.T[:, :2]).astype(int)
            height, width = depths[j].shape
            inside = (seen[:, 2] > 0.1) & (pixel >= 0).all(1) & (pixel[:, 0] < width) & (pixel[:, 1] < height)
            at = pixel[inside]
            other = depths[j][at[:, 1], at[:, 0]]
            same = np.abs(other - z[inside]) < 0.03 * z[inside]
            a, b = mine[inside][same] - centers[i], mine[inside][same] - centers[j]
            cosine = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
            angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
            spread = np.where(angle < 5, 2.5, 10.0)
            scores.append((int(j), float(np.exp(-((angle - 5) ** 2) / (2 * spread**2)).sum())))
        scores.sort(key=lambda s: (-s[1], s[0]))
        pairs[i] = [s for s in scores if s[1] > 0.5][:most] or scores[:1]
    return pairs


def write_truth(path: Path, stems: Sequence[Stem], sections: Sequence[Section]) -> None:
    """Write the trees: x_m, y_m = centre of the section at breast height; dbh_cm = what a tape shows."""
    rows = ["tree_id,x_m,y_m,dbh_cm,dbh_area_cm,z_ground_m,lean_deg,height_m"]
    for number, (stem, section) in enumerate(zip(stems, sections, strict=True), 1):
        x, y = section.center[:2]
        rows.append(
            f"{number},{x:.4f},{y:.4f},{section.dbh_cm:.3f},{section.dbh_area_cm:.3f},"
            f"{stem.z_ground_m:.4f},{stem.lean_deg:.3f},{stem.height_m:.3f}"
        )
    write_text(path, "\n".join(rows) + "\n")


def write_truth_curves(path: Path, curves: Sequence[Sequence[tuple[float, float]]]) -> None:
    """Write the true stem curves of the trees 1, 2, ...: diameter_cm is what a tape shows."""
    rows = [f"{number},{height:.2f},{cm:.3f}" for number, curve in enumerate(curves, 1) for height, cm in curve]
    write_text(path, "\n".join(["tree_id,height_m,diameter_cm", *rows]) + "\n")


def view_written(folder: Path, index: int) -> bool:
    """Whether a view is complete, by this run or an earlier, interrupted one."""
    return (folder / "cams" / f"{index:08d}_cam.txt").is_file()  # write_view writes the camera last


def read_view_depth(folder: Path, index: int) -> NDArray[np.float32]:
    """Depth of a view that was written."""
    return read_pfm(folder / "depths" / f"{index:08d}.pfm")


def write_record(folder: Path, record: dict[str, Any], name: str = RECORD) -> None:
    """Write synth.json, the mark that the folder is finished, or another record of its kind."""
    write_text(folder / name, json.dumps(record, indent=1, default=str) + "\n")


def read_record(folder: Path, name: str = RECORD) -> dict[str, Any]:
    """What :func:`write_record` wrote, or another record of its kind; empty where there is none."""
    path = folder / name
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def finished(folder: Path) -> bool:
    """Whether ``folder`` holds a finished scene."""
    return (folder / RECORD).is_file()


def finish_scene(folder: Path, cameras: Sequence[Camera], depths: Sequence[NDArray[np.float32]]) -> None:
    """Write pair.txt."""
    write_pairs(folder / "pair.txt", score_pairs(cameras, depths))

"""Readers of scenes and depth maps."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from shutil import copytree
from tempfile import mkdtemp

import numpy as np

from tests.fuzz.lies import lie_in_counts
from tests.fuzz.mutators import change_bytes, change_head, change_json, change_text, cut
from tests.fuzz.reader import Reader


@cache
def _scene() -> Path:
    """A scene of three views with depth maps."""
    from fsinfer.io.pfm import write_pfm
    from fsinfer.scene import read_scene
    from tests.support.plane_scene import PLANE_DEPTH, write_plane_scene

    folder = write_plane_scene(Path(mkdtemp()) / "scene", height=36, width=40)
    scene = read_scene(folder)

    for view in scene.views:
        for part in ("depth", "confidence"):
            value = PLANE_DEPTH if part == "depth" else 1.0
            write_pfm(folder / part / f"{view.name}.pfm", np.full((18, 20), value, np.float32))
    grid = {"pixel_step_x": 2.0, "pixel_step_y": 2.0, "offset_x_px": 0.0, "offset_y_px": 0.0}
    index = {**grid, "width": 20, "height": 18, "model": "field", "views": {view.name: grid for view in scene.views}}
    (folder / "depth" / "depth.json").write_text(json.dumps(index), encoding="utf-8")
    spread = {view.name: {"center": 0.01, "direction_rad": 0.001} for view in scene.views}
    (folder / "poses.json").write_text(json.dumps({"photos": 3, "camera_std": spread}), encoding="utf-8")
    return folder


def _make(folder: Path) -> None:
    copytree(_scene(), folder, dirs_exist_ok=True)


def make_colmap(folder: Path) -> None:
    """A COLMAP model of two photographs and six points in ``folder/sparse``."""
    import pycolmap

    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 40.0, 40, 36)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    rng = np.random.default_rng(0)
    for number in (1, 2):
        points = pycolmap.Point2DList([pycolmap.Point2D(rng.uniform(0, 36, 2)) for _ in range(6)])
        image = pycolmap.Image(name=f"{number}.jpg", camera_id=1, image_id=number, points2D=points)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    for number in range(6):
        track = pycolmap.Track([pycolmap.TrackElement(1, number), pycolmap.TrackElement(2, number)])
        model.add_point3D(rng.uniform(0, 3, 3), track, np.zeros(3, np.uint8))
    (folder / "sparse").mkdir(parents=True)
    model.write_binary(folder / "sparse")


def _read_scene(folder: Path) -> None:
    from fsinfer.poses.adjustment.precision import read_camera_precisions
    from fsinfer.scene import read_scene, scene_digest

    scene_digest(read_scene(folder))
    read_camera_precisions(folder)


def _read_depth(folder: Path) -> None:
    from fsinfer.depth.maps import DepthMaps, read_depth_index
    from fsinfer.scene import read_scene

    maps = DepthMaps(read_scene(folder), folder)
    for index in maps.available:
        maps.get(index)
    read_depth_index(folder)


def _fuse(folder: Path) -> None:
    from fsinfer.fusion.fuse import FusionSettings, fuse
    from fsinfer.scene import read_scene

    fuse(read_scene(folder), folder, settings=FusionSettings())


def _read_colmap(folder: Path) -> None:
    from fsinfer.poses.sparse import read_sparse

    read_sparse(folder / "sparse")


READERS = (
    Reader(
        name="cams", what="cameras (cams/NAME_cam.txt)", make=_make, targets=("cams/*.txt",), read=_read_scene,
        mutators=(change_text, change_text, change_bytes, cut),
    ),
    Reader(
        name="pair", what="pair.txt", make=_make, targets=("pair.txt",), read=_read_scene,
        mutators=(change_text, change_text, change_bytes, cut),
    ),
    Reader(
        name="poses-json", what="poses.json", make=_make, targets=("poses.json",), read=_read_scene,
        mutators=(change_json, change_json, change_text, cut),
    ),
    Reader(
        name="pfm", what="PFM maps", make=_make, targets=("depth/*.pfm", "confidence/*.pfm"), read=_read_depth,
        mutators=(change_head(b"\n-1.0"), change_text, change_bytes, cut),
    ),
    Reader(
        name="depth-json", what="depth.json", make=_make, targets=("depth/depth.json",), read=_read_depth,
        mutators=(change_json, change_json, change_text, cut),
    ),
    Reader(
        name="fusion", what="scenes and depth maps, fused", make=_make, read=_fuse, most_mb=1024,
        targets=("cams/*.txt", "depth/*.pfm", "depth/depth.json", "pair.txt"), mutators=(change_text, change_bytes),
    ),
    Reader(
        name="colmap", what="COLMAP models", make=make_colmap, targets=("sparse/*.bin",), read=_read_colmap,
        mutators=(lie_in_counts, change_bytes, cut),
    ),
)  # fmt: skip

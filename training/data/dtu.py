"""The DTU data set as preprocessed for MVSNet (Yao et al., ECCV 2018): scans, splits and the training release.

The training release (``mvs_training/dtu``)::

    Cameras/pair.txt                              49 views, 10 sources each, the same for every scan
    Cameras/train/00000000_cam.txt                intrinsics of the 160x128 depth map, depth line "425.0 2.5" (mm)
    Rectified/scan1_train/rect_001_0_r5000.png    640x512; view + 1, then the light 0 … 6
    Depths/scan1_train/depth_map_0000.pfm         160x128, with depth_visual_0000.png: brighter than 10 = known
    Depths_raw/scan1/depth_map_0000.pfm           the same at 1600x1200, a separate archive; used where it is there

The test set is in plain MVSNet format (``scanN/images``, ``cams``, ``pair.txt``): :func:`fsinfer.scene.read_scene`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.io.pfm import read_pfm
from fsinfer.scene import Camera, Scene, View, read_camera, read_pairs
from training.data.true_scene import Split

Float32 = NDArray[np.float32]

# The split of Ji et al. (SurfaceNet, ICCV 2017), which MVSNet and all that follow it use.
TRAIN_SCANS: tuple[int, ...] = (
    2, 6, 7, 8, 14, 16, 18, 19, 20, 22, 30, 31, 36, 39, 41, 42, 44, 45, 46, 47, 50, 51, 52, 53, 55, 57, 58, 60, 61,
    63, 64, 65, 68, 69, 70, 71, 72, 74, 76, 83, 84, 85, 87, 88, 89, 90, 91, 92, 93, 94, 95, 96, 97, 98, 99, 100, 101,
    102, 103, 104, 105, 107, 108, 109, 111, 112, 113, 115, 116, 119, 120, 121, 122, 123, 124, 125, 126, 127, 128,
)  # fmt: skip
VALIDATION_SCANS: tuple[int, ...] = (3, 5, 17, 21, 28, 35, 37, 38, 40, 43, 56, 59, 66, 67, 82, 86, 106, 117)
TEST_SCANS: tuple[int, ...] = (
    1, 4, 9, 10, 11, 12, 13, 15, 23, 24, 29, 32, 33, 34, 48, 49, 62, 75, 77, 110, 114, 118,
)  # fmt: skip
SCANS: dict[Split, tuple[int, ...]] = {"train": TRAIN_SCANS, "validation": VALIDATION_SCANS, "test": TEST_SCANS}


@dataclass(frozen=True, kw_only=True)
class DtuFormat:
    """Constants of the release.

    Attributes
    ----------
    lights: light conditions of training; validation and test use ``all_lights_on`` alone, as MVSNet does.
    depth_factor: the photographs are so many times larger than the depth maps and the intrinsics of ``Cameras/train``.
    range_scale: MVSNet spreads its 192 planes over 1.06 times the interval in the camera files (425 to 931 mm
        instead of 902): the background of some scans lies behind the shorter range.
    mask_above: a pixel of ``depth_visual`` brighter than this has a depth.
    photo_shape: (height, width) of the photographs, cut from the middle of the halved 1600x1200 ones.
    max_step: quarter-size depths are joined by a surface where neighbours differ by less than this share.
    """

    lights: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 6)
    all_lights_on: int = 3
    depth_factor: int = 4
    range_scale: float = 1.06
    mask_above: int = 10
    photo_shape: tuple[int, int] = (512, 640)
    max_step: float = 0.01


FORMAT = DtuFormat()


@dataclass(frozen=True, kw_only=True)
class DtuScan:
    """One scan of the training release in one light."""

    root: Path
    scan: int
    light: int

    @property
    def name(self) -> str:
        """Scan and light, for messages."""
        return f"scan{self.scan} light {self.light}"

    def read(self) -> Scene:
        """All views of ``Cameras/pair.txt``; SceneError where a camera is missing."""
        folder = self.root / "Rectified" / f"scan{self.scan}_train"
        views = [
            View(
                name=f"{number:08d}",
                image_path=folder / f"rect_{number + 1:03d}_{self.light}_r5000.png",
                camera=camera,
                sources=sources,
            )
            for number, camera, sources in _rig(self.root)
        ]
        return Scene(folder=folder, views=tuple(views))

    def true_depth(self, view: View) -> Float32:
        """(512, 640) float32 mm, 0 outside of ``depth_visual`` and of the depth range; SceneError without a map."""
        number = int(view.name)
        for folder in (
            self.root / "Depths_raw" / f"scan{self.scan}",
            self.root / "Depths" / f"scan{self.scan}",
            self.root / "Depths" / f"scan{self.scan}_train",
        ):
            path = folder / f"depth_map_{number:04d}.pfm"
            if path.is_file():
                break
        else:
            msg = f"{path} is missing; unpack the depth maps of the DTU training set (Depths or Depths_raw) again"
            raise SceneError(msg)
        depth = _masked(path, folder / f"depth_visual_{number:04d}.png")
        height, width = FORMAT.photo_shape
        if depth.shape == (height // FORMAT.depth_factor, width // FORMAT.depth_factor):
            depth = spread(depth)
        elif depth.shape[0] // 2 >= height and depth.shape[1] // 2 >= width:
            depth = halved_and_cut(depth)
        else:
            msg = f"{path}: a DTU depth map has 160x128 or 1600x1200 pixels, not {depth.shape[1]}x{depth.shape[0]}"
            raise SceneError(msg)
        inside = (depth >= view.camera.depth_min) & (depth <= view.camera.depth_max)
        return np.where(inside, depth, np.float32(0))


def dtu_root(root: Path) -> Path | None:
    """The folder with ``Cameras/pair.txt`` and ``Rectified``: ``root`` or its ``dtu``; None where it is neither."""
    for folder in (root, root / "dtu"):
        if (folder / "Cameras" / "pair.txt").is_file() and (folder / "Rectified").is_dir():
            return folder
    return None


def dtu_scans(root: Path, split: Split) -> list[DtuScan]:
    """Scans of a split that are there, for training one for each light.

    Raises
    ------
    SceneError
        None of the split's scans is there.
    """
    lights = FORMAT.lights if split == "train" else (FORMAT.all_lights_on,)
    found = [
        DtuScan(root=root, scan=scan, light=light)
        for scan in SCANS[split]
        for light in lights
        if (root / "Rectified" / f"scan{scan}_train" / f"rect_001_{light}_r5000.png").is_file()
    ]
    if not found:
        first = ", ".join(f"scan{scan}_train" for scan in SCANS[split][:3])
        msg = f"{root / 'Rectified'} holds no scan of the {split} split ({first}, …); unpack the whole DTU training set"
        raise SceneError(msg)
    return found


@lru_cache(maxsize=8)
def _rig(root: Path) -> tuple[tuple[int, Camera, tuple[int, ...]], ...]:
    """Number, camera of the 640x512 photograph and ranks of the sources of each view; one robot, one rig for all."""
    pairs = read_pairs(root / "Cameras" / "pair.txt")
    rank = {number: i for i, number in enumerate(sorted(pairs))}
    rows = []
    for number in sorted(pairs):
        unknown = [s for s in pairs[number] if s not in rank]
        if unknown:
            msg = (
                f"{root / 'Cameras' / 'pair.txt'}: view {number} names sources {unknown} that have no entry themselves"
            )
            raise SceneError(msg)
        quarter = read_camera(root / "Cameras" / "train" / f"{number:08d}_cam.txt")
        near = quarter.depth_min
        camera = replace(
            quarter,
            intrinsic=np.diag([FORMAT.depth_factor, FORMAT.depth_factor, 1.0]) @ quarter.intrinsic,
            depth_max=near + FORMAT.range_scale * (quarter.depth_max - near),
        )
        rows.append((number, camera, tuple(rank[s] for s in pairs[number])))
    return tuple(rows)


def _masked(depth_path: Path, mask_path: Path) -> Float32:
    depth = np.nan_to_num(read_pfm(depth_path), nan=0.0, posinf=0.0, neginf=0.0)
    mask = cv2.imread(str(mask_path), cv2.IMREAD_GRAYSCALE) if mask_path.is_file() else None
    if mask is None or mask.shape != depth.shape:
        msg = f"{mask_path} is missing or not of the size of {depth_path.name}; unpack the depth archive again"
        raise SceneError(msg)
    return np.where(mask > FORMAT.mask_above, depth, np.float32(0))


def spread(depth: Float32) -> Float32:
    """Depth at every pixel of the photograph from a map with one value for every ``depth_factor``-th.

    Pixel (u, v) of the small map is pixel (4u, 4v) of the photograph, as the intrinsics are a quarter. In between a
    plane runs through the four neighbours, bilinear in 1/depth (which is linear in the image of a plane), where all
    four are known and close to each other; elsewhere the depth stays unknown. Returns (4 h, 4 w) float32.
    """
    factor = FORMAT.depth_factor
    height, width = depth.shape
    full = np.zeros((factor * height, factor * width), np.float32)
    corners = np.stack([depth[:-1, :-1], depth[:-1, 1:], depth[1:, :-1], depth[1:, 1:]])
    joined = (corners.min(axis=0) > 0) & (corners.max(axis=0) <= (1 + FORMAT.max_step) * corners.min(axis=0))
    inverse = 1 / np.where(joined, corners, np.float32(1))
    for dy in range(factor):
        for dx in range(factor):
            b, a = np.float32(dy / factor), np.float32(dx / factor)
            mean = (1 - b) * ((1 - a) * inverse[0] + a * inverse[1]) + b * ((1 - a) * inverse[2] + a * inverse[3])
            full[dy : factor * (height - 1) : factor, dx : factor * (width - 1) : factor] = np.where(
                joined, 1 / mean, np.float32(0)
            )
    full[::factor, ::factor] = depth
    return full


def halved_and_cut(depth: Float32) -> Float32:
    """Every second pixel of a 1600x1200 map, and of those the middle 640x512, as the photographs were made."""
    half = depth[::2, ::2]
    height, width = FORMAT.photo_shape
    top, left = (half.shape[0] - height) // 2, (half.shape[1] - width) // 2
    return np.ascontiguousarray(half[top : top + height, left : left + width])

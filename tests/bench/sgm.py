"""Depth maps by semi-global matching, a classic MVS to hold ours against: ``python -m tests.bench.sgm SCENE OUT``.

The photographs of SCENE with the cameras that ``fsinfer poses`` (or another program) gave them. Each is rectified with
the best two of its sources that stand beside it (Fusiello et al. 2000), matched by OpenCV's StereoSGBM
(Hirschmueller 2008: eight directions, both ways) and turned back. OUT/depth is what ``fsinfer fuse SCENE OUT`` reads.
For machines on which neither COLMAP's dense matcher (a GPU) nor OpenMVS can be had.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.io.pfm import write_pfm
from fsinfer.scene import Camera, Scene, View, read_scene, read_view_image

Float32 = NDArray[np.float32]
Floats = NDArray[np.float64]
#: Source photographs of each; more of them cost as much again each and add little.
SOURCES = 2
#: Sine of the least angle between the baseline and the optical axis: two photographs one behind the other cannot be
#: rectified.
LEAST_SIDEWAYS = 0.7
#: Sides of the rectified pictures over the longer side of the photograph, at most.
MOST_LARGER = 2.0
#: Disparities looked at, at most: a picture of 1280 pixels sees to 1.3 m with half a metre between the photographs.
MOST_DISPARITIES = 384
#: Blocks of five pixels, as in :mod:`tests.bench.stereo`.
BLOCK = 5
#: Two sources agree on a depth within this share of it; where both have one and do not, it is left open.
AGREE = 0.01


@dataclass(frozen=True, kw_only=True)
class Rectified:
    """Reference and source turned alike, with the source to the right: the pictures may be turned by any angle.

    ``from_reference``, ``from_source`` (3, 3) rotate the cameras' frames into the common one; ``intrinsic`` (3, 3) and
    ``size`` (width, height) are those of both pictures, which hold all of the reference; ``baseline`` in scene units.
    """

    from_reference: Floats
    from_source: Floats
    intrinsic: Floats
    size: tuple[int, int]
    baseline: float


def rectify(reference: Camera, source: Camera, size: tuple[int, int]) -> Rectified | None:
    """Common frame of two cameras of pictures of ``size``; ``None`` where one stands before the other."""
    towards = source.center - reference.center
    length = float(np.linalg.norm(towards))
    ahead = reference.cam_from_world[2, :3]
    x = towards / max(length, 1e-12)
    across = np.cross(ahead, x)
    if np.linalg.norm(across) < LEAST_SIDEWAYS:
        return None
    y = across / np.linalg.norm(across)
    common = np.stack([x, y, np.cross(x, y)])
    from_reference = common @ reference.cam_from_world[:3, :3].T
    focal = reference.intrinsic[0, 0]
    intrinsic = np.array([[focal, 0.0, 0.0], [0.0, focal, 0.0], [0.0, 0.0, 1.0]])
    width, height = size
    corners = np.array([[0, 0, 1], [width - 1, 0, 1], [0, height - 1, 1], [width - 1, height - 1, 1]], dtype=np.float64)
    there = corners @ np.linalg.inv(reference.intrinsic).T @ from_reference.T
    if there[:, 2].min() <= 0:
        return None
    pixels = (there / there[:, 2:]) @ intrinsic.T
    low, high = pixels[:, :2].min(axis=0), pixels[:, :2].max(axis=0)
    if ((high - low) > MOST_LARGER * max(size)).any():
        return None
    intrinsic[:2, 2] -= low
    return Rectified(
        from_reference=from_reference,
        from_source=common @ source.cam_from_world[:3, :3].T,
        intrinsic=intrinsic,
        size=(int(np.ceil(high[0] - low[0])) + 1, int(np.ceil(high[1] - low[1])) + 1),
        baseline=length,
    )


def match(images: tuple[NDArray[np.uint8], NDArray[np.uint8]], disparities: int) -> Float32:
    """Disparity (H, W) of the left of two rectified photographs, NaN where it is left open."""
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=disparities,
        blockSize=BLOCK,
        P1=8 * 3 * BLOCK**2,
        P2=32 * 3 * BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        speckleWindowSize=100,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    # SGBM cannot look beyond the left border: there a wider picture gives it room.
    left, right = (cv2.copyMakeBorder(image, 0, 0, disparities, 0, cv2.BORDER_REPLICATE) for image in images)
    found = matcher.compute(left, right)[:, disparities:].astype(np.float32) / 16
    return np.where(found > 0, found, np.float32(np.nan))


def depth_of_pair(images: tuple[NDArray[np.uint8], NDArray[np.uint8]], cameras: tuple[Camera, Camera]) -> Float32:
    """z depth (H, W) of the first photograph from the second, NaN where it is left open."""
    reference, source = cameras
    height, width = images[0].shape[:2]
    rectified = rectify(reference, source, (width, height))
    if rectified is None:
        return np.full((height, width), np.nan, np.float32)
    turned = []
    for image, camera, rotation in zip(images, cameras, (rectified.from_reference, rectified.from_source), strict=True):
        homography = rectified.intrinsic @ rotation @ np.linalg.inv(camera.intrinsic)
        picture = cv2.warpPerspective(image, homography, rectified.size, flags=cv2.INTER_LINEAR)
        turned.append(np.asarray(picture, dtype=np.uint8))
    scale = rectified.baseline * rectified.intrinsic[0, 0]
    needed = 16 * int(np.ceil((scale / reference.depth_min + 1) / 16))
    disparity = match((turned[0], turned[1]), min(needed, MOST_DISPARITIES))
    # Back: where each pixel of the reference lies in the rectified picture, and how long its ray is there.
    v, u = np.mgrid[:height, :width].astype(np.float64)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(reference.intrinsic).T
    there = rays @ rectified.from_reference.T
    place = there @ rectified.intrinsic.T
    x, y = (np.asarray(place[..., i] / place[..., 2], dtype=np.float32) for i in (0, 1))
    found = cv2.remap(disparity, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan)
    # A ray of z = 1 here has z = there_z in the rectified frame: depth there is scale / disparity.
    return np.asarray(scale / found / there[..., 2], dtype=np.float32)


def depth_of_view(scene: Scene, view: View) -> Float32:
    """z depth (H, W) of a photograph, 0 where no source gives one or two contradict each other."""
    image = read_view_image(view)
    maps: list[Float32] = []
    for index in view.sources:
        source = scene.views[index]
        if rectify(view.camera, source.camera, (image.shape[1], image.shape[0])) is not None:
            maps.append(depth_of_pair((image, read_view_image(source)), (view.camera, source.camera)))
        if len(maps) == SOURCES:
            break
    if not maps:
        return np.zeros(image.shape[:2], np.float32)
    depth = maps[0]
    for more in maps[1:]:
        both = np.isfinite(depth) & np.isfinite(more)
        apart = both & (np.abs(depth - more) > AGREE * depth)
        depth = np.where(np.isfinite(depth), depth, more)
        depth[apart] = np.nan
    inside = (depth > view.camera.depth_min) & (depth < view.camera.depth_max)
    return np.where(inside, depth, np.float32(0))


def main(argv: list[str] | None = None) -> int:
    """Match every photograph of a scene."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.sgm", description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("out", type=Path)
    args = parser.parse_args(argv)
    scene = read_scene(args.scene)
    folder = args.out / "depth"
    folder.mkdir(parents=True, exist_ok=True)
    for done, view in enumerate(scene.views, 1):
        depth = depth_of_view(scene, view)
        write_pfm(folder / f"{view.name}.pfm", depth)
        print(f"{done}/{len(scene.views)} {view.name}: {100 * float((depth > 0).mean()):.0f} %", flush=True)
    (folder / "depth.json").write_text(json.dumps({"pixel_step": 1.0}), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

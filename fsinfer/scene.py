"""The scene folder in MVSNet format: ``images/NAME.jpg``, ``cams/NAME_cam.txt``, ``pair.txt``.

BlendedMVS has the same files as ``blended_images/NAME.jpg`` and ``cams/pair.txt``, which is read as well.

Frames: world to camera is ``x_cam = R x_world + t`` with x right, y down, z forward; pixel centres lie at
integer coordinates, so the centre of the top left pixel is (0, 0).

A camera belongs to the pixels as the file stores them. COLMAP's undistorter and others leave an EXIF orientation in
images that they did not turn, so whoever looks into a scene's images reads them by :func:`read_view_image`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.io.digest import file_digest
from fsinfer.io.files import is_by_system, write_text
from fsinfer.io.images import image_size, is_turned, read_image

#: Planes of a camera file that tells no number. Source: format; MVSNet (Yao et al. 2018).
DEPTH_PLANES = 192
#: What rows of a rotation may differ from being of length one and at right angles. Source: judgement; matrices that
#: were written with three digits.
_MOST_SKEW = 0.02
#: Depth that stands for none where a point lies in the plane of the camera. Source: numerics.
_LEAST_DEPTH = 1e-12
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".JPG", ".JPEG", ".PNG")


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera with its pose and the depth range that its view needs.

    Attributes
    ----------
    intrinsic: (3, 3) float64, pixels.
    cam_from_world: (4, 4) float64, scene units.
    depth_min, depth_max: z depth, scene units, ``0 < depth_min < depth_max``.
    """

    intrinsic: NDArray[np.float64]
    cam_from_world: NDArray[np.float64]
    depth_min: float
    depth_max: float

    @property
    def center(self) -> NDArray[np.float64]:
        """(3,) camera centre in world coordinates."""
        return np.asarray(-self.cam_from_world[:3, :3].T @ self.cam_from_world[:3, 3])


@dataclass(frozen=True, kw_only=True)
class View:
    """One photograph of a scene (:func:`read_view_image`). ``sources`` are indices into ``Scene.views``, best first."""

    name: str
    image_path: Path
    camera: Camera
    sources: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """All views of a scene folder; ``views[i]`` is the view that ``pair.txt`` calls ``i``."""

    folder: Path
    views: tuple[View, ...]


def read_view_image(view: View) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB of a view, the pixels of its camera: whatever EXIF says of how to hold them.

    Raises :class:`fsinfer.errors.ImageError` as :func:`fsinfer.io.images.read_image` does.
    """
    return read_image(view.image_path, upright=False)


def view_image_size(view: View) -> tuple[int, int]:
    """(width, height) of :func:`read_view_image`, from the header alone."""
    return image_size(view.image_path, upright=False)


def project(
    points: NDArray[np.float64], camera: Camera, intrinsic: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixel positions (..., 2) and z depths (...) of scene points (..., 3) in the photograph.

    ``intrinsic`` (3, 3) takes the place of the camera's, for a picture of another size such as the depth map. Pixels
    of points that are not before the camera mean nothing.
    """
    in_camera = points @ camera.cam_from_world[:3, :3].T + camera.cam_from_world[:3, 3]
    depth = in_camera[..., 2]
    homogeneous = in_camera @ (camera.intrinsic if intrinsic is None else intrinsic).T
    return homogeneous[..., :2] / np.where(np.abs(depth) < _LEAST_DEPTH, _LEAST_DEPTH, depth)[..., None], np.asarray(
        depth
    )


def in_picture(pixels: NDArray[np.float64], depth: NDArray[np.float64], size: tuple[float, float]) -> NDArray[np.bool_]:
    """Which of what :func:`project` gave, (..., 2) and (...), is before the camera and in a picture of (width, height).

    A picture ends half a pixel beyond the centres of its outer pixels.
    """
    within = (pixels >= -0.5).all(axis=-1) & (pixels < np.array(size) - 0.5).all(axis=-1)
    return np.asarray(within & (depth > 0))


def read_camera(path: Path | str) -> Camera:
    """Read ``NAME_cam.txt``: extrinsic 4x4, intrinsic 3x3, ``depth_min interval [planes [depth_max]]``.

    Without ``depth_max`` it is ``depth_min + interval * (planes - 1)``, with 192 planes where that number is
    missing too (the convention of the MVSNet releases).
    """
    path = Path(path)
    try:
        tokens = path.read_text(encoding="utf-8").split()
        start, middle = tokens.index("extrinsic") + 1, tokens.index("intrinsic") + 1
        cam_from_world = np.array([float(t) for t in tokens[start : start + 16]]).reshape(4, 4)
        intrinsic = np.array([float(t) for t in tokens[middle : middle + 9]]).reshape(3, 3)
        depths = [float(t) for t in tokens[middle + 9 : middle + 13]]
        depth_min, interval = depths[:2]
    except (OSError, ValueError, UnicodeDecodeError) as error:
        msg = f"{path} is not a camera file in MVSNet format ({error}); write the scene again"
        raise SceneError(msg) from error
    planes = depths[2] if len(depths) > 2 else DEPTH_PLANES
    depth_max = depths[3] if len(depths) > 3 else depth_min + interval * (planes - 1)
    finite = np.isfinite([*cam_from_world.flat, *intrinsic.flat, depth_min, depth_max]).all()
    if not (finite and 0 < depth_min < depth_max and intrinsic[0, 0] > 0 and intrinsic[1, 1] > 0):
        msg = f"{path}: needs 0 < depth_min < depth_max and finite numbers, has {depth_min=}, {depth_max=}"
        raise SceneError(msg)
    rotation = cam_from_world[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > _MOST_SKEW or np.linalg.det(rotation) < 0:
        msg = f"{path}: the first three columns of its extrinsic are no rotation; write the scene again"
        raise SceneError(msg)
    rows = np.abs(cam_from_world[3] - [0, 0, 0, 1]).max(), np.abs(intrinsic[2] - [0, 0, 1]).max()
    if max(rows) > _MOST_SKEW or not np.linalg.det(intrinsic) > _LEAST_DEPTH:
        msg = f"{path}: the last row of a matrix is not 0 0 1, or its intrinsic has no inverse; write the scene again"
        raise SceneError(msg)
    return Camera(intrinsic=intrinsic, cam_from_world=cam_from_world, depth_min=depth_min, depth_max=depth_max)


def write_camera(path: Path | str, camera: Camera) -> None:
    """Write ``NAME_cam.txt`` with the four-number depth line."""
    rows = ["extrinsic", *(" ".join(f"{v:.12g}" for v in row) for row in camera.cam_from_world), "", "intrinsic"]
    rows += [" ".join(f"{v:.12g}" for v in row) for row in camera.intrinsic]
    interval = (camera.depth_max - camera.depth_min) / (DEPTH_PLANES - 1)
    rows += ["", f"{camera.depth_min:.9g} {interval:.9g} {DEPTH_PLANES} {camera.depth_max:.9g}", ""]
    write_text(Path(path), "\n".join(rows))


def read_pairs(path: Path | str) -> dict[int, list[int]]:
    """Read ``pair.txt`` into ``{view: [source, ...]}``, best source first."""
    path = Path(path)
    try:
        tokens = path.read_text(encoding="utf-8").split()
        count, position, pairs = int(tokens[0]), 1, {}
        for _ in range(count):
            view, sources = int(tokens[position]), int(tokens[position + 1])
            pairs[view] = [int(t) for t in tokens[position + 2 : position + 2 + 2 * sources : 2]]
            if len(pairs[view]) != sources:
                raise IndexError
            position += 2 + 2 * sources
    except (OSError, ValueError, IndexError, UnicodeDecodeError) as error:
        msg = f"{path} is not a pair list in MVSNet format ({error}); write the scene again"
        raise SceneError(msg) from error
    return pairs


def write_pairs(path: Path | str, pairs: dict[int, list[tuple[int, float]]]) -> None:
    """Write ``pair.txt`` from ``{view: [(source, score), ...]}``."""
    rows = [str(len(pairs))]
    for view, scored in sorted(pairs.items()):
        rows += [str(view), " ".join([str(len(scored)), *(f"{i} {score:.3f}" for i, score in scored)])]
    write_text(Path(path), "\n".join(rows) + "\n")


def read_scene(folder: Path | str) -> Scene:
    """Read a scene folder; views are the sorted names in ``cams`` (their rank is the number in ``pair.txt``).

    Raises
    ------
    SceneError
        A part is missing, an image has no camera or a pair list names a view that is not there.
    """
    folder = Path(folder)
    if not folder.is_dir():
        msg = f"{folder} is not a folder; give a scene with images/, cams/ and pair.txt (see: fsinfer poses)"
        raise SceneError(msg)
    files = (p.name for p in (folder / "cams").glob("*_cam.txt") if not is_by_system(p.name))
    names = sorted(name.removesuffix("_cam.txt") for name in files)
    if not names:
        msg = (
            f"{folder / 'cams'} holds no NAME_cam.txt; make a scene of your photos with: fsinfer poses, or give the "
            "scene of a program that fsinfer depth knows (COLMAP, OpenMVS, Metashape, nerfstudio and others)"
        )
        raise SceneError(msg)
    pair_path = _either(folder / "pair.txt", folder / "cams" / "pair.txt")
    images = _either(folder / "images", folder / "blended_images")
    pairs = read_pairs(pair_path)
    views = []
    for index, name in enumerate(names):
        candidates = [images / f"{name}{suffix}" for suffix in IMAGE_SUFFIXES]
        image_path = next((p for p in candidates if p.is_file()), None)
        if image_path is None:
            msg = f"{images} has no image for {name}_cam.txt; add it or delete the camera"
            raise SceneError(msg)
        sources = tuple(pairs.get(index, ()))
        if any(not 0 <= s < len(names) or s == index for s in sources):
            msg = (
                f"{pair_path}: view {index} names sources {sources}, but there are {len(names)} views, numbered from "
                f"0 in the order of the camera files' names{_without_camera(images, names)}"
            )
            raise SceneError(msg)
        camera = read_camera(folder / "cams" / f"{name}_cam.txt")
        views.append(View(name=name, image_path=image_path, camera=camera, sources=sources))
    return Scene(folder=folder, views=tuple(views))


def _without_camera(images: Path, names: Sequence[str]) -> str:
    """Images that have no camera, said behind an error that such a one explains; empty where there are none."""
    alone = sorted({path.name for path in images.glob("*") if path.suffix in IMAGE_SUFFIXES and path.stem not in names})
    shown = ", ".join(alone[:5]) + (", ..." if len(alone) > 5 else "")
    return f"; images without a camera file: {shown}" if alone else ""


def _either(usual: Path, of_blendedmvs: Path) -> Path:
    return of_blendedmvs if of_blendedmvs.exists() and not usual.exists() else usual


def scene_digest(scene: Scene) -> str:
    """Digest of what depth and fusion read of a scene: its photographs, cameras, depth ranges and sources."""
    digest = hashlib.sha256()
    for view in scene.views:
        camera = view.camera
        digest.update(f"{view.name} {file_digest(view.image_path)} {view.sources} ".encode())
        digest.update(camera.intrinsic.tobytes() + camera.cam_from_world.tobytes())
        digest.update(np.array([camera.depth_min, camera.depth_max]).tobytes())
        if is_turned(view.image_path):
            # Such images were turned once: what was computed of them then is not to be found again.
            digest.update(b" stored pixels")
    return digest.hexdigest()[:24]

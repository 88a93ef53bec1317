"""Eight small photographs of two textured planes, rendered by homography, with exact cameras."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

SIZE = (480, 360)
FOCAL_PX = 420.0
VIEWS = 8


def texture(seed: int, size: int = 900) -> NDArray[np.uint8]:
    """Blobs of every size, so that SIFT finds a thousand features."""
    rng = np.random.default_rng(seed)
    image = np.full((size, size, 3), 128.0)
    for cell in (4, 9, 20, 50):
        noise = rng.uniform(-1, 1, (size // cell + 2, size // cell + 2, 3)).astype(np.float32)
        image += 45 * cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
    return image.clip(0, 255).astype(np.uint8)


def intrinsic() -> NDArray[np.float64]:
    return np.array([[FOCAL_PX, 0, (SIZE[0] - 1) / 2], [0, FOCAL_PX, (SIZE[1] - 1) / 2], [0, 0, 1]])


def look_at(center: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) cam_from_world, x right, y down, z forward; the world's y points down."""
    forward = (target - center) / np.linalg.norm(target - center)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ center
    return pose


def poses(views: int = VIEWS) -> list[NDArray[np.float64]]:
    """On an arc in front of the planes, at uneven height."""
    result = []
    for index in range(views):
        x = -1.2 + 2.4 * index / max(1, views - 1)
        center = np.array([x, 0.25 * np.sin(2.0 * index), -3.2 + 0.25 * x * x])
        result.append(look_at(center, np.array([0.15 * x, 0.0, 0.0])))
    return result


# Planes: origin and the two edge vectors over which the texture is spread.
WALL = (np.array([-2.0, -2.0, 0.3]), np.array([4.0, 0.0, 0.0]), np.array([0.0, 4.0, 0.0]))
FLOOR = (np.array([-1.5, 0.5, 0.3]), np.array([3.0, 0.0, 0.0]), np.array([0.0, 0.45, -1.8]))


def draw(
    image: NDArray[np.uint8],
    pose: NDArray[np.float64],
    plane: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    picture: NDArray[np.uint8],
    matrix: NDArray[np.float64] | None = None,
) -> NDArray[np.uint8]:
    """Paint ``picture`` (its outer pixel edges on the plane's edges) over ``image``, three times supersampled."""
    matrix = intrinsic() if matrix is None else matrix
    origin, across, down = plane
    height, width = picture.shape[:2]
    # Pixel centre (i, j) of the picture lies at share (i + 0.5) / width of the edge.
    plane_from_picture = np.array([[1 / width, 0, 0.5 / width], [0, 1 / height, 0.5 / height], [0, 0, 1]])
    world_from_plane = np.column_stack([across, down, origin])
    cam = pose[:3, :3] @ world_from_plane + np.outer(pose[:3, 3], [0, 0, 1])
    fine = np.array([[3.0, 0, 1.0], [0, 3.0, 1.0], [0, 0, 1]])  # image pixel (u, v) is fine pixel (3u + 1, 3v + 1)
    homography = fine @ matrix @ cam @ plane_from_picture
    size = (3 * image.shape[1], 3 * image.shape[0])
    painted = cv2.warpPerspective(picture, homography, size, flags=cv2.INTER_LINEAR)
    cover = cv2.warpPerspective(np.full(picture.shape[:2], 255, np.uint8), homography, size, flags=cv2.INTER_NEAREST)
    big = cv2.resize(image, size, interpolation=cv2.INTER_NEAREST)
    big[cover > 0] = painted[cover > 0]
    return np.asarray(cv2.resize(big, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def photographs(views: int = VIEWS, seed: int = 0) -> list[NDArray[np.uint8]]:
    result = []
    for pose in poses(views):
        image = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
        image = draw(image, pose, WALL, texture(seed))
        result.append(draw(image, pose, FLOOR, texture(seed + 1)))
    return result

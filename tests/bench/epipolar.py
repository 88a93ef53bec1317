"""How far corners that no adjustment used lie off their epipolar lines, in the images of a scene.

python -m tests.bench.epipolar SCENE

For photographs whose cameras nobody knows: corners of each image are followed into its first sources and back (pyramids
of Lucas and Kanade), and the distance from the lines that the scene's cameras give is told. SCENE is a folder of
``fsinfer poses``; two scenes of the same photographs are compared by it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.io.images import luminance
from fsinfer.scene import Camera, read_scene, read_view_image
from tests.bench.results import add_result_options, check_result_options, save_result

Floats = NDArray[np.float64]
#: Corners of an image at most, their least quality and distance, pixels.
MOST, QUALITY, APART_PX = 1500, 0.01, 8.0
#: Followed there and back, a corner is this near to where it began, pixels.
BACK_PX = 0.15
#: Beyond this the corner was mistaken, pixels.
WRONG_PX = 3.0


def fundamental(one: Camera, other: Camera) -> Floats:
    """(3, 3) F: x_other^T F x_one = 0 of pixels whose centres are at integers, as the cameras' are."""
    relative = other.cam_from_world @ np.linalg.inv(one.cam_from_world)
    x, y, z = relative[:3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.linalg.inv(other.intrinsic).T @ cross @ relative[:3, :3] @ np.linalg.inv(one.intrinsic))


def off_their_lines(matrix: Floats, one: Floats, other: Floats) -> Floats:
    """(n,) distances of (n, 2) pixels of the other image from the epipolar lines of those of the one."""
    lines = np.column_stack([one, np.ones(len(one))]) @ matrix.T
    return np.asarray(
        np.abs((np.column_stack([other, np.ones(len(other))]) * lines).sum(1)) / np.hypot(*lines[:, :2].T)
    )


def followed(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> tuple[Floats, Floats]:
    """Corners of the one image and where the other shows them, of those that come back."""
    corners: NDArray[np.float32] | None = cv2.goodFeaturesToTrack(one, MOST, QUALITY, APART_PX)  # type: ignore[assignment]
    if corners is None:
        return np.empty((0, 2)), np.empty((0, 2))
    there, found = _follow(one, other, corners)
    back, found_back = _follow(other, one, there)
    kept = found & found_back & (np.linalg.norm((back - corners)[:, 0], axis=1) < BACK_PX)
    return corners[kept, 0].astype(np.float64), there[kept, 0].astype(np.float64)


def _follow(
    one: NDArray[np.uint8], other: NDArray[np.uint8], corners: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(n, 1, 2) where the other image shows (n, 1, 2) pixels of the one, and (n,) whether it does."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(one, other, corners, np.empty_like(corners), None, None, (15, 15), 5)
    return np.asarray(there, dtype=np.float32), np.asarray(found)[:, 0] > 0


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.epipolar", description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--sources", type=int, default=3, help="of each view")
    add_result_options(parser)
    arguments = parser.parse_args(argv)
    check_result_options(parser, arguments)
    scene = read_scene(arguments.scene)
    grey = [luminance(read_view_image(view)) for view in scene.views]
    off = []
    for number, view in enumerate(scene.views):
        for source in view.sources[: arguments.sources]:
            if grey[number].shape != grey[source].shape:
                continue  # what follows corners asks for it
            one, other = followed(grey[number], grey[source])
            off.append(off_their_lines(fundamental(view.camera, scene.views[source].camera), one, other))
    distances = np.concatenate(off)
    right = distances[distances < WRONG_PX]
    figures = {
        "pairs": len(off),
        "corners": len(distances),
        "median_px": float(np.median(right)),
        "p80_px": float(np.percentile(right, 80)),
        "within_half_px_percent": 100 * float((right < 0.5).mean()),
        "mistaken_percent": 100 * float((distances >= WRONG_PX).mean()),
    }
    print(
        f"{figures['corners']} corners of {figures['pairs']} pairs: {figures['median_px']:.3f} px off their lines "
        f"(median), 80 % within {figures['p80_px']:.3f} px, {figures['within_half_px_percent']:.1f} % within half a "
        f"pixel; {figures['mistaken_percent']:.1f} % mistaken"
    )
    save_result(arguments, figures, module="tests.bench.epipolar", arguments=argv)


if __name__ == "__main__":
    main()

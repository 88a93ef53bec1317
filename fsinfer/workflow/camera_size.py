"""Cameras of a scene folder that belong to pictures of another size, told before depth is computed with them."""

from __future__ import annotations

from fsinfer.errors import SceneError
from fsinfer.output.layout import CAMERAS_FOLDER
from fsinfer.scene import Scene, view_image_size

#: A lens looks at the middle of its picture: farther from it than this share of the width or the height, or than the
#: lesser share of both, its principal point is that of another size. Source: judgement; pictures that were cropped
#: to less than half of one side have it elsewhere, and cameras for pictures of half the size have it at a quarter.
_OFF_MIDDLE, _OFF_MIDDLE_OF_BOTH = 0.25, 0.2
#: Within this share of the middle of a picture that is as high as this one is wide, and as wide as it is high, it is of
#: one that was turned since; those of squares look alike. Source: judgement; lenses miss it by a hundredth or two.
_TURNED, _NO_SQUARE = 0.03, 1.15


def refuse_cameras_of_other_size(scene: Scene) -> None:
    """Refuse a scene whose principal points lie nowhere near the middle of the pictures.

    Some releases in MVSNet format have cameras for pictures of a quarter of the size, which is not told anywhere. And
    pictures that were turned upright after they were placed have a principal point that may pass for that of a crop.

    Raises
    ------
    SceneError
        Names the first such camera, and the size that it would fit.
    ImageError
        A picture cannot be read.
    """
    for view in scene.views:
        width, height = view_image_size(view)
        # The centre of the top left pixel is (0, 0).
        across, down = view.camera.intrinsic[0, 2] + 0.5, view.camera.intrinsic[1, 2] + 0.5
        if _is_turned(across, down, width, height):
            msg = (
                f"{scene.folder / CAMERAS_FOLDER / f'{view.name}_cam.txt'}: its principal point ({across:.0f}, "
                f"{down:.0f}) is the middle of a picture of {height}x{width} pixels, and {view.image_path.name} has "
                f"{width}x{height}: it was turned by 90 degrees. Give the pictures as they were placed"
            )
            raise SceneError(msg)
        off = abs(across / width - 0.5), abs(down / height - 0.5)
        if max(off) <= _OFF_MIDDLE and min(off) <= _OFF_MIDDLE_OF_BOTH:
            continue
        camera = scene.folder / CAMERAS_FOLDER / f"{view.name}_cam.txt"
        msg = (
            f"{camera}: its principal point ({across:.0f}, {down:.0f}) is not near the middle of "
            f"{view.image_path.name}, which has {width}x{height} pixels"
        )
        times = ""
        if across > 0 and down > 0:
            msg += f"; a picture of about {2 * across:.0f}x{2 * down:.0f} would fit it"
            times = f" by about {width / (2 * across):.3g}"
        msg += f". Give the pictures in the cameras' size, or multiply the first two rows of each intrinsic{times}"
        raise SceneError(msg)


def _is_turned(across: float, down: float, width: int, height: int) -> bool:
    """Whether a principal point is the middle of the picture as it was before it was turned by a quarter."""
    square = max(width, height) < _NO_SQUARE * min(width, height)
    return not square and abs(across / height - 0.5) <= _TURNED and abs(down / width - 0.5) <= _TURNED

"""The pixels that a photograph stores, as RGB in 8 bits: of TIFFs, which Pillow turns, and of other depths.

OpenCV reads colours in 16 bits, of which Pillow keeps the upper half alone: nothing of a sensor of 8 bits.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ImageError

if TYPE_CHECKING:
    from PIL.Image import Image

#: Bits that sensors fill, of 8 in one file, 16 or 32 in others. Source: format; converters of cameras have 10 to 16.
_SENSOR_BITS = (8, 10, 12, 14, 16, 32)
#: Tags of what a TIFF stores: width, height, bits of each value, how to turn it upright. Source: format; TIFF 6.0.
_WIDTH, _HEIGHT, _BITS, _ORIENTATION = 0x0100, 0x0101, 0x0102, 0x0112
#: What OpenCV gives in the order blue, green, red, with or without a fourth that is left out. Source: format; Pillow.
_COLOURS = frozenset({"RGB", "RGBA", "RGBX", "LA"})
#: The orientation that undoes another; the others undo themselves. Source: definition; a quarter turn and one back.
_UNDOES = {6: 8, 8: 6}


def stored_size(image: Image) -> tuple[int, int]:
    """(width, height) as the sensor saw it, of an image that is not decoded yet."""
    from PIL.TiffImagePlugin import TiffImageFile

    if isinstance(image, TiffImageFile):
        # Pillow interchanges the two itself where the file says that it lies on its side.
        return int(image.tag_v2[_WIDTH]), int(image.tag_v2[_HEIGHT])
    return image.size


def has_deep_colours(image: Image) -> bool:
    """Whether colours have more than 8 bits, of which Pillow drops the lower ones.

    Of an image that is not decoded yet, which asking a PNG for its metadata does.
    """
    from PIL.PngImagePlugin import PngImageFile
    from PIL.TiffImagePlugin import TiffImageFile

    if image.mode.startswith("I") or image.mode == "F":
        return False  # grey, which it keeps
    if isinstance(image, TiffImageFile):
        return int(np.max(image.tag_v2.get(_BITS, 1))) > 8
    return isinstance(image, PngImageFile) and any(";16" in str(tile[3]) for tile in image.tile)


def turned(pixels: NDArray[np.uint8], orientation: int) -> NDArray[np.uint8]:
    """Stored pixels (H, W, 3) as the Exif orientation says that they stand upright; unknown ones turn nothing."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def read_tiff(path: Path, orientation: int) -> NDArray[np.uint8]:
    """The stored pixels (H, W, 3) of a TIFF with this orientation; what is wrong with it raises as Pillow does."""
    from PIL import Image

    # Of a file given by its name Pillow maps grey pixels in the size that they have when they are turned, a jumble.
    with path.open("rb") as stream, Image.open(stream) as image:
        image.load()
        # Loading has turned them.
        return turned(as_rgb(path, image), _UNDOES.get(orientation, orientation))


def read_deep(path: Path, image: Image) -> NDArray[np.uint8]:
    """The stored pixels (H, W, 3) of an opened image with deep colours.

    Raises :class:`ImageError` where these are no red, green and blue, and what Pillow raises.
    """
    from PIL.TiffImagePlugin import TiffImageFile

    # OpenCV turns a TIFF by this tag, and nothing else.
    done = int(image.tag_v2.get(_ORIENTATION, 1)) if isinstance(image, TiffImageFile) else 1
    mode = image.mode
    # It says nothing of a file that is cut short.
    image.load()
    values = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED) if mode in _COLOURS else None
    if values is None or values.dtype != np.uint16 or values.ndim != 3 or values.shape[2] < 3:
        msg = f"{path} holds colours ({mode}) in more than 8 bits that cannot be read; save it as RGB in 8 bits"
        raise ImageError(msg)
    # A table takes an eighth of the memory.
    levels = (255 * np.clip(np.arange(2**16) / _white(float(values[..., :3].max())), 0, 1)).round().astype(np.uint8)
    return turned(levels[values[..., 2::-1]], _UNDOES.get(done, done))


def as_rgb(path: Path, image: Image) -> NDArray[np.uint8]:
    """(H, W, 3) of an image that is loaded; :class:`ImageError` where it holds nothing that makes a photograph."""
    if image.mode.startswith("I") or image.mode == "F":
        # Pillow's own conversion clips these at 255 instead of scaling them.
        values = np.asarray(image, dtype=np.float64)
        black, white = _range_of_floats(path, values) if image.mode == "F" else (0.0, _white(float(values.max())))
        grey = np.clip(np.nan_to_num((values - black) / (white - black), posinf=1.0), 0, 1)
        return np.repeat((255 * grey).round().astype(np.uint8)[:, :, None], 3, axis=2)
    return np.array(image if image.mode == "RGB" else image.convert("RGB"), dtype=np.uint8)


def _white(largest: float) -> float:
    """The value of white by the largest one of a photograph in integers.

    A file of 16 bits does not say how many of them the sensor filled: twelve, taken for sixteen, are nearly black. A
    photograph has something bright in it, so its largest value tells; and as the depths are few, photographs of one
    camera are scaled alike.
    """
    return 2.0 ** next((bits for bits in _SENSOR_BITS if largest < 2**bits), _SENSOR_BITS[-1]) - 1


def _range_of_floats(path: Path, values: NDArray[np.float64]) -> tuple[float, float]:
    """Black and white of a photograph in floats, which may be parts of one, counts or degrees: its own range."""
    finite = values[np.isfinite(values)]
    if finite.size and finite.max() > finite.min():
        return float(finite.min()), float(finite.max())
    msg = f"{path} holds floats that are all alike or not finite; save it as a photo in 8 or 16 bits, or delete it"
    raise ImageError(msg)

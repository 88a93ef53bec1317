"""Reading and writing photographs: RGB uint8, upright, complete or an error.

Pillow reads because OpenCV fills the missing part of a cut JPEG with grey
and says nothing.
"""

from __future__ import annotations

import importlib.util
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ImageError
from fsinfer.io.files import atomic_path
from fsinfer.io.jpeg_holes import has_hole
from fsinfer.io.pixels import as_rgb, has_deep_colours, read_deep, read_tiff, stored_size, turned

if TYPE_CHECKING:
    from PIL.Image import Image


_HEIF_SUFFIXES = frozenset({".heic", ".heif"})
#: Brands of still pictures in the first box of a file. Source: format; ISO/IEC 23008-12, annex B.
_HEIF_BRANDS = frozenset({b"heic", b"heix", b"heim", b"heis", b"mif1"})

#: Tag that says how to turn a photo upright. Source: format; Exif 2.32 (CIPA DC-008).
_ORIENTATION = 0x0112
#: How hard a PNG is packed. Source: numerics; a tenth more bytes than with the usual 6, in a quarter to two thirds of
#: the time.
PNG_LEVEL = 2
#: JPEG from this quality on keeps colours at full resolution. Source: judgement; those who ask for more want them.
_FULL_COLOUR_QUALITY = 90
#: Formats of Pillow that are JPEG; a phone's with a second picture in it is MPO. Source: format.
_JPEG_FORMATS = frozenset({"JPEG", "MPO"})
#: Parts of its size that a JPEG is decoded at without being decoded as a whole. Source: format; libjpeg.
_JPEG_SHRINKS = (8, 4, 2)
#: Share of the longest side wanted that is enough where decoding at a part of the size gives it. Source: judgement.
_ENOUGH = 0.8
#: A side may be shorter by one part of so many for both to be reduced by one factor, to so many decimals of a share.
#: Source: numerics; 5472x3080 in 2400 would be 2400x1350.9, and is 2386x1343.0.
_SPARED, _DECIMALS = 20, 5


def read_image(path: Path | str, *, upright: bool = True, at_least_px: int | None = None) -> NDArray[np.uint8]:
    """Read a photograph upright (the EXIF orientation is applied), or else as the sensor saw it.

    Parameters
    ----------
    at_least_px: enough for the longer side. A JPEG of which a half, quarter or eighth is no smaller is decoded at that
        size, in a third of the time: the means of its pixels, without those of the last row or column that make no
        whole one.

    Returns
    -------
    (H, W, 3) uint8, RGB.

    Raises
    ------
    ImageError
        The file is missing, is no image, is cut short, or is HEIC while ``pillow-heif`` is not installed.
    """
    path = Path(path)
    from PIL import ImageOps

    with open_header(path) as image, _told(path):
        deep = has_deep_colours(image)
        if deep or image.format == "TIFF":
            orientation = orientation_of(image)
            pixels = read_deep(path, image) if deep else read_tiff(path, orientation)
            return turned(pixels, orientation) if upright else pixels
        width, height = image.size
        if at_least_px is not None and image.format in _JPEG_FORMATS and image.mode == "RGB":
            longer, shorter = max(width, height), min(width, height)
            shrink = next((n for n in _JPEG_SHRINKS if longer >= n * at_least_px and shorter >= n), 1)
            image.draft("RGB", (width // shrink, height // shrink))
            if image.width < width:
                width, height = width // shrink, height // shrink
        if image.format in _JPEG_FORMATS and has_hole(path.read_bytes()):
            msg = f"{path} is damaged: a part of it is missing, all zeros; copy it again from the camera or delete it"
            raise ImageError(msg)
        # Loading first: decoding errors must not hide in a lazy transposition.
        image.load()
        # A decoder makes a pixel of what is left over, too, which is narrower than the others.
        whole = image if image.size == (width, height) else image.crop((0, 0, width, height))
        if upright:
            ImageOps.exif_transpose(whole, in_place=True)  # it would copy what stands upright, too
        return as_rgb(path, whole)


def can_be_read(path: Path | str) -> bool:
    """Whether :func:`read_image` reads a photograph, to its end; a JPEG is decoded at an eighth of its size for it."""
    try:
        read_image(path, at_least_px=1)
    except ImageError:
        return False
    return True


def read_reduced(path: Path | str, longest_px: int, *, upright: bool = True) -> NDArray[np.uint8]:
    """:func:`read_image`, then :func:`reduce_image`; a JPEG that comes to a half is decoded at that size."""
    longer = max(image_size(path))
    part = _whole_part(longer, longest_px)
    # Every format comes to the same size, so that photos of one camera share a calibration.
    at_least = longer // part if part in _JPEG_SHRINKS else None
    return reduce_image(read_image(path, upright=upright, at_least_px=at_least), longest_px)


def _whole_part(longer: int, longest_px: int) -> int | None:
    """The part of its size to which a picture is reduced; None where no whole one comes near enough."""
    part = math.ceil(longer / longest_px)
    return part if longer // part >= _ENOUGH * longest_px else None


def reduce_image(image: NDArray[np.uint8], longest_px: int) -> NDArray[np.uint8]:
    """An (H, W, 3) uint8 picture, reduced by one factor both ways where its longer side is more than ``longest_px``.

    To a whole part of its size where that is ``longest_px`` or up to a fifth less (4032x3024 in 2400 is 2016x1512),
    without the last rows and columns that make no whole pixel. Else to ``longest_px``, or up to a twentieth less where
    whole pixels are then nearer to one factor in both directions.
    """
    height, width = image.shape[:2]
    longer, shorter = max(height, width), min(height, width)
    if longer <= longest_px:
        return image
    part = _whole_part(longer, longest_px)
    if part is not None and shorter >= part:
        image = image[: height // part * part, : width // part * part]
        size = (width // part, height // part)
    else:
        sides = np.arange(longest_px, longest_px - longest_px // _SPARED - 1, -1)
        other = shorter * sides / longer
        # Of several the largest.
        best = int(np.argmin(np.round(np.abs(other - np.rint(other)) / other, _DECIMALS)))
        size = (int(sides[best]), max(1, int(np.rint(other[best]))))
        size = size if width >= height else size[::-1]
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def write_image(path: Path | str, image: NDArray[np.uint8], quality: int = 95, *, exif: bytes | None = None) -> None:
    """Write an (H, W, 3) RGB or (H, W) grey uint8 image as JPEG or PNG by the suffix, atomically.

    Parameters
    ----------
    quality: of a JPEG, 1 to 100. From 90 on colours are kept at full resolution.
    exif: encoded metadata, see :func:`camera_exif`.

    Raises
    ------
    ImageError
        The array is no image or the suffix is neither ``.jpg``, ``.jpeg`` nor ``.png``.
    OutputError
        The file cannot be written.
    """
    from PIL import Image

    path = Path(path)
    formats = {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG"}
    suffix = path.suffix.lower()
    if suffix not in formats:
        msg = f"cannot write {path}: images are written as .jpg or .png"
        raise ImageError(msg)
    if image.dtype != np.uint8 or image.size == 0 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        msg = f"cannot write {path}: needs (H, W, 3) uint8, has {image.shape=} {image.dtype=}"
        raise ImageError(msg)
    options: dict[str, object] = {"compress_level": PNG_LEVEL} if suffix == ".png" else {}
    if exif is not None:
        options["exif"] = exif
    if formats[suffix] == "JPEG":
        options |= {"quality": quality, "subsampling": 0 if quality >= _FULL_COLOUR_QUALITY else 2}
    with atomic_path(path) as temporary:
        Image.fromarray(np.ascontiguousarray(image)).save(temporary, format=formats[suffix], **options)


def image_size(path: Path | str, *, upright: bool = True) -> tuple[int, int]:
    """(width, height) of the upright photo, or as the sensor saw it, from its header alone.

    Raises :class:`ImageError` where it cannot be read.
    """
    with open_header(Path(path)) as image:
        width, height = stored_size(image)
        on_side = upright and orientation_of(image) in (5, 6, 7, 8)
    return (height, width) if on_side else (width, height)


def is_turned(path: Path | str) -> bool:
    """Whether the metadata say that the stored pixels are not upright; not so where they cannot be read."""
    try:
        with open_header(Path(path)) as image:
            return orientation_of(image) in range(2, 9)
    except ImageError:
        return False


def is_upright_jpeg_or_png(path: Path | str, *, longest_px: int | None = None) -> bool:
    """Whether every reader sees the same pixels: JPEG or PNG in 8 bits, without an orientation to apply.

    With ``longest_px`` also whether its longer side is no longer than that.
    """
    with open_header(Path(path)) as image:
        plain = image.format in ("JPEG", "PNG") and image.mode in ("RGB", "L") and not has_deep_colours(image)
        small = longest_px is None or max(image.size) <= longest_px
        return plain and small and orientation_of(image) in (0, 1)


def open_header(path: Path) -> Image:
    """Open a photograph without decoding it; :class:`ImageError` where its header cannot be read."""
    if path.suffix.lower() in _HEIF_SUFFIXES or _is_heif(path):
        _register_heif(path)
    from PIL import Image

    with _told(path):
        return Image.open(path)


def _is_heif(path: Path) -> bool:
    """Whether a file of any name holds HEIC: programs that send photographs rename them to .jpg."""
    try:
        with path.open("rb") as stream:
            head = stream.read(12)
    except OSError:
        return False  # told where it is opened
    return head[4:8] == b"ftyp" and head[8:12] in _HEIF_BRANDS


@contextmanager
def quiet() -> Iterator[None]:
    """Without the warnings of Pillow about metadata and large photos: nobody can do anything about them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Whatever goes wrong with a photograph inside is told as a :class:`ImageError`."""
    from PIL import Image, UnidentifiedImageError

    try:
        with quiet():
            yield
    except ImageError:
        raise
    except UnidentifiedImageError as error:
        msg = f"{path} is not a photo that can be read; copy it again from the camera or delete it"
        raise ImageError(msg) from error
    except Image.DecompressionBombError as error:
        msg = f"{path} has too many pixels ({error}); save it with fewer than 150 megapixels"
        raise ImageError(msg) from error
    except FileNotFoundError as error:
        msg = f"{path} does not exist; check the name"
        raise ImageError(msg) from error
    except PermissionError as error:
        msg = f"cannot read {path}: {error.strerror or error}; ask for the right to"
        raise ImageError(msg) from error
    except MemoryError:
        raise  # no fault of the photograph
    except Exception as error:
        # Its readers have no kind of error in common: OSError for a cut JPEG, SyntaxError for a broken PNG, ValueError,
        # EOFError, struct.error, KeyError, RuntimeError and others for broken headers.
        msg = f"{path} is damaged or cut short ({error}); copy it again from the camera or delete it"
        raise ImageError(msg) from error


def orientation_of(image: Image) -> int:
    """How the photo has to be turned, by Exif; 1 (not at all) where its metadata is damaged, as for the pixels."""
    try:
        with quiet():
            return int(image.getexif().get(_ORIENTATION, 1))
    except Exception:  # see _told; broken metadata is common after editing
        return 1


def _register_heif(path: Path) -> None:
    if importlib.util.find_spec("pillow_heif") is None:
        msg = f"{path} is a HEIC photo and the reader for it is missing: pip install pillow-heif, or export JPEG photos"
        raise ImageError(msg)
    import pillow_heif

    pillow_heif.register_heif_opener()


def luminance(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H, W) uint8 luminance of an RGB image (ITU-R BT.601)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)

"""Reading and writing photographs: RGB uint8, upright, complete or an error.

Pillow reads (it comes with matplotlib and pillow-heif) because OpenCV fills the missing part of a cut JPEG with grey
and says nothing.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ImageError
from fsinfer.files import atomic_path

if TYPE_CHECKING:
    from PIL.Image import Exif, Image

#: What :func:`list_images` takes for a photograph, lower case.
PHOTO_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp", ".heic", ".heif"})
_HEIF_SUFFIXES = frozenset({".heic", ".heif"})
_TIFF_SUFFIXES = frozenset({".tif", ".tiff"})

# EXIF tags (Exif 2.32, CIPA DC-008): what structure from motion needs, without place, time, owner and thumbnail.
_ORIENTATION = 0x0112
_EXIF_IFD = 0x8769
_MAKE, _MODEL = 0x010F, 0x0110
_FOCAL_LENGTH, _FOCAL_LENGTH_35MM = 0x920A, 0xA405
_GNSS_IFD = 0x8825
_LATITUDE_REF, _LATITUDE, _LONGITUDE_REF, _LONGITUDE = 1, 2, 3, 4


def list_images(folder: Path | str) -> list[Path]:
    """Return the photographs directly in ``folder``, sorted by name; hidden files are not taken.

    Raises
    ------
    ImageError
        ``folder`` is missing or holds no photograph.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        msg = f"{folder} {what}; give a folder of photos"
        raise ImageError(msg)
    paths = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in PHOTO_SUFFIXES and not path.name.startswith(".") and path.is_file()
    )
    if not paths:
        msg = f"{folder} holds no photos ({', '.join(sorted(PHOTO_SUFFIXES))}); give the folder that your photos lie in"
        raise ImageError(msg)
    return paths


def read_image(path: Path | str) -> NDArray[np.uint8]:
    """Read a photograph upright (the EXIF orientation is applied).

    Returns
    -------
    (H, W, 3) uint8, RGB.

    Raises
    ------
    ImageError
        The file is missing, is no image, is cut short, or is HEIC while ``pillow-heif`` is not installed.
    """
    path = Path(path)
    if path.suffix.lower() in _HEIF_SUFFIXES:
        _register_heif(path)
    from PIL import Image, ImageOps, UnidentifiedImageError

    try:
        with Image.open(path) as image:
            # Loading first: decoding errors must not hide in a lazy transposition.
            image.load()
            upright = ImageOps.exif_transpose(image)
            return _as_rgb(upright)
    except UnidentifiedImageError as error:
        msg = f"{path} is not a photo that can be read; copy it again from the camera or delete it"
        raise ImageError(msg) from error
    except Image.DecompressionBombError as error:
        msg = f"{path} has too many pixels ({error}); save it with fewer than 150 megapixels"
        raise ImageError(msg) from error
    except FileNotFoundError as error:
        msg = f"{path} does not exist; check the name"
        raise ImageError(msg) from error
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        # Pillow: OSError for a cut JPEG, SyntaxError for a broken PNG, ValueError and EOFError for broken headers.
        msg = f"{path} is damaged or cut short ({error}); copy it again from the camera or delete it"
        raise ImageError(msg) from error


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
    options: dict[str, object] = {} if exif is None else {"exif": exif}
    if formats[suffix] == "JPEG":
        options |= {"quality": quality, "subsampling": 0 if quality >= 90 else 2}
    with atomic_path(path) as temporary:
        Image.fromarray(np.ascontiguousarray(image)).save(temporary, format=formats[suffix], **options)


def camera_exif(path: Path | str) -> bytes | None:
    """Metadata for a copy that is written upright: maker, model and focal length, nothing about the place.

    Returns
    -------
    Encoded EXIF for :func:`write_image`, or None where the photo says nothing about its camera.

    Raises
    ------
    ImageError
        The file cannot be read.
    """
    from PIL import Image

    tags, lens = _read_exif(Path(path))
    kept = Image.Exif()
    for tag in (_MAKE, _MODEL):
        if tag in tags:
            kept[tag] = tags[tag]
    kept_lens = {tag: lens[tag] for tag in (_FOCAL_LENGTH, _FOCAL_LENGTH_35MM) if tag in lens}
    if kept_lens:
        kept.get_ifd(_EXIF_IFD).update(kept_lens)
    return kept.tobytes() if len(kept) or kept_lens else None


def named_camera_exif(model: str) -> bytes:
    """Metadata for frames of one video: a camera model of their own, so that they share no lens with other frames."""
    from PIL import Image

    kept = Image.Exif()
    kept[_MODEL] = model
    return kept.tobytes()


def camera_key(path: Path | str) -> tuple[str, ...]:
    """Name the camera and lens of a photo: equal keys mean that the photos can share a calibration.

    Returns
    -------
    Upright width and height, maker, model and focal lengths as text; size alone for photos without metadata.

    Raises
    ------
    ImageError
        The file cannot be read.
    """
    path = Path(path)
    tags, lens = _read_exif(path)
    width, height = image_size(path)
    names = [str(tags.get(tag, "")).strip("\x00 ") for tag in (_MAKE, _MODEL)]
    lengths = [str(lens.get(tag, "")) for tag in (_FOCAL_LENGTH, _FOCAL_LENGTH_35MM)]
    return (str(width), str(height), *names, *lengths)


def image_size(path: Path | str) -> tuple[int, int]:
    """(width, height) of the upright photo, from its header alone; :class:`ImageError` where it cannot be read."""
    path = Path(path)
    image = _open_header(path)
    with image:
        width, height = image.size
        turned = int(image.getexif().get(_ORIENTATION, 1)) in (5, 6, 7, 8)
    return (height, width) if turned else (width, height)


def is_upright_jpeg_or_png(path: Path | str) -> bool:
    """Whether every reader sees the same pixels: JPEG or PNG in 8 bits, without an orientation to apply."""
    image = _open_header(Path(path))
    with image:
        plain = image.format in ("JPEG", "PNG") and image.mode in ("RGB", "L")
        return plain and int(image.getexif().get(_ORIENTATION, 1)) in (0, 1)


def gnss_degrees(path: Path | str) -> tuple[float, float] | None:
    """(latitude, longitude) in degrees that the phone noted, None where it noted none that can be read."""
    try:
        with _open_header(Path(path)) as image:
            tags = dict(image.getexif().get_ifd(_GNSS_IFD))
        values = []
        for value, reference, negative in ((_LATITUDE, _LATITUDE_REF, "S"), (_LONGITUDE, _LONGITUDE_REF, "W")):
            degrees, minutes, seconds = (float(part) for part in tags[value])
            sign = -1 if str(tags.get(reference, "")).upper().startswith(negative) else 1
            values.append(sign * (degrees + minutes / 60 + seconds / 3600))
    except (ImageError, OSError, KeyError, ValueError, TypeError, ZeroDivisionError):
        # Broken metadata costs a direction and nothing else.
        return None
    return (values[0], values[1]) if np.isfinite(values).all() else None


def _open_header(path: Path) -> Image:
    if path.suffix.lower() in _HEIF_SUFFIXES:
        _register_heif(path)
    from PIL import Image, UnidentifiedImageError

    try:
        return Image.open(path)
    except UnidentifiedImageError as error:
        msg = f"{path} is not a photo that can be read; copy it again from the camera or delete it"
        raise ImageError(msg) from error
    except (OSError, Image.DecompressionBombError) as error:
        msg = f"cannot read {path} ({error}); copy it again from the camera or delete it"
        raise ImageError(msg) from error


def _read_exif(path: Path) -> tuple[Exif, dict[int, object]]:
    image = _open_header(path)
    with image:
        tags = image.getexif()
        try:
            lens = dict(tags.get_ifd(_EXIF_IFD))
        except (KeyError, ValueError, TypeError, OSError):
            # Broken metadata is common after editing, and only costs the focal length prior.
            lens = {}
    return tags, lens


def _register_heif(path: Path) -> None:
    if importlib.util.find_spec("pillow_heif") is None:
        msg = f"{path} is a HEIC photo and the reader for it is missing: pip install pillow-heif, or export JPEG photos"
        raise ImageError(msg)
    import pillow_heif

    pillow_heif.register_heif_opener()


def _as_rgb(image: Image) -> NDArray[np.uint8]:
    if image.mode.startswith("I") or image.mode == "F":
        # 16-bit grey: Pillow's own conversion clips at 255 instead of scaling.
        values = np.asarray(image, dtype=np.float64)
        grey = np.clip(values / 257.0, 0, 255).round().astype(np.uint8)
        return np.repeat(grey[:, :, None], 3, axis=2)
    return np.array(image.convert("RGB"), dtype=np.uint8)

"""What a photograph says of its camera and its place, and what of it goes into copies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fsinfer.errors import ImageError
from fsinfer.io.gravity import EXIF_IFD, USER_COMMENT, gravity_comment, noted_gravity
from fsinfer.io.images import image_size, open_header, quiet

if TYPE_CHECKING:
    from PIL.Image import Exif

#: Tags of the camera and its lens. Source: format; Exif 2.32.
_MAKE, _MODEL, _FOCAL_LENGTH, _FOCAL_LENGTH_35MM = 0x010F, 0x0110, 0x920A, 0xA405
#: Some phones note a zoom that enlarges the middle of the picture here only. Source: format; Exif 2.32.
_DIGITAL_ZOOM = 0xA404
#: Tags of the moment, local time without a zone, and the decimals of its seconds. Source: format; Exif 2.32.
_TAKEN, _TAKEN_DECIMALS = 0x9003, 0x9291
#: What of the part on the lens goes into copies: the moment tells the order where a counter began anew.
_KEPT_OF_LENS = (_FOCAL_LENGTH, _FOCAL_LENGTH_35MM, _DIGITAL_ZOOM, _TAKEN, _TAKEN_DECIMALS)
#: Projection of a picture of the sphere in its XMP. Source: format; GPano, Google's metadata of photo spheres.
_SPHERE = b"equirectangular"
#: Tags of the place, and the part of the file that they stand in. Source: format; Exif 2.32.
_GNSS_IFD, _LATITUDE_REF, _LATITUDE, _LONGITUDE_REF, _LONGITUDE = 0x8825, 1, 2, 3, 4


def camera_exif(path: Path | str) -> bytes | None:
    """Metadata for a copy that is written upright: maker, model, focal length, moment, gravity, not the place.

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
    kept_lens = {tag: lens[tag] for tag in _KEPT_OF_LENS if tag in lens}
    gravity = noted_gravity(path)
    if gravity is not None:
        kept_lens[USER_COMMENT] = gravity_comment(gravity)
    try:
        if kept_lens:
            kept.get_ifd(EXIF_IFD).update(kept_lens)
        return kept.tobytes() if len(kept) or kept_lens else None
    except Exception:  # values of a type that the tag cannot have
        return None


def gravity_exif(path: Path | str) -> bytes | None:
    """Metadata for a picture that was made of a photo without turning it: gravity alone, if the phone noted it."""
    from PIL import Image

    gravity = noted_gravity(path)
    if gravity is None:
        return None
    kept = Image.Exif()
    kept.get_ifd(EXIF_IFD)[USER_COMMENT] = gravity_comment(gravity)
    return kept.tobytes()


def named_camera_exif(model: str) -> bytes:
    """Metadata for frames of one video: a camera model of their own, so that they share no lens with other frames."""
    from PIL import Image

    kept = Image.Exif()
    # The tag holds ASCII, and Pillow makes every other letter a question mark: two clips would have one camera.
    kept[_MODEL] = model.encode("ascii", "backslashreplace").decode("ascii")
    return kept.tobytes()


def camera_key(path: Path | str) -> tuple[str, ...]:
    """Name the camera and lens of a photo: equal keys mean that the photos can share a calibration.

    Returns
    -------
    Upright width and height, maker, model, focal lengths and digital zoom as text; size alone for photos without
    metadata.

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
    return (str(width), str(height), *names, *lengths, _zoom(lens.get(_DIGITAL_ZOOM)))


def _zoom(value: object) -> str:
    """The digital zoom as text; 0, 1 and no word of it are none."""
    text = "" if value is None else str(value)
    try:
        return "" if float(text) in (0.0, 1.0) else text
    except ValueError:
        return text


def taken_at(path: Path | str) -> tuple[str, str] | None:
    """Camera (maker and model) of a photo, and the moment that it noted, as a text that sorts by time; None without.

    Moments of different cameras cannot be compared: a clock may be wrong.
    """
    try:
        tags, lens = _read_exif(Path(path))
    except ImageError:
        return None
    moment = str(lens.get(_TAKEN, "")).strip("\x00 ")
    if not moment.strip(" :0"):
        return None
    decimals = str(lens.get(_TAKEN_DECIMALS, "")).strip("\x00 ")
    camera = " ".join(str(tags.get(tag, "")).strip("\x00 ") for tag in (_MAKE, _MODEL))
    return camera, f"{moment}.{decimals}"


def shows_sphere(path: Path | str) -> bool:
    """Whether a photo says that it shows the whole sphere, by longitude and latitude, as 360° cameras write it."""
    try:
        with open_header(Path(path)) as image, quiet():
            packet = image.info.get("xmp", b"")
    except ImageError:
        return False
    text = packet.encode() if isinstance(packet, str) else bytes(packet)
    return _SPHERE in text


def gnss_degrees(path: Path | str) -> tuple[float, float] | None:
    """(latitude, longitude) in degrees that the phone noted, None where it noted none that can be read."""
    try:
        with open_header(Path(path)) as image, quiet():
            tags = dict(image.getexif().get_ifd(_GNSS_IFD))
        values = []
        for value, reference, negative in ((_LATITUDE, _LATITUDE_REF, "S"), (_LONGITUDE, _LONGITUDE_REF, "W")):
            degrees, minutes, seconds = (float(part) for part in tags[value])
            sign = -1 if str(tags.get(reference, "")).upper().startswith(negative) else 1
            values.append(sign * (degrees + minutes / 60 + seconds / 3600))
    except Exception:  # of any kind that Pillow raises
        # Broken metadata costs a direction and nothing else.
        return None
    return (values[0], values[1]) if np.isfinite(values).all() else None


def _read_exif(path: Path) -> tuple[Exif, dict[int, object]]:
    from PIL.Image import Exif

    with open_header(path) as image:
        # Broken metadata is common after editing, raises whatever there is, and only costs the focal length prior.
        try:
            with quiet():
                tags = image.getexif()
        except Exception:
            return Exif(), {}
        try:
            with quiet():
                lens = dict(tags.get_ifd(EXIF_IFD))
        except Exception:
            lens = {}
    return tags, lens

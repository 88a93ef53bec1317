"""Which way gravity pulled the phone when it took a photograph, where it noted that.

Apple's phones write what their accelerometer felt into the maker's part of the metadata, in units of g and in the axes
of the phone: x to the right of its screen, y to the top, z out of it (the frame of Core Motion). The axes were found on
23 photographs of an iPhone 7 held two ways round: turned by their poses the notes lie 1.2 degrees (root mean square,
2.3 at most) from their mean. Copies that we write keep it as a comment.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.images import open_header, quiet

#: Tags of the orientation, the part of the file that the notes stand in, the maker's note and the user's comment.
#: Source: format; Exif 2.32.
_ORIENTATION, EXIF_IFD, _MAKER_NOTE, USER_COMMENT = 0x0112, 0x8769, 0x927C, 0x9286
#: How Apple's note begins, and where the byte order and the entries of its table stand. Source: format; as ExifTool
#: documents it (Phil Harvey).
_APPLE, _BYTE_ORDER, _TABLE = b"Apple iOS\0", 12, 14
#: The entry of the acceleration, its type (signed fractions) and number. Source: format; ExifTool.
_ACCELERATION, _SIGNED_FRACTIONS, _AXES = 8, 10, 3
#: A length of the acceleration, in g, at which the phone was not shaken. Source: judgement.
_STILL_G = (0.8, 1.2)
#: How our own comment begins. Source: format; eight letters name the encoding (Exif 2.32), then words of ours.
_COMMENT = b"ASCII\0\0\0fsinfer gravity "
#: From the axes of the sensor to those of the upright photograph, by the tag of the orientation. Source: format; Exif
#: 2.32. Mirrored photographs are no photographs of a camera.
UPRIGHT = {
    1: np.diag([1.0, 1.0, 1.0]),
    3: np.diag([-1.0, -1.0, 1.0]),
    6: np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    8: np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}
#: From the axes of the phone to those of its sensor, which lies on its side: x down the phone's back, y to its left.
#: Source: format; photographs of an iPhone 7, see above.
_SENSOR_FROM_PHONE = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def noted_gravity(path: Path | str, *, upright: bool = True) -> NDArray[np.float64] | None:
    """(3,) unit vector to the ground in the axes of the upright photograph, x right, y down, z forward.

    Without ``upright`` in the axes of the pixels that a JPEG or PNG stores, to which the cameras of a scene belong. A
    picture of ours that keeps it as a comment keeps it in its own axes, whether it lies upright or not. None where the
    phone noted nothing, was shaken, or its note cannot be read.
    """
    try:
        with open_header(Path(path)) as image, quiet():
            tags = image.getexif()
            notes = dict(tags.get_ifd(EXIF_IFD))
            # The reader of HEIC files turns them upright itself, and keeps here how they were.
            orientation = image.info.get("original_orientation") or tags.get(_ORIENTATION, 1)
    except Exception:  # of any kind that Pillow raises: broken metadata costs a direction and nothing else
        return None
    comment = notes.get(USER_COMMENT)
    if isinstance(comment, bytes) and comment.startswith(_COMMENT):
        try:
            return _unit(np.array([float(word) for word in comment[len(_COMMENT) :].split()]))
        except ValueError:
            return None
    note = notes.get(_MAKER_NOTE)
    turn = UPRIGHT.get(orientation) if isinstance(orientation, int) else None
    felt = _apple_acceleration(note) if isinstance(note, bytes) else None
    if felt is None or turn is None or not _STILL_G[0] <= float(np.linalg.norm(felt)) <= _STILL_G[1]:
        return None
    return _unit((turn if upright else np.eye(3)) @ _SENSOR_FROM_PHONE @ felt)


def gravity_comment(gravity: NDArray[np.float64]) -> bytes:
    """The comment that keeps it, in the axes of the copy that it is written to, for the tag ``USER_COMMENT``."""
    return _COMMENT + " ".join(f"{value:.5f}" for value in gravity).encode("ascii")


def _apple_acceleration(note: bytes) -> NDArray[np.float64] | None:
    """(3,) in g and the phone's axes, from the maker's note; None from another one."""
    if not note.startswith(_APPLE):
        return None
    order = "<" if note[_BYTE_ORDER:_TABLE] == b"II" else ">"
    try:
        (entries,) = struct.unpack_from(f"{order}H", note, _TABLE)
        for entry in range(entries):
            tag, kind, count, at = struct.unpack_from(f"{order}HHII", note, _TABLE + 2 + 12 * entry)
            if (tag, kind, count) == (_ACCELERATION, _SIGNED_FRACTIONS, _AXES):
                parts = np.array(struct.unpack_from(f"{order}{2 * _AXES}i", note, at), dtype=np.float64)
                return parts[::2] / parts[1::2] if parts[1::2].all() else None
    except struct.error:
        return None  # cut short
    return None


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64] | None:
    length = float(np.linalg.norm(vector))
    sound = vector.shape == (_AXES,) and np.isfinite(length) and length > 0
    return np.asarray(vector / length) if sound else None

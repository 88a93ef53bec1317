"""Pictures that lie as the sensor saw the scene, and how they would have to be turned to stand upright.

Other programs calibrate what the sensor saw, whatever the photograph's tag says of how to hold it. What is made of such
a photograph keeps those pixels; a description, and no tag, says how they lie: a tag would make every reader turn them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.gravity import EXIF_IFD, UPRIGHT, USER_COMMENT, gravity_comment, noted_gravity
from fsinfer.io.images import open_header, orientation_of, quiet

#: Tag of the description of a picture. Source: format; Exif 2.32.
_DESCRIPTION = 0x010E
#: How our own description begins; the number of the orientation follows. Source: format; words of ours.
_TURNED = "fsinfer orientation "


def sensor_exif(path: Path | str) -> bytes | None:
    """Metadata for a picture made of a photo's pixels as they are stored: how they lie, and gravity if it was noted.

    None where the photo says neither, or lies upright and noted nothing.
    """
    from PIL import Image

    with open_header(Path(path)) as image:
        orientation = orientation_of(image)
    if orientation not in UPRIGHT:
        orientation = 1  # it mirrors, which no camera does
    gravity = noted_gravity(path)
    kept = Image.Exif()
    if orientation != 1:
        kept[_DESCRIPTION] = f"{_TURNED}{orientation}"
    if gravity is not None:
        # Noted in the axes of the upright photo; a comment is in those of the picture that it stands in.
        kept.get_ifd(EXIF_IFD)[USER_COMMENT] = gravity_comment(UPRIGHT[orientation].T @ gravity)
    return kept.tobytes() if orientation != 1 or gravity is not None else None


def upright_from_picture(path: Path | str) -> NDArray[np.float64]:
    """(3, 3) rotation about z from the camera axes of a picture (x right, y down) to those of the upright photograph.

    By the words that :func:`sensor_exif` wrote, else by the tag of the orientation: pictures of a scene are read as
    they are stored, and other programs leave the tag of the photograph in them.
    """
    try:
        with open_header(Path(path)) as image, quiet():
            said = str(image.getexif().get(_DESCRIPTION, ""))
            return UPRIGHT[int(said.removeprefix(_TURNED)) if said.startswith(_TURNED) else orientation_of(image)]
    except Exception:  # of any kind that Pillow raises: broken metadata costs a direction and nothing else
        return UPRIGHT[1]

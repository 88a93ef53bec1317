"""SIFT features of small photos, found in enlarged copies of them.

COLMAP doubles a photo, looks for features of every scale, and drops the smallest of them where there are more than
enough, which in a doubled photo is a third to a half. A copy that is not enlarged as much never has those: the others
are found in half of the time (docs/trials-speed.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from fsinfer.io.images import luminance, read_image
from fsinfer.poses.colmap_calls import call, image_number, open_database
from fsinfer.threads import in_order


def find_in_enlarged(
    database: Path, images: Path, names: Sequence[str], enlargement: float, options: Any, threads: int
) -> None:
    """Find features of the photos ``names``, which ``database`` has none of, in copies ``enlargement`` times as large.

    ``options`` are ``pycolmap.FeatureExtractionOptions`` for the copies, ``max_image_size`` in their pixels; what the
    database gets are the features in the photos' own.
    """
    import pycolmap

    with TemporaryDirectory(prefix="enlarged-", dir=database.parent) as folder:
        copies, found = Path(folder), Path(folder) / "features.db"
        scales = dict(
            zip(names, in_order(lambda name: _enlarge(images / name, copies, enlargement), names, threads), strict=True)
        )
        call(
            pycolmap.extract_features,
            found,
            copies,
            image_names=[_copy_of(name) for name in names],
            camera_mode=pycolmap.CameraMode.PER_IMAGE,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )
        with open_database(found) as source, open_database(database) as target:
            for name in names:
                there, here = image_number(source, _copy_of(name)), image_number(target, name)
                keypoints = np.array(source.read_keypoints(there), dtype=np.float32)
                # A place, and a matrix of its shape, row by row.
                keypoints[:, [0, 2, 3]] /= scales[name][0]
                keypoints[:, [1, 4, 5]] /= scales[name][1]
                # A run may have been stopped between the two; a photo's features are always the same.
                if not target.exists_keypoints(here):
                    target.write_keypoints(here, keypoints)
                target.write_descriptors(here, source.read_descriptors(there))


def _copy_of(name: str) -> str:
    # Written and read in no time; nobody keeps it.
    return f"{name}.bmp"


def _enlarge(photo: Path, folder: Path, enlargement: float) -> tuple[float, float]:
    """Write the grey copy; returns how many times as wide and as high it is."""
    from PIL import Image

    grey = luminance(read_image(photo, upright=False))
    height, width = grey.shape
    size = (round(width * enlargement), round(height * enlargement))
    Image.fromarray(np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR))).save(
        folder / _copy_of(photo.name)
    )
    return size[0] / width, size[1] / height

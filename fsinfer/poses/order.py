"""The order in which the photos of a model were taken."""

from __future__ import annotations

from typing import Any


def in_order_of_walking(model: Any) -> list[int]:
    """Image ids of the placed photos of a ``pycolmap.Reconstruction`` by their file names, which number the walk.

    The ids themselves go camera by camera: by them, neighbours of which one was held upright and one across stand far
    apart.
    """
    return sorted(model.reg_image_ids(), key=lambda image_id: (str(model.images[image_id].name), image_id))

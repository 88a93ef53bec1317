"""Where the markers are in the images of a scene, as whoever placed the photos found them: ``markers_seen.json``.

The poses stage looks for markers in every photo, because they tie the walk together. What it found is not looked for
again: only the corners are, in the scene's images. Scenes of another origin have no such file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.files import write_text
from fsinfer.io.json_text import read_json
from fsinfer.scene import Scene

FILE = "markers_seen.json"
#: Digits behind the point of a corner, pixels. Source: numerics; a start for the search of its edges.
_DIGITS = 2


@dataclass(frozen=True, kw_only=True)
class MarkersSeen:
    """Markers of one dictionary by view; views that are not named were not looked at.

    ``places`` are (number, (4, 2) float64 corners in pixels of the scene's image, clockwise), within a pixel.
    ``min_side_px``: smaller ones were not looked for.
    """

    dictionary: str
    min_side_px: float
    places: Mapping[str, tuple[tuple[int, NDArray[np.float64]], ...]]

    def of(self, view: str, dictionary: str, min_side_px: float) -> tuple[tuple[int, NDArray[np.float64]], ...] | None:
        """The markers of ``dictionary`` in a view that are as large as that; None where they were not looked for."""
        told = dictionary.upper() == self.dictionary.upper() and min_side_px >= self.min_side_px
        return self.places.get(view) if told else None


#: Of a scene whose markers nobody looked for.
UNSEEN = MarkersSeen(dictionary="", min_side_px=0.0, places={})


def write_markers_seen(folder: Path, seen: MarkersSeen) -> None:
    """Write them beside the images of a scene; :class:`OutputError` where they cannot be."""
    views = {
        view: [{"number": number, "corners_px": np.round(corners, _DIGITS).tolist()} for number, corners in places]
        for view, places in seen.places.items()
    }
    record = {"dictionary": seen.dictionary, "min_side_px": seen.min_side_px, "views": views}
    write_text(folder / FILE, json.dumps(record) + "\n")


def read_markers_seen(scene: Scene) -> MarkersSeen:
    """What is known of a scene: :data:`UNSEEN` where there is no such file, or one that cannot be read."""
    try:
        record = read_json(scene.folder / FILE)
        return MarkersSeen(
            dictionary=str(record["dictionary"]),
            min_side_px=float(record["min_side_px"]),
            places={
                str(view): tuple((int(place["number"]), _corners(place["corners_px"])) for place in places)
                for view, places in record["views"].items()
            },
        )
    except (OSError, ValueError, TypeError, KeyError, AttributeError, OverflowError):
        # Looked for once more, which takes seconds.
        return UNSEEN


def _corners(values: object) -> NDArray[np.float64]:
    corners = np.array(values, dtype=np.float64)
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise ValueError(corners.shape)
    return corners

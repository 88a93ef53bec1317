"""COLMAP's geometric check of matches: how many of a pair's agree on one fundamental matrix or homography.

A pair counts with :data:`~fsinfer.poses.pairs.MIN_INLIERS` matches that agree. Of a pair with few matches most must
then be right, and so few random samples tell that they are not: of 20 matches, three quarters. COLMAP does not draw
that conclusion by itself, and spends half of its time on pairs that do not belong together; its own loop over the pairs
of a database uses one thread where their matches are there already (docs/trials-speed.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.colmap_calls import SEED, call, image_number, open_database
from fsinfer.poses.pairs import MIN_INLIERS
from fsinfer.threads import in_order

#: Random samples of a pair at most; of many matches that is the limit. With COLMAP's 10,000 the check takes as long as
#: matching. Source: numerics; 360 pairs of a rendered plot: 6.4 s with 10,000 against 3.0, 281 pairs and 92,629 matches
#: against 279 and 92,574; renders only.
_MOST_SAMPLES = 2500
#: Samples are drawn as for so much of the least share that counts: not every sample of right matches has all agree.
#: Source: numerics; of 725 pairs with 15 matches or more, of a rendered plot, 588 count at 1.0, 590 at 0.9, 594 at 0.8
#: (six more of 15 or 16 that agree), and 589 with COLMAP's samples; renders only.
_OF_LEAST_SHARE = 0.9


@dataclass(frozen=True, kw_only=True)
class _Photo:
    """A photo of the database: its ``pycolmap.Camera``, and the places (N, 2) of its features, pixels."""

    camera: Any
    places: NDArray[np.float64]


def check_pairs(database: Path, pairs: Sequence[tuple[str, str]], threads: int) -> None:
    """Check the matches that the database has of ``pairs`` of photos, by their names, so many pairs at a time.

    What agrees is in the database afterwards; pairs that were checked before are not checked again.
    """
    with open_database(database) as opened:
        numbers = {name: image_number(opened, name) for name in {name for pair in pairs for name in pair}}
        missing = [(numbers[first], numbers[second]) for first, second in pairs]
        missing = [pair for pair in missing if not opened.exists_two_view_geometry(*pair)]
        photos = {number: _photo(opened, number) for number in {number for pair in missing for number in pair}}
        asked = [(photos[first], photos[second], _matches(opened, first, second)) for first, second in missing]
        for (first, second), found in zip(missing, in_order(_checked, asked, threads), strict=True):
            opened.write_two_view_geometry(first, second, found)


def _photo(opened: Any, number: int) -> _Photo:
    places = np.asarray(opened.read_keypoints(number), dtype=np.float64)[:, :2]
    return _Photo(camera=opened.read_camera(opened.read_image(number).camera_id), places=places)


def _matches(opened: Any, first: int, second: int) -> NDArray[np.uint32]:
    return np.asarray(opened.read_matches(first, second), dtype=np.uint32)


def _checked(asked: tuple[_Photo, _Photo, NDArray[np.uint32]]) -> Any:
    """The ``pycolmap.TwoViewGeometry`` of a pair, without matches where too few of them agree."""
    import pycolmap

    first, second, matches = asked
    if len(matches) < MIN_INLIERS:
        return pycolmap.TwoViewGeometry()
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = MIN_INLIERS
    options.ransac.random_seed = SEED
    options.ransac.max_num_trials = _MOST_SAMPLES
    # What agrees at least where the pair counts: samples that would only tell less are not drawn.
    options.ransac.min_inlier_ratio = max(options.ransac.min_inlier_ratio, _OF_LEAST_SHARE * MIN_INLIERS / len(matches))
    return call(
        pycolmap.estimate_two_view_geometry,
        first.camera,
        first.places,
        second.camera,
        second.places,
        matches,
        options,
    )

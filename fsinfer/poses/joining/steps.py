"""Whether a part goes on where the rest of the walk stops: who walks makes no leaps from one photo to the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fsinfer.geometry.similarity import Floats, apply, scale_of

#: Photos at most so many apart in the walk stand at most so many usual steps apart for each. Source: judgement.
_NEAR, _MOST_STEPS = 3, 3.0
#: The usual step of the part is that of the rest within this factor. Source: judgement.
_STEP_RATIO = 3.0


class Steps:
    """Where photos that follow each other in the walk stand, in the model and in a part of it.

    ``ordered`` tells whether the photos have an order at all.
    """

    def __init__(self, model: Any, part: Any, walk: Sequence[str]) -> None:
        self.ordered = bool(walk)
        rank = {file: index for index, file in enumerate(walk)}
        self._ours, self._theirs = _centers(model, rank), _centers(part, rank)
        self._step, self._part_step = _usual_step(self._ours), _usual_step(self._theirs)
        self._seams = [
            (one, other, abs(one - other))
            for other in self._theirs
            for one in range(other - _NEAR, other + _NEAR + 1)
            if one in self._ours and one not in self._theirs and other not in self._ours
        ]

    def same_pace(self, place: Floats) -> bool:
        """Whether the part was walked in steps like those of the rest, as far as both tell."""
        if not (self._step and self._part_step):
            return True
        return bool(abs(np.log(scale_of(place) * self._part_step / self._step)) < np.log(_STEP_RATIO))

    def go_on(self, place: Floats) -> bool | None:
        """Whether the part is reached by usual steps from the rest; None where no photos are near each other.

        Who stops taking photos for a while leaps, too: no leap speaks for a place, a leap not surely against it.
        """
        if not self._step or not self._seams:
            return None
        leaps = [
            float(np.linalg.norm(apply(place, self._theirs[other]) - self._ours[one])) / (self._step * apart)
            for one, other, apart in self._seams
        ]
        return float(np.median(leaps)) <= _MOST_STEPS


def _centers(model: Any, rank: dict[str, int]) -> dict[int, Floats]:
    found = {}
    for image_id in model.reg_image_ids():
        image = model.images[image_id]
        if image.name in rank:
            found[rank[image.name]] = np.asarray(image.projection_center(), np.float64)
    return found


def _usual_step(centers: dict[int, Floats]) -> float:
    steps = [np.linalg.norm(centers[r + 1] - at) for r, at in centers.items() if r + 1 in centers]
    return float(np.median(steps)) if steps else 0.0

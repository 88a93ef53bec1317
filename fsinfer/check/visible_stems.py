"""The stems that a check judges: those of a quick look at the surface, and those of the sparse points beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.check.sparse_stems import SparseStem
from fsinfer.conventions.breast_height import BREAST_HEIGHT_M
from fsinfer.trees.search.stem import Stem

Floats = NDArray[np.float64]

#: Two stems nearer than this, wall to wall, are one. Source: judgement; a noisy one may be found 0.15 m from its place.
_SAME_M = 0.2


@dataclass(frozen=True, kw_only=True)
class VisibleStem:
    """A stem in the plot's frame.

    Attributes
    ----------
    center: (2,) float64, plan position at 1.3 m.
    radius: metres; from one side only it is a rough guess.
    lean: (2,) metres sideways for each metre up.
    """

    center: Floats
    radius: float
    lean: Floats


def join_stems(surface: Sequence[Stem], sparse: Sequence[SparseStem]) -> list[VisibleStem]:
    """Stems of the surface, and those of the sparse points that stand where it has none.

    A surface seen from afar is too rough to be told from a shrub; the sparse points on it may lie on a circle.
    """
    joined = [
        VisibleStem(
            center=np.asarray(stem.axis.center_at(BREAST_HEIGHT_M)),
            radius=float(stem.axis.radius_m),
            lean=np.asarray(stem.axis.parameters[2:4]),
        )
        for stem in surface
    ]
    known = list(joined)
    for stem in sparse:
        gaps = [np.linalg.norm(stem.center - other.center) - max(stem.radius, other.radius) for other in known]
        if min(gaps, default=np.inf) > _SAME_M:
            joined.append(VisibleStem(center=stem.center, radius=stem.radius, lean=stem.lean))
    return joined

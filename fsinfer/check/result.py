"""What a check of a capture found."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.check.compass import Compass
from fsinfer.check.coverage import StemCoverage
from fsinfer.check.open_sides import OpenSide

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """What was found.

    Attributes
    ----------
    photos, registered: given and placed.
    lines: what to do again, most important first; empty when nothing.
    notes: what was found otherwise: photos, boards, stems.
    stems: every stem with how it was seen, plan coordinates in metres.
    cameras: (P, 2) plan positions of the placed photos, in the order of ``names``.
    compass: how the map is turned.
    metric: lengths are known, not guessed from the height at which people hold a phone.
    sides: along which no photo was placed.
    map_path: the picture; None where no stem was found.
    seconds: by step.
    """

    photos: int
    registered: int
    lines: tuple[str, ...]
    notes: tuple[str, ...]
    stems: tuple[StemCoverage, ...]
    cameras: Floats
    names: tuple[str, ...]
    compass: Compass
    metric: bool
    sides: tuple[OpenSide, ...]
    map_path: Path | None
    seconds: dict[str, float]

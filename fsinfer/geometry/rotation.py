"""Rotations of space as (3, 3) matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


def turn_deg(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Angle of the turn between two rotations (3, 3), degrees."""
    return float(np.degrees(Rotation.from_matrix(one @ other.T).magnitude()))

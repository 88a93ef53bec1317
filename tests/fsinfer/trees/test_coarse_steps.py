"""What is said of a cloud whose coordinates come in coarse steps."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.errors import CloudError
from fsinfer.trees import measure_trees


@pytest.mark.parametrize(("unit", "off"), [(1000.0, 0.0), (1.0, 6_000_000.0)], ids=["millimetres", "single precision"])
def test_the_way_out_fits_the_cause(unit: float, off: float) -> None:
    rng = np.random.default_rng(1)
    metres = rng.uniform([0, 0, 0], [20.0, 20.0, 3.0], (5000, 3)) + np.array([off, 0.0, 0.0])
    points = np.rint(metres * unit) if unit > 1.0 else metres.astype(np.float32).astype(np.float64)
    said = r"in steps of 100 cm.*--scale 0\.001" if unit > 1.0 else "in steps of 50 cm.*single precision"
    with pytest.raises(CloudError, match=said):
        measure_trees(points)


@pytest.mark.parametrize("voxel_m", [0.04, 0.05])
def test_a_cloud_thinned_to_voxels_is_not_told_of_single_precision(voxel_m: float) -> None:
    rng = np.random.default_rng(1)
    points = np.rint(rng.uniform([0, 0, 0], [20.0, 20.0, 3.0], (5000, 3)) / voxel_m) * voxel_m
    with pytest.raises(CloudError, match=r"in steps of [45] cm.*thinned to a grid") as told:
        measure_trees(points)
    assert "single precision" not in str(told.value)

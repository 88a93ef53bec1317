"""What is said of a cloud whose coordinates come in coarse steps."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.errors import CloudError
from fsinfer.trees import measure_trees
from fsinfer.trees.sanity import SanitySettings, check_unit


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


@pytest.mark.parametrize("middle", [0.0, 4000.0])
@pytest.mark.parametrize(
    ("wide_m", "said"), [(0.2, "only 20.0 cm wide"), (0.4, None), (600.0, None), (800.0, "800 m wide")]
)
def test_a_cloud_is_in_metres_by_its_width_wherever_it_lies(wide_m: float, said: str | None, middle: float) -> None:
    # The longer side counts.
    box = middle + np.array([[-wide_m / 2, -0.1], [wide_m / 2, 0.1]])
    if said is None:
        check_unit(box, SanitySettings())
    else:
        with pytest.raises(CloudError, match=said):
            check_unit(box, SanitySettings())

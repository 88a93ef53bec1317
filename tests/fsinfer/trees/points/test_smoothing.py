"""What averaging over patches takes off a stem is put back, where the cloud tells how large a pixel is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.trees import analyse_plot
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.points.smoothing import PATCH_PX, unsmoothed
from tests.support.stem_clouds import stem_plot

Floats = NDArray[np.float64]


def averaged(radius_m: float, patch_m: float, azimuth: float) -> Floats:
    """The mean (2,) of a patch of a circle whose arc lengths about ``azimuth`` are normal with this deviation."""
    arc = np.linspace(-6.0, 6.0, 2001) * patch_m / radius_m
    weight = np.exp(-0.5 * (arc * radius_m / patch_m) ** 2)
    circle = radius_m * np.column_stack([np.cos(azimuth + arc), np.sin(azimuth + arc)])
    return np.asarray(weight @ circle / weight.sum())


@given(
    radius_m=st.floats(0.03, 0.6),
    share=st.floats(0.01, 0.5),
    azimuth=st.floats(-3.2, 3.2),
    lean=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    height_m=st.floats(-1.0, 1.0),
)
def test_the_mean_of_a_patch_goes_back_to_its_circle(
    radius_m: float, share: float, azimuth: float, lean: tuple[float, float], height_m: float
) -> None:
    patch_m = share * radius_m
    axis = np.array([4.0, -2.0, *lean, radius_m, 0.0])
    middle = axis[:2] + axis[2:4] * height_m
    point = np.array([*(middle + averaged(radius_m, patch_m, azimuth)), 1.3 + height_m])
    (off,) = PointErrors(std_m=np.zeros(1), normals=None, pixel_m=np.array([patch_m / PATCH_PX])).beside(point[None])
    (moved,) = unsmoothed(off[None], axis, 1.3)
    before = radius_m - np.hypot(*(point[:2] - middle))
    after = radius_m - np.hypot(*(moved[:2] - middle))
    assert before == pytest.approx(patch_m**2 / (2.0 * radius_m), rel=0.07)
    assert abs(after) < 0.07 * before
    assert moved[2:].tolist() == off[2:].tolist()
    assert off[:3].tolist() == point.tolist()  # what was given stays


def test_patches_that_are_as_large_as_the_stem_do_not_blow_it_up() -> None:
    axis = np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0])
    points = np.array([[0.05, 0.0, 1.3], [0.0, 0.0, 1.3]])
    huge = PointErrors(std_m=np.zeros(2), normals=None, pixel_m=np.full(2, 1.0)).beside(points)
    moved = unsmoothed(huge, axis, 1.3)
    assert moved[0, :2] == pytest.approx([0.05 + 0.05 / 8.0, 0.0])
    assert moved[1, :2].tolist() == [0.0, 0.0]  # on the axis no way is outward


def test_clouds_that_do_not_tell_are_left_alone() -> None:
    axis = np.array([0.0, 0.0, 0.0, 0.0, 0.05, 0.0])
    points = np.array([[0.05, 0.0, 1.3]])
    assert unsmoothed(points, axis, 1.3) is points
    std_alone = PointErrors(std_m=np.full(1, 0.002), normals=None).beside(points)
    assert unsmoothed(std_alone, axis, 1.3).tolist() == std_alone.tolist()


def test_thin_stems_seen_from_far_are_not_too_thin() -> None:
    plot = stem_plot(trees=4, seed=8, slope=0.05, lean_deg=2.0, spacing_m=0.014)
    nearest = np.argmin(np.linalg.norm(plot.points[:, None, :2] - plot.xy[None], axis=2), axis=1)
    outward = plot.points[:, :2] - plot.xy[nearest]
    distance = np.linalg.norm(outward, axis=1)
    on_stem = (distance < 0.35) & (plot.points[:, 2] > plot.z_ground[nearest] + 0.3)
    away = np.zeros((len(distance), 3))
    away[on_stem, :2] = outward[on_stem] / distance[on_stem, None]
    patch_m = 0.025
    points = plot.points.copy()
    points[on_stem] -= away[on_stem] * (patch_m**2 / (2.0 * distance[on_stem, None]))
    normals = np.where(on_stem[:, None], away, [0.0, 0.0, 1.0])
    pixel_m = np.full(len(points), patch_m / PATCH_PX)

    def measured_cm(xyz: Floats, pixel: Floats | None) -> Floats:
        told = PointErrors(std_m=np.full(len(points), 0.002), normals=normals, pixel_m=pixel)
        trees = analyse_plot(xyz, errors=told).trees
        assert len(trees) == 4
        found = {plot.stem_at(tree.x_m, tree.y_m): tree.dbh_cm for tree in trees}
        return np.array([found[number] for number in range(4)], dtype=np.float64)

    sharp, thin, restored = measured_cm(plot.points, None), measured_cm(points, None), measured_cm(points, pixel_m)
    taken_cm = 200.0 * patch_m**2 / (0.01 * plot.dbh_cm)  # 2 s^2 / 2R
    assert sharp - thin == pytest.approx(taken_cm, rel=0.25)
    assert restored == pytest.approx(sharp, abs=0.1)
    assert taken_cm.min() > 0.4

"""Sharp faces of a cloud on the sides of a stem that no edge is seen of."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.silhouettes.surface import points_about
from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.faces import Faces, FaceSettings, SupportFunction, sharp_faces
from fsinfer.trees.diameter.sides import NOISE_SECTORS
from fsinfer.trees.diameter.silhouette import _clustered_variance, fit_silhouette
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings
from training.simulate.stem_edges import edges_from_rows

OVAL = SupportFunction(
    radius_m=0.2,
    taper=-0.01,
    shift_m=np.array([0.02, -0.01]),
    slope=np.array([0.03, 0.02]),
    shape_m=np.array([0.012, 0.005, 0.002, -0.003]),
)
TO_THE_SIDES = np.isin(np.arange(NOISE_SECTORS), [4, 5, 6, 7, 16, 17, 18, 19])


def surface_at(normal: NDArray[np.float64], height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (N, 2) of the curve that ``OVAL`` is the support function of: x = p n + p' n'."""
    step = 1e-6
    p = OVAL.at(normal, height)
    slope = (OVAL.at(normal + step, height) - OVAL.at(normal - step, height)) / (2 * step)
    n = np.column_stack([np.cos(normal), np.sin(normal)])
    return np.asarray(p[:, None] * n + slope[:, None] * np.column_stack([-n[:, 1], n[:, 0]]))


@given(normal=st.floats(-3.0, 3.0), height=st.floats(-0.25, 0.25))
def test_the_normal_of_a_point_on_the_section_is_found(normal: float, height: float) -> None:
    at, h = np.array([normal]), np.array([height])
    found = OVAL.normals_at(surface_at(at, h), h)
    # To second order in the oval; the direction of the point itself is up to 9 degrees beside.
    assert np.degrees(np.abs(np.angle(np.exp(1j * (found - at))))) == pytest.approx(0.0, abs=2.5)


def faces_of_bark(*, scatter_m: float = 0.001, inside_m: float = 0.0) -> Faces | None:
    rng = np.random.default_rng(0)
    normal, height = rng.uniform(-np.pi, np.pi, 6000), rng.uniform(-0.25, 0.25, 6000)
    off = rng.normal(-inside_m, scatter_m, 6000)
    points = surface_at(normal, height) + off[:, None] * np.column_stack([np.cos(normal), np.sin(normal)])
    return sharp_faces(points, height, OVAL, TO_THE_SIDES)


def test_faces_lie_on_the_surface_of_the_sides_that_are_not_seen() -> None:
    faces = faces_of_bark(inside_m=0.005)
    assert faces is not None
    assert set(faces.sector.tolist()) == set(np.flatnonzero(~TO_THE_SIDES).tolist())
    expected = OVAL.at(faces.angle_rad, np.zeros(len(faces.angle_rad))) - 0.005
    np.testing.assert_allclose(faces.support_m, expected, atol=0.0005)
    np.testing.assert_allclose(faces.std_m, np.hypot(0.003, 0.001), atol=0.0003)
    assert faces_of_bark(scatter_m=0.008) is None
    assert faces_of_bark(scatter_m=0.005) is not None
    assert faces_of_bark(inside_m=0.15) is None  # something else


def edges_to_the_sides(radius: float) -> Edges:
    rng = np.random.default_rng(1)
    rows = [
        (radius + rng.normal(0, 0.001), np.radians(direction) + np.pi * (0.5 + side), height, 8.0, 0.004,
         (photo * 2 + side) * 6 + band, photo)
        for photo, direction in enumerate(np.arange(-30.0, 31.0, 5.0))
        for side in (0, 1)
        for band, height in enumerate(np.linspace(-0.2, 0.2, 6))
    ]  # fmt: skip
    return edges_from_rows(rows)


def test_the_hull_lies_outside_of_the_points() -> None:
    """By 0.7 % of the radius, which the fit knows where nothing else is left open."""
    at = np.radians(np.r_[np.arange(-37.5, 40.0, 15.0), np.arange(142.5, 220.0, 15.0)])
    faces = Faces(angle_rad=at, support_m=np.full(len(at), 0.2 * 0.993), std_m=np.full(len(at), 0.001))
    tight = FaceSettings(alike_std_m=(1e-5,) * 5)
    fit = fit_silhouette(
        edges_to_the_sides(0.2), 0.2, taper=0.0, faces=faces, settings=SilhouetteSettings(faces=tight)
    )  # fmt: skip
    assert fit is not None
    assert fit.radius_m == pytest.approx(0.2, abs=0.0004)
    assert fit.faces == len(at)


def test_the_error_of_faces_is_in_that_of_the_radius_and_their_misfit_is_told() -> None:
    at = np.radians(np.r_[np.arange(-37.5, 40.0, 15.0), np.arange(142.5, 220.0, 15.0)])
    tight = SilhouetteSettings(faces=FaceSettings(alike_std_m=(1e-5,) * 5))
    fits = []
    for std, off in ((0.0005, 0.0), (0.01, 0.0), (0.002, 0.008)):
        support = 0.2 * 0.993 + np.where(np.arange(len(at)) % 2, off, -off)
        faces = Faces(angle_rad=at, support_m=support, std_m=np.full(len(at), std))
        fit = fit_silhouette(edges_to_the_sides(0.2), 0.2, taper=0.0, faces=faces, settings=tight)
        assert fit is not None
        fits.append(fit)
    assert fits[1].std_m > 1.3 * fits[0].std_m
    assert fits[1].faces_misfit < 0.1
    assert fits[2].faces_misfit == pytest.approx(16.0, rel=0.15)


def test_what_faces_are_off_by_is_in_the_variance_beside_what_edges_are() -> None:
    rng = np.random.default_rng(3)
    scores, covariance = rng.normal(0, 1.0, (40, 3)), np.diag([0.5, 0.2, 0.1])
    sector, prior, by_faces = np.arange(40) % 10, np.zeros(3), np.diag([3.0, 0.0, 0.0])
    without = _clustered_variance(covariance, scores, sector, prior, 0 * by_faces)[0]
    assert without > covariance[0, 0]
    assert _clustered_variance(covariance, scores, sector, prior, by_faces)[0] == pytest.approx(without + 0.75)


def test_the_points_of_a_leaning_stem_are_counted_from_its_axis() -> None:
    along = np.array([0.3, -0.2, 1.0]) / np.linalg.norm([0.3, -0.2, 1.0])
    stem = StemAxis(breast=np.array([5.0, -3.0, 1.3]), along=along, radius_m=0.2, taper=0.0)
    rng = np.random.default_rng(4)
    offsets, height = rng.uniform(-0.25, 0.25, (500, 2)), rng.uniform(-0.5, 0.5, 500)
    first, second = stem.across
    xyz = stem.breast + offsets[:, :1] * first + offsets[:, 1:] * second + height[:, None] * along
    far = xyz + np.array([2.0, 0.0, 0.0])
    for length in (0.25, 0.4):
        found, at = points_about(np.concatenate([far, xyz]), stem, settings=FaceSettings(half_length_m=length))
        kept = np.abs(height) < length
        np.testing.assert_allclose(found, offsets[kept], atol=1e-9)
        np.testing.assert_allclose(at, height[kept], atol=1e-9)

"""The volume of planes that are the same for all pixels, against the definition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.depth import plane_volume
from fsinfer.depth.cost_volume import Features, correlation_volume_reference, plane_inverse_depths
from fsinfer.depth.plane_volume import Tile, plane_correlation_volume, planes_inside
from fsinfer.depth.warping import Projection, pixel_coordinates, source_coordinates
from fsinfer.threads import blas_architecture

SHAPE = (13, 37)
#: Sideways, so that the nearest planes leave the picture; ahead, so that some lie behind the source; far away; and
#: turned away, so that the farthest planes are beside the picture.
PROJECTIONS = [
    Projection(matrix=np.eye(3), offset=np.array([60.0, 0.3, 0.0])),
    Projection(matrix=np.array([[1, 0.02, -3], [-0.02, 1, 2], [0, 1e-3, 1]]), offset=np.array([-4.0, 5.0, -2.0])),
    Projection(matrix=np.eye(3), offset=np.array([0.0, -900.0, 0.0])),
    Projection(matrix=np.array([[1.0, 0, 45], [0, 1, 0], [0, 0, 1]]), offset=np.array([-60.0, 0.0, 0.0])),
]


def maps(count: int, channels: int = 8) -> list[NDArray[np.float32]]:
    rng = np.random.default_rng(5)
    return [rng.normal(size=(channels, *SHAPE)).astype(np.float32) for _ in range(count)]


@pytest.mark.parametrize("together", [1, 4])
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("tile", [(2, 160), (3, 8), (1, 1)])
def test_it_is_what_the_definition_says(
    together: int, threads: int, tile: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plane_volume, "_planes_together", lambda: together)
    monkeypatch.setattr(plane_volume, "TILE_ROWS", tile[0])
    monkeypatch.setattr(plane_volume, "TILE_COLUMNS", tile[1])
    planes = plane_inverse_depths(0.8, 9.0, 24, inverse=True)
    views = maps(5)
    features = [Features.from_chw(view) for view in views]
    volume, weights = plane_correlation_volume(features[0], features[1:], PROJECTIONS, planes, threads=threads)
    hwc = [view.transpose(1, 2, 0) for view in views]
    expected, of_sources = correlation_volume_reference(hwc[0], hwc[1:], PROJECTIONS, planes[:, None, None])
    np.testing.assert_allclose(volume, expected, atol=2e-5)
    np.testing.assert_allclose(weights, of_sources, atol=2e-5)
    # Nothing of the reference lies in the third one but on the farthest planes: it knows next to nothing.
    assert weights[2].max() < 0.2
    assert ((weights > 0) & (weights <= 1)).all()


def test_planes_that_no_step_divides_are_taken_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plane_volume, "_planes_together", lambda: 4)
    planes = plane_inverse_depths(1.0, 9.0, 7, inverse=True)
    views = maps(2)
    features = [Features.from_chw(view) for view in views]
    volume, _ = plane_correlation_volume(features[0], features[1:], PROJECTIONS[:1], planes)
    hwc = [view.transpose(1, 2, 0) for view in views]
    expected, _ = correlation_volume_reference(hwc[0], hwc[1:], PROJECTIONS[:1], planes[:, None, None])
    np.testing.assert_allclose(volume, expected, atol=2e-5)


def test_coordinates_of_a_tile_are_those_of_the_planes() -> None:
    planes = plane_inverse_depths(0.5, 9.0, 16, inverse=True)
    x, y = source_coordinates(PROJECTIONS[1], planes[:, None, None], 0, SHAPE[1], SHAPE[0])
    assert (x == x.min()).any()  # some are behind the source
    v, u = np.array([3, 7, 12]), np.array([10, 0, 36])
    for found, whole in zip(pixel_coordinates(PROJECTIONS[1], planes, u * 1.0, v * 1.0), (x, y), strict=True):
        np.testing.assert_array_equal(found, whole[:, v, u].T)


@settings(max_examples=60, deadline=None)
@given(
    offset=st.tuples(*[st.floats(-50, 50)] * 2, st.floats(-5, 5)),
    turn=st.floats(-0.5, 0.5),
    corner=st.tuples(st.integers(0, 12), st.integers(0, 36)),
    together=st.sampled_from([1, 4]),
)
def test_no_plane_that_a_tile_lies_on_is_left_out(
    offset: tuple[float, float, float], turn: float, corner: tuple[int, int], together: int
) -> None:
    matrix = np.array([[1, turn, 0], [-turn, 1, 0], [turn / 30, 0, 1]])
    projection = Projection(matrix=matrix, offset=np.array(offset))
    planes = plane_inverse_depths(0.5, 9.0, 32, inverse=True)
    rows, columns = (slice(c, min(c + 6, size)) for c, size in zip(corner, SHAPE, strict=True))
    v, u = (line.ravel().astype(np.float64) for line in np.mgrid[rows, columns])
    x, y = pixel_coordinates(projection, planes, u, v)
    inside = np.asarray((x > -1) & (x < SHAPE[1]) & (y > -1) & (y < SHAPE[0]), bool).any(axis=0)
    tiles = [Tile(rows=slice(0, 1), columns=slice(0, 1)), Tile(rows=rows, columns=columns)]
    first, last = planes_inside(projection, planes, tiles, SHAPE, together)[1]
    assert first % together == last % together == 0
    seen = np.flatnonzero(inside)
    assert len(seen) == 0 or first <= seen[0] <= seen[-1] < last


def test_the_library_names_its_processor() -> None:
    assert isinstance(blas_architecture(), str)
    assert plane_volume._planes_together() in {1, 4}

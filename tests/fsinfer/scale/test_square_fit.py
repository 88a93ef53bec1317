"""The square behind many detections: the fast errors against plain ones, and two places of one number told apart."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.scale.square_fit import MarkerSettings, Sighting, _corner_errors_px, find_markers

Floats = NDArray[np.float64]
SQUARE = 0.25 * np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])


def camera(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Projection (3, 4) and centre of a camera some metres before the origin that looks at it."""
    center = np.array([rng.uniform(-2, 2), rng.uniform(-1, 1), rng.uniform(-6, -3)])
    ahead = -center / np.linalg.norm(center)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(ahead, right), ahead])
    return np.diag([800.0, 800.0, 1.0]) @ np.column_stack([turn, -turn @ center]), center


def seen(corners: Floats, projection: Floats) -> Floats:
    projected = corners @ projection[:, :3].T + projection[:, 3]
    return np.asarray(projected[:, :2] / projected[:, 2:])


def plain_error_px(corners: Floats, projection: Floats, pixels: Floats) -> float:
    """As it is defined, one detection at a time."""
    projected = corners @ projection[:, :3].T + projection[:, 3]
    if (projected[:, 2] <= 0).any():
        return float("inf")
    return float(np.linalg.norm(projected[:, :2] / projected[:, 2:] - pixels, axis=1).max())


def test_errors_of_all_detections_at_once_are_those_of_each() -> None:
    rng = np.random.default_rng(1)
    projections = [camera(rng)[0] for _ in range(40)]
    pixels = np.array([seen(SQUARE, p) + rng.normal(0, 3, (4, 2)) for p in projections])
    projections[7] = np.diag([1.0, 1.0, -1.0]) @ projections[7]  # all of it behind
    fast = _corner_errors_px(SQUARE, np.array(projections), pixels)
    plain = [plain_error_px(SQUARE, p, found) for p, found in zip(projections, pixels, strict=True)]
    np.testing.assert_allclose(fast, plain, rtol=1e-12)
    assert np.isinf(fast[7])


def test_one_number_in_two_places_is_two_markers_and_a_view_counts_once_for_each() -> None:
    rng = np.random.default_rng(2)
    cameras = [camera(rng) for _ in range(60)]
    places = [SQUARE, SQUARE + np.array([0.8, 0.1, 0.3])]
    sightings = []
    for view, (projection, _) in enumerate(cameras):
        for place in places:
            pixels = seen(place, projection) + rng.normal(0, 0.2, (4, 2))
            sightings.append(Sighting(marker_id=3, view=view, corners_px=pixels))
        # The same detection again, worse: it must not count beside the better one.
        sightings.append(Sighting(marker_id=3, view=view, corners_px=pixels + 0.8))
    found, reasons = find_markers(
        sightings, [p for p, _ in cameras], np.array([c for _, c in cameras]), MarkerSettings(gate_px=2.0)
    )
    assert len(found) >= 2, reasons
    near = sorted(found[:2], key=lambda marker: float(marker.corners.mean(axis=0)[0]))
    for marker, place in zip(near, places, strict=True):
        assert len({sighting.view for sighting in marker.sightings}) == len(marker.sightings) == len(cameras)
        np.testing.assert_allclose(marker.corners.mean(axis=0), place.mean(axis=0), atol=0.002)
        assert marker.side_units == pytest.approx(0.25, abs=0.002)

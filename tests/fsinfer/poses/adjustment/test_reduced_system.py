"""The equations without points: the same step as from all equations at once."""

from __future__ import annotations

import numpy as np
import pytest

from fsinfer.poses.adjustment.reduced_system import Rows, Structure, blocks_of, reduce_points, solve
from tests.support.phone_walk import observations

PHOTOS, POINTS, OWN = 4, 30, 5


@pytest.mark.parametrize("lens", [3, 0], ids=["lens", "no lens may change"])
def test_step_is_that_of_all_equations_at_once(lens: int) -> None:
    rng = np.random.default_rng(3)
    seen_by = np.argwhere(rng.random((PHOTOS, POINTS)) < 0.9)
    # A wrong match may put a point twice into one photo.
    seen_by = np.vstack([seen_by, seen_by[:3], seen_by[-4:]])
    photo, point = seen_by[np.argsort(seen_by[:, 0], kind="stable")].T
    count = len(photo)
    rows = Rows(
        residuals=rng.normal(size=(count, 2)),
        by_photo=rng.normal(size=(count, 2, OWN)),
        by_point=rng.normal(size=(count, 2, 3)),
        by_lens=rng.normal(size=(count, 2, lens)),
    )
    seen = observations(photo, point, PHOTOS)
    structure = Structure(seen, POINTS)
    blocks = blocks_of(structure, rows)
    size = PHOTOS * OWN + lens
    jacobian = np.zeros((count, 2, size + 3 * POINTS))
    for row in range(count):
        jacobian[row, :, photo[row] * OWN : (photo[row] + 1) * OWN] = rows.by_photo[row]
        jacobian[row, :, PHOTOS * OWN : size] = rows.by_lens[row]
        jacobian[row, :, size + 3 * point[row] : size + 3 * point[row] + 3] = rows.by_point[row]
    flat = jacobian.reshape(2 * count, -1)
    normal = flat.T @ flat
    for damping in (1e-3, 0.1):
        cameras, points = solve(structure, reduce_points(structure, blocks, damping))
        damped = normal + damping * np.diag(np.diag(normal))
        expected = -np.linalg.solve(damped, flat.T @ rows.residuals.ravel())
        np.testing.assert_allclose(cameras, expected[:size], atol=1e-7)
        np.testing.assert_allclose(points.ravel(), expected[size:], atol=1e-7)

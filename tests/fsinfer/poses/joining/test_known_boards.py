"""All sightings of known boards at once against each by itself, as the errors are defined."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.poses.boards import Board, BoardSighting
from fsinfer.poses.joining.known_boards import KnownBoards
from tests.fsinfer.poses.joining.test_parts import SQUARE, walked

pytest.importorskip("pycolmap")
Floats = NDArray[np.float64]


def plain_residual(faces: list[Floats], pose: Floats, rays: Floats) -> Floats:
    """Of the face that fits best; infinite where one of its corners is behind the camera."""
    errors = []
    for corners in faces:
        at = corners @ pose[:, :3].T + pose[:, 3]
        behind = (at[:, 2] <= 0).any()
        errors.append(np.full((4, 2), np.inf) if behind else at[:, :2] / at[:, 2:] - rays)
    return min(errors, key=lambda error: float(np.abs(error).max()))


@pytest.mark.parametrize("back", [False, True])
def test_residuals_are_those_of_each_sighting_and_its_best_face(*, back: bool) -> None:
    part = walked()
    rng = np.random.default_rng(3)
    # One number in three places, one of them behind every camera, another in one, with corners behind some.
    places = {4: [SQUARE, np.add(SQUARE, [0.3, 0.2, 0.1]), np.add(SQUARE, [40.0, 0, 0])], 9: [12 * SQUARE]}
    boards = [Board(number=number, corners=c, sightings=()) for number, all_of in places.items() for c in all_of]
    sightings = [
        BoardSighting(file=f"{k % 12:02d}.jpg", number=(4, 9, 77)[k % 3], corners_px=rng.uniform(300, 800, (4, 2)))
        for k in range(30)
    ]
    known = KnownBoards(
        boards, part, [*sightings, BoardSighting(file="no.jpg", number=4, corners_px=np.zeros((4, 2)))], back=back
    )
    assert len(known) == 20  # the number 77 is no board of the model, and a photo is not in the part
    place = np.eye(4)
    place[:3, :3] = 1.1 * Rotation.from_rotvec([0.1, -0.2, 0.05]).as_matrix()
    place[:3, 3] = 0.2, 0.1, -0.3
    there = place if back else np.linalg.inv(place)
    expected = []
    for sighting in (s for s in sightings if s.number != 77):
        image = next(i for i in part.images.values() if i.name == sighting.file)
        rays = part.cameras[image.camera_id].cam_from_img(sighting.corners_px)
        faces = [corners @ there[:3, :3].T + there[:3, 3] for corners in places[sighting.number]]
        expected.append(plain_residual(faces, image.cam_from_world().matrix(), rays))
    np.testing.assert_allclose(known.residuals(place), expected, rtol=1e-12)
    assert KnownBoards([], part, sightings).residuals(place).shape == (0, 4, 2)

"""Parts of a torn walk are put together by boards or by photos that both have, and only where that is sure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.geometry.similarity import apply, fit_similarity
from fsinfer.poses.boards import BoardSighting, boards_in, tie_boards
from fsinfer.poses.joining.parts import join_parts

pycolmap = pytest.importorskip("pycolmap")

PHOTOS = 12
#: Clockwise for who stands at +x; y is down.
SQUARE = np.array([[0.0, -1, -1], [0, -1, 1], [0, 1, 1], [0, 1, -1]])


def walked() -> Any:
    """Cameras in a half circle round a cloud of points, upright, with noise-free observations."""
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(
        model="SIMPLE_RADIAL", width=1200, height=900, params=[900.0, 600.0, 450.0, 0.01], camera_id=1
    )
    model.add_camera_with_trivial_rig(camera)
    rng = np.random.default_rng(5)
    cloud = rng.uniform(-1.5, 1.5, (300, 3))
    for number in range(PHOTOS):
        angle = np.pi * number / PHOTOS
        center = np.array([5 * np.sin(angle), 0.1 * number, -5 * np.cos(angle)])
        rotation = look_at(center)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ center)
        pixels = camera.img_from_cam(cloud @ rotation.T - rotation @ center)
        image = pycolmap.Image(f"{number:02d}.jpg", np.asarray(pixels), 1, number + 1)
        model.add_image_with_trivial_frame(image, pose)
    for index, xyz in enumerate(cloud):
        track = pycolmap.Track()
        for number in range(PHOTOS):
            track.add_element(number + 1, index)
        model.add_point3D(xyz, track, np.zeros(3, np.uint8))
    return model


def look_at(center: NDArray[np.float64]) -> NDArray[np.float64]:
    """cam_from_world rotation of an upright camera (y down) that looks at the origin."""
    forward = -center / np.linalg.norm(center)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def part_of(model: Any, numbers: range, *, moved: bool = False) -> Any:
    """A reconstruction of some of the photos, as the mapper leaves it; ``moved`` into a frame of its own."""
    part = pycolmap.Reconstruction(model)
    for image_id in list(part.reg_image_ids()):
        if image_id - 1 not in numbers:
            part.deregister_frame(part.images[image_id].frame_id)
    part.tear_down()
    if moved:
        turn = pycolmap.Rotation3d(Rotation.from_rotvec([0.1, 2.0, -0.1]).as_quat())
        part.transform(pycolmap.Sim3d(0.4, turn, np.array([7.0, -2.0, 3.0])))
    return part


def sightings_of(model: Any, boards: dict[int, NDArray[np.float64]], numbers: range) -> list[BoardSighting]:
    found = []
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        if image_id - 1 not in numbers:
            continue
        matrix = image.cam_from_world().matrix()
        for number, corners in boards.items():
            pixels = np.asarray(model.cameras[1].img_from_cam(corners @ matrix[:, :3].T + matrix[:, 3]))
            found.append(BoardSighting(file=image.name, number=number, corners_px=pixels))
    return found


def boards(*centers: tuple[float, float, float]) -> dict[int, NDArray[np.float64]]:
    return {number: 0.15 * SQUARE + np.array(center) for number, center in enumerate(centers)}


def errors(model: Any, truth: Any) -> NDArray[np.float64]:
    ids = sorted(model.reg_image_ids())
    found = np.array([model.images[i].projection_center() for i in ids])
    true = np.array([truth.images[i].projection_center() for i in ids])
    aligned = fit_similarity(found, true)
    assert aligned is not None
    return np.asarray(np.linalg.norm(apply(aligned, found) - true, axis=1))


FIRST, SECOND = range(3, 7), range(7, 10)
WITHIN = range(3, 10)


def test_two_boards_join_parts_without_a_common_photo() -> None:
    truth = walked()
    model, part = part_of(truth, FIRST), part_of(truth, SECOND, moved=True)
    seen = sightings_of(truth, boards((0.8, 0, 0), (-0.7, 0.2, 0.3)), WITHIN)
    gained, left = join_parts(model, [part], seen)
    assert gained == ["07.jpg", "08.jpg", "09.jpg"]
    assert left == []
    assert model.num_reg_images() == 7
    assert errors(model, truth).max() < 1e-3
    # Points of the part came along, and are seen from its photos.
    assert model.num_points3D() > 300
    assert model.compute_mean_reprojection_error() < 0.1


def test_without_boards_the_part_stays_alone_and_nothing_is_changed() -> None:
    truth = walked()
    model, part = part_of(truth, FIRST), part_of(truth, SECOND, moved=True)
    gained, left = join_parts(model, [part], [])
    assert (gained, left) == ([], [part])
    assert model.num_reg_images() == 4


def test_one_board_is_enough_only_where_the_points_agree() -> None:
    truth = walked()
    model, part = part_of(truth, FIRST), part_of(truth, SECOND, moved=True)
    seen = sightings_of(truth, boards((0.8, 0, 0)), WITHIN)
    assert join_parts(model, [part], seen, least_boards=2)[0] == []
    assert len(join_parts(model, [part], seen)[0]) == 3
    # The same number on another board, seen by the part alone: the points of both lie elsewhere.
    model, part = part_of(truth, FIRST), part_of(truth, SECOND, moved=True)
    seen = sightings_of(truth, boards((0.8, 0, 0)), FIRST)
    turned = 0.15 * SQUARE @ Rotation.from_euler("y", 70, degrees=True).as_matrix() + np.array([-0.5, 0, 1.0])
    seen += sightings_of(truth, {0: turned}, SECOND)
    gained, left = join_parts(model, [part], seen)
    assert (gained, left) == ([], [part])


def test_a_board_that_photos_see_from_its_edge_ends_in_no_fault() -> None:
    """Its corners lie on a line, and no place of the photo follows from them."""
    truth = walked()
    model, part = part_of(truth, WITHIN), part_of(truth, range(3), moved=True)
    places = boards((0.8, 0, 0), (-0.7, 0.2, 0.3))
    seen = sightings_of(truth, places, WITHIN) + sightings_of(truth, {1: places[1]}, range(3))
    assert join_parts(model, [part], seen)[0] == names(range(3))
    assert errors(model, truth).max() < 1e-3


def test_of_boards_that_contradict_each_other_the_majority_counts() -> None:
    truth = walked()
    model, part = part_of(truth, FIRST), part_of(truth, SECOND, moved=True)
    places = boards((0.8, 0, 0), (-0.7, 0.2, 0.3), (0.0, -0.6, 0.1))
    seen = sightings_of(truth, places, FIRST)
    places[2] = places[2] + np.array([0.0, 1.2, 0.5])
    seen += sightings_of(truth, places, SECOND)
    assert len(join_parts(model, [part], seen)[0]) == 3
    assert errors(model, truth).max() < 1e-3


def test_photos_that_both_have_join_them_and_share_their_points() -> None:
    truth = walked()
    model, part = part_of(truth, range(7)), part_of(truth, range(4, 10), moved=True)
    gained, _ = join_parts(model, [part], [])
    assert gained == ["07.jpg", "08.jpg", "09.jpg"]
    assert errors(model, truth).max() < 1e-6
    assert model.num_points3D() == 300
    assert model.compute_mean_track_length() == pytest.approx(10)


def test_corners_of_boards_become_points_of_all_their_photos() -> None:
    truth = walked()
    seen = sightings_of(truth, boards((0.8, 0, 0), (-0.7, 0.2, 0.3)), WITHIN)
    found = boards_in(truth, seen)
    assert [board.number for board in found] == [0, 1]
    assert tie_boards(truth, found) == 8
    assert truth.num_points3D() == 308
    truth.update_point_3d_errors()
    corners = [point for point in truth.points3D.values() if point.track.length() == len(WITHIN)]
    assert len(corners) == 8
    assert max(point.error for point in corners) < 1e-3


def names(numbers: range) -> list[str]:
    return [f"{number:02d}.jpg" for number in numbers]


def without_points(model: Any) -> Any:
    """A part that was mapped, whose points are its own and none of the rest's."""
    for point_id in list(model.point3D_ids()):
        model.delete_point3D(point_id)
    return model


def test_two_photos_of_boards_that_the_part_has_no_place_for_join_it() -> None:
    truth = walked()
    model, part = part_of(truth, FIRST), without_points(part_of(truth, SECOND, moved=True))
    seen = sightings_of(truth, boards((0.8, 0, 0), (-0.7, 0.2, 0.3)), FIRST)
    # One photo of the part sees one of the boards, another one the other, and a third one both.
    later = sightings_of(truth, boards((0.8, 0, 0), (-0.7, 0.2, 0.3)), SECOND)
    seen += [s for s in later if (s.file, s.number) in (("07.jpg", 0), ("08.jpg", 1), ("09.jpg", 0), ("09.jpg", 1))]
    assert [board.number for board in boards_in(part, seen)] == []
    gained, left = join_parts(model, [part], seen)
    assert (gained, left) == (names(SECOND), [])
    assert errors(model, truth).max() < 1e-3


def test_one_board_and_a_walk_that_goes_on_are_enough_and_a_leap_is_not() -> None:
    truth = walked()
    seen = sightings_of(truth, boards((0.8, 0, 0)), WITHIN)
    model, part = part_of(truth, FIRST), without_points(part_of(truth, SECOND, moved=True))
    assert join_parts(model, [part], seen)[0] == []  # nothing bears out the single board
    assert join_parts(model, [part], seen, walk=names(range(PHOTOS)))[0] == names(SECOND)
    assert errors(model, truth).max() < 1e-3
    # The board was carried to another place before the walk went on.
    seen = sightings_of(truth, boards((0.8, 0, 0)), FIRST)
    seen += sightings_of(truth, {0: boards((0.8, 0, 0))[0] + np.array([-6.0, 0.0, -2.0])}, SECOND)
    model, part = part_of(truth, FIRST), part_of(truth, SECOND, moved=True)
    assert join_parts(model, [part], seen, walk=names(range(PHOTOS)))[0] == []


def matched(path: Path, truth: Any, pairs: dict[tuple[int, int], NDArray[np.intp]]) -> Path:
    """A database of the photos in which these pairs, by number, have these matches."""
    with pycolmap.Database.open(path) as opened:
        opened.write_camera(truth.cameras[1], use_camera_id=True)
        for number in range(PHOTOS):
            image = pycolmap.Image(name=f"{number:02d}.jpg", camera_id=1, image_id=number + 1)
            opened.write_image(image, use_image_id=True)
        for (one, other), matches in pairs.items():
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED.value
            geometry.inlier_matches = matches.astype(np.uint32)
            opened.write_two_view_geometry(one + 1, other + 1, geometry)
    return path


def test_points_that_matches_say_are_common_join_parts_though_most_are_false(tmp_path: Path) -> None:
    truth = walked()
    rng = np.random.default_rng(3)
    true = np.arange(40)
    pairs = {}
    for one in FIRST:
        for other in SECOND:
            false = np.column_stack([rng.permutation(300)[:60], rng.permutation(300)[:60]])
            pairs[one, other] = np.vstack([np.column_stack([true, true]), false])
    database = matched(tmp_path / "database.db", truth, pairs)
    model, part = part_of(truth, FIRST), part_of(truth, SECOND, moved=True)
    gained, _ = join_parts(model, [part], [], database=database)
    assert gained == names(SECOND)
    assert errors(model, truth).max() < 1e-3
    # With as many for another place, that of trees that look alike, neither is believed.
    second = {pair: np.vstack([matches[:20], shifted(truth, 20)]) for pair, matches in pairs.items()}
    database = matched(tmp_path / "alike.db", truth, second)
    model, part = part_of(truth, FIRST), part_of(truth, SECOND, moved=True)
    assert join_parts(model, [part], [], database=database)[0] == []


def shifted(truth: Any, count: int) -> NDArray[np.intp]:
    """Matches between points of the first half and their doubles, which are put two metres and a turn away."""
    turn = Rotation.from_euler("y", 25, degrees=True).as_matrix()
    ids = sorted(truth.point3D_ids())
    for k in range(count):
        original, double = truth.points3D[ids[100 + k]], truth.points3D[ids[200 + k]]
        double.xyz = 0.6 * turn @ original.xyz + np.array([0.5, 0.1, 0.8])
    for image_id in sorted(truth.reg_image_ids()):
        image = truth.images[image_id]
        matrix = image.cam_from_world().matrix()
        for k in range(count):
            xyz = truth.points3D[ids[200 + k]].xyz
            image.points2D[200 + k].xy = np.ravel(
                truth.cameras[1].img_from_cam((matrix[:, :3] @ xyz + matrix[:, 3])[None])
            )
    return np.column_stack([np.arange(100, 100 + count), np.arange(200, 200 + count)])


def test_two_boards_of_one_post_with_the_same_numbers_behind_do_not_turn_a_part_round() -> None:
    """Each part sees its own side: laid on each other's faces, the part would lie turned by half a circle."""
    truth = walked()
    facing = SQUARE @ Rotation.from_euler("y", 90, degrees=True).as_matrix().T  # for who stands at -z
    faces = {number: 0.15 * facing + np.array([0.0, 0.45 * number, 0.0]) for number in (0, 1)}
    backs = {number: corners * np.array([-1.0, 1.0, -1.0]) for number, corners in faces.items()}
    model, part = part_of(truth, range(3)), part_of(truth, range(9, 12), moved=True)
    seen = sightings_of(truth, faces, range(3)) + sightings_of(truth, backs, range(9, 12))
    assert join_parts(model, [part], seen)[0] == []

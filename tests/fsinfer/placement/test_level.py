from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsinfer.errors import CloudError
from fsinfer.io.cloud import read_cloud
from fsinfer.io.gravity import UPRIGHT
from fsinfer.placement.ground_plane import ground_plane
from fsinfer.placement.level import level
from fsinfer.placement.place import level_scene
from fsinfer.placement.up import estimate_up, sample_normals
from fsinfer.scene import Camera, Scene, View
from tests.support.apple_note import phone_photo
from tests.support.places import DATA

# Points, camera centres, and the image axes down and right of every camera.
Plot = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def angle_deg(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))))


def make_plot(
    *,
    slope_deg: float = 0.0,
    stems: int = 12,
    lean_deg: float = 0.0,
    together_deg: float = 0.0,
    pitch_deg: float = 20.0,
    roll_deg: float = 3.0,
    noise: float = 0.01,
    foliage: int = 0,
    seed: int = 0,
) -> Plot:
    """Points (z up), camera centres and image axes of a plot of 12 m with upright stems on a slope along x."""
    rng = np.random.default_rng(seed)
    slope = np.tan(np.radians(slope_deg))
    xy = rng.uniform(-6, 6, (15_000, 2))
    parts = [np.column_stack([xy, slope * xy[:, 0] + 0.05 * np.sin(3 * xy[:, 1])])]
    for _ in range(stems):
        base = rng.uniform(-5, 5, 2)
        angle, height = rng.uniform(0, 2 * np.pi, 1200), rng.uniform(0, 4, 1200)
        axis = Rotation.from_rotvec([*np.radians(rng.normal([together_deg, 0.0], lean_deg)), 0.0]).as_matrix()[:, 2]
        ring = 0.15 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(1200)])
        parts.append(ring + height[:, None] * axis + [base[0], base[1], slope * base[0]])
    parts.append(rng.uniform([-6, -6, 0.5], [6, 6, 4], (foliage, 3)))
    points = np.concatenate(parts)
    points += rng.normal(0, noise, points.shape)
    count = 40
    around = np.linspace(0, 2 * np.pi, count, endpoint=False)
    centers = np.column_stack([4 * np.cos(around), 4 * np.sin(around), np.zeros(count)])
    centers[:, 2] = slope * centers[:, 0] + 1.5
    pitch = np.radians(pitch_deg)
    forward = np.column_stack([-np.cos(around), -np.sin(around), np.full(count, -np.tan(pitch))])
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    roll = np.radians(rng.normal(0, roll_deg, count))[:, None]
    down = np.cross(forward, right)
    return points, centers, np.cos(roll) * down - np.sin(roll) * right, np.cos(roll) * right + np.sin(roll) * down


def move(
    parts: Plot, seed: int = 3, shift: tuple[float, float, float] = (40.0, -7.0, 12.0)
) -> tuple[NDArray[np.float64], Plot]:
    turn = Rotation.random(random_state=seed).as_matrix()
    points, centers, down, right = parts
    return turn, (points @ turn.T + shift, centers @ turn.T + shift, down @ turn.T, right @ turn.T)


@pytest.mark.parametrize(("slope_deg", "lean_deg"), [(0.0, 0.0), (15.0, 0.0), (15.0, 3.0), (25.0, 2.0)])
def test_up_is_gravity_not_the_normal_of_the_slope(slope_deg: float, lean_deg: float) -> None:
    turn, (points, centers, down, right) = move(make_plot(slope_deg=slope_deg, lean_deg=lean_deg))
    up, method = estimate_up(points, None, right, down, camera_centers=centers)
    assert method == "stems"
    assert angle_deg(up, turn[:, 2]) < (0.3 if lean_deg == 0 else 1.5)
    motion, _ = level(points, centers, down, camera_right=right)
    levelled = points @ motion[:3, :3].T + motion[:3, 3]
    ground = levelled[:15_000]
    near = np.hypot(ground[:, 0], ground[:, 1]) < 0.7
    assert abs(np.median(ground[near, 2])) < 0.12
    cameras = centers @ motion[:3, :3].T + motion[:3, 3]
    assert np.abs(np.median(cameras[:, :2], axis=0)).max() < 1e-9
    assert np.median(cameras[:, 2]) == pytest.approx(1.5, abs=0.15)
    np.testing.assert_allclose(motion[:3, :3] @ motion[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(motion[:3, :3]) == pytest.approx(1)


@pytest.mark.parametrize("lean_deg", [0.0, 2.0])
def test_a_stand_that_leans_together_does_not_read_as_upright(lean_deg: float) -> None:
    turn, (points, centers, down, right) = move(make_plot(together_deg=7.0, lean_deg=lean_deg))
    up, method = estimate_up(points, None, right, down, camera_centers=centers)
    assert method == "cameras and leaning stems"
    assert angle_deg(up, turn[:, 2]) < 2.0
    longer = right * np.linspace(0.3, 5.0, len(right))[:, None]
    np.testing.assert_allclose(estimate_up(points, None, longer, down, camera_centers=centers)[0], up, atol=1e-9)
    # Two photographs of 40 that look one way tell nothing against the stems.
    few = slice(0, 2)
    up, method = estimate_up(points, None, right[few], down[few], camera_centers=centers[few])
    assert method == "stems"
    assert angle_deg(up, turn[:, 2]) == pytest.approx(7.0, abs=1.5)


def test_without_stems_the_x_axes_of_the_cameras_say_up_whatever_the_pitch() -> None:
    turn, (points, centers, down, right) = move(make_plot(slope_deg=15, stems=0, pitch_deg=30))
    right[3] = turn[:, 2]  # one photograph with the phone turned by 90 degrees
    up, method = estimate_up(points, None, right, down, camera_centers=centers)
    assert method == "cameras"
    assert angle_deg(up, turn[:, 2]) < 1.5


def test_cameras_that_all_look_one_way_still_see_the_stems_upright() -> None:
    turn, (points, centers, down, right) = move(make_plot(slope_deg=10, pitch_deg=20))
    few = slice(0, 4)
    up, method = estimate_up(points, None, right[few], down[few], camera_centers=centers[few])
    assert method == "stems"
    assert angle_deg(up, turn[:, 2]) < 0.5
    up, _ = estimate_up(points[:15_000], None, right[few], down[few], camera_centers=centers[few])
    assert angle_deg(up, turn[:, 2]) < 25


def test_downward_axes_alone_find_stems_and_else_the_ground() -> None:
    parts = make_plot(pitch_deg=20)
    turn, (points, centers, down, _) = move(parts)
    half = slice(0, 10)
    up, method = estimate_up(points, None, None, down[half], camera_centers=centers[half])
    assert method == "stems"
    assert angle_deg(up, turn[:, 2]) < 0.5
    up, method = estimate_up(points[:15_000], None, None, down[half], camera_centers=centers[half])
    assert method == "ground"
    assert angle_deg(up, turn[:, 2]) < 1.5
    assert angle_deg(-down[half].mean(axis=0), turn[:, 2]) > 8


def test_foliage_is_no_stem() -> None:
    turn, (points, centers, down, right) = move(make_plot(slope_deg=15, stems=0, foliage=30_000))
    up, method = estimate_up(points, None, right, down, camera_centers=centers)
    assert method == "cameras"
    assert angle_deg(up, turn[:, 2]) < 1.5
    turn, (points, centers, down, right) = move(make_plot(slope_deg=15, stems=12, foliage=20_000))
    up, _ = estimate_up(points, None, right, down, camera_centers=centers)
    assert angle_deg(up, turn[:, 2]) < 0.6


def test_given_normals_are_used() -> None:
    turn, (points, centers, down, right) = move(make_plot())
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, len(points))
    # As if the stems all leaned by one degree along y: up must follow the normals, not the points.
    lean = Rotation.from_euler("x", 1, degrees=True).as_matrix()
    normals = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(points))]) @ lean.T @ turn.T
    up, _ = estimate_up(points, normals, right, down, camera_centers=centers)
    assert angle_deg(up, turn @ lean[:, 2]) < 0.1


def test_result_is_reproducible_and_independent_of_the_unit_and_the_origin() -> None:
    _, (points, centers, down, right) = move(make_plot(slope_deg=10))
    first, _ = level(points, centers, down, camera_right=right)
    np.testing.assert_array_equal(first, level(points, centers, down, camera_right=right)[0])
    scaled, _ = level(points * 0.05, centers * 0.05, down, camera_right=right)
    np.testing.assert_allclose(scaled[:3, :3], first[:3, :3], atol=1e-6)
    far = np.array([5e5, 5.4e6, 300])
    moved, _ = level(points + far, centers + far, down, camera_right=right)
    np.testing.assert_allclose(moved[:3, :3], first[:3, :3], atol=1e-6)


def test_georeferenced_model_keeps_its_heading() -> None:
    points, centers, down, right = make_plot(lean_deg=0, noise=0.005)
    motion, _ = level(points, centers, down, camera_right=right)
    np.testing.assert_allclose(motion[:3, :3], np.eye(3), atol=0.01)


def test_ground_plane_ignores_bushes_and_points_below() -> None:
    points, centers, _, _ = make_plot(slope_deg=12, foliage=20_000)
    rng = np.random.default_rng(0)
    below = points[rng.choice(15_000, 150)] - [0, 0, 1.0]
    plane = ground_plane(np.concatenate([points, below]), centers)
    assert plane is not None
    np.testing.assert_allclose(plane, [np.tan(np.radians(12)), 0, 0], atol=0.06)
    assert ground_plane(points + np.array([0, 0, 50]), centers) is None


@pytest.mark.parametrize("unit", [0.01, 100.0])
def test_the_ground_plane_is_the_same_in_any_unit(unit: float) -> None:
    points, centers, _, _ = make_plot(slope_deg=12, foliage=20_000)
    plane, other = ground_plane(points, centers), ground_plane(unit * points, unit * centers)
    assert plane is not None
    assert other is not None
    np.testing.assert_allclose(other, plane * [1.0, 1.0, unit], rtol=1e-6, atol=1e-9 * unit)


@pytest.mark.parametrize(("slope_deg", "is_ground"), [(25.0, True), (60.0, False)])
def test_a_rock_face_is_no_ground(slope_deg: float, is_ground: bool) -> None:
    points, _, _, _ = make_plot(slope_deg=slope_deg, stems=0)
    plane = ground_plane(points, np.array([[0.0, 0.0, 20.0]]))
    assert (plane is not None) == is_ground


def test_normals_of_a_plane() -> None:
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(0, 1, (2000, 2)), rng.normal(0, 1e-4, 2000)])
    normals = sample_normals(flat, 500)
    assert 400 < len(normals) <= 500
    assert np.abs(normals[:, 2]).min() > 0.99
    assert len(sample_normals(rng.uniform(0, 1, (2000, 3)), 500)) < 100


def test_too_little_is_a_user_error() -> None:
    points, centers, down, _ = make_plot()
    with pytest.raises(CloudError, match="too few to level"):
        level(points[:50], centers, down)
    with pytest.raises(CloudError, match="0 cameras"):
        level(points, centers[:0], down[:0])


def test_laser_scan_of_pines_is_found_upright() -> None:
    path = DATA / "clouds" / "pine_plot.laz"
    if not path.is_file():
        pytest.skip("shared/data/clouds is missing")
    points = read_cloud(path).xyz[::2]
    points -= np.median(points, axis=0)
    _, centers, down, right = make_plot()
    centers = centers * 0.5 + [0, 0, np.percentile(points[:, 2], 5)]
    turn, (points, centers, down, right) = move((points, centers, down, right))
    motion, _ = level(points, centers, down, camera_right=right)
    # The scanner stood level; pines are not quite straight.
    assert angle_deg(motion[2, :3], turn[:, 2]) < 2
    levelled = points @ motion[:3, :3].T + motion[:3, 3]
    near = np.hypot(levelled[:, 0], levelled[:, 1]) < 1.5
    assert abs(np.percentile(levelled[near, 2], 5)) < 0.2


def noted(turn: NDArray[np.float64], *, count: int = 12, error_deg: float = 1.2, seed: int = 5) -> NDArray[np.float64]:
    """Gravity as phones noted it, in the coordinates of a plot that was turned."""
    rng = np.random.default_rng(seed)
    return -turn[:, 2] + np.radians(rng.normal(0, error_deg, (count, 3)))


def test_noted_gravity_rights_one_leaning_tree_that_all_cameras_look_at_from_one_side() -> None:
    turn, (points, centers, down, right) = move(make_plot(stems=1, together_deg=7.0))
    few = slice(0, 6)
    up, method = estimate_up(points, None, right[few], down[few], camera_centers=centers[few])
    assert angle_deg(up, turn[:, 2]) > 3
    up, method = estimate_up(points, None, right[few], down[few], gravity=noted(turn), camera_centers=centers[few])
    assert method == "gravity and leaning stems"
    assert angle_deg(up, turn[:, 2]) < 1.2


def test_noted_gravity_is_enough_where_nothing_stands() -> None:
    turn, (points, centers, down, right) = move(make_plot(slope_deg=15, stems=0, pitch_deg=30))
    few = slice(0, 4)
    up, method = estimate_up(points, None, right[few], down[few], gravity=noted(turn), camera_centers=centers[few])
    assert method == "gravity"
    assert angle_deg(up, turn[:, 2]) < 1.2
    # One of twelve taken in a fall does not turn the plot.
    shaken = noted(turn)
    shaken[4] = turn[:, 0]
    up, method = estimate_up(points, None, right[few], down[few], gravity=shaken, camera_centers=centers[few])
    assert method == "gravity"
    assert angle_deg(up, turn[:, 2]) < 1.5


def test_upright_stems_are_surer_than_what_a_phone_noted() -> None:
    turn, (points, centers, down, right) = move(make_plot())
    up, method = estimate_up(points, None, right, down, gravity=noted(turn), camera_centers=centers)
    assert method == "stems"
    assert angle_deg(up, turn[:, 2]) < 0.3


@pytest.mark.parametrize("wrong", ["few", "at odds"])
def test_notes_that_are_worth_nothing_are_left_alone(wrong: str) -> None:
    turn, (points, centers, down, right) = move(make_plot(slope_deg=15, stems=0))
    gravity = noted(turn, count=3) if wrong == "few" else noted(turn, error_deg=20.0)
    up, method = estimate_up(points, None, right, down, gravity=gravity, camera_centers=centers)
    assert method == "cameras"
    assert angle_deg(up, turn[:, 2]) < 1.5


@pytest.mark.parametrize("pitch_deg", [-35.0, 0.0, 35.0])
def test_a_scene_stands_upright_whether_its_photographs_look_up_or_down(tmp_path: Path, pitch_deg: float) -> None:
    turn, (points, centers, down, right) = move(make_plot(pitch_deg=pitch_deg))
    views = []
    for number, center in enumerate(centers):
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right[number], down[number], np.cross(right[number], down[number])])
        pose[:3, 3] = -pose[:3, :3] @ center
        camera = Camera(intrinsic=np.diag([100.0, 100.0, 1.0]), cam_from_world=pose, depth_min=1.0, depth_max=9.0)
        views.append(View(name=str(number), image_path=tmp_path / f"{number}.jpg", camera=camera, sources=()))
    plot_from_scene, height, ground_seen = level_scene(points, Scene(folder=tmp_path, views=tuple(views)))
    assert angle_deg(plot_from_scene[2, :3], turn[:, 2]) < 1.0
    assert ground_seen
    assert height == pytest.approx(1.5, abs=0.1)


def test_a_scene_tells_gravity_by_the_notes_of_its_photographs(tmp_path: Path) -> None:
    parts = make_plot(stems=1, together_deg=7.0)
    turn, (points, centers, down, right) = move(parts)
    views = []
    for number in range(6):
        rows = np.stack([right[number], down[number], np.cross(right[number], down[number])])
        pose = np.eye(4)
        # The camera is that of the pixels that are stored: those of a phone held upright lie on their side.
        stored = UPRIGHT[6].T @ rows
        pose[:3, :3], pose[:3, 3] = stored, -stored @ centers[number]
        # The phone, held upright, feels gravity in its own axes: right, top, out of the screen.
        felt = np.array([1.0, -1.0, -1.0]) * (rows @ -turn[:, 2])
        image = phone_photo(tmp_path / f"{number}.jpg", list(felt), 6)
        camera = Camera(intrinsic=np.diag([100.0, 100.0, 1.0]), cam_from_world=pose, depth_min=1.0, depth_max=9.0)
        views.append(View(name=str(number), image_path=image, camera=camera, sources=()))
    plot_from_scene, _, _ = level_scene(points, Scene(folder=tmp_path, views=tuple(views)))
    assert angle_deg(plot_from_scene[2, :3], turn[:, 2]) < 1.0

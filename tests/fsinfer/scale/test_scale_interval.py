"""What a scale by boards may be off by: blooming edges, misprinted boards, a warped model (seeds 44020 to 44023)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.scale import aruco, marker_search
from fsinfer.scale.scale import MarkerDetails, Scale
from fsinfer.scale.square_fit import FittedMarker, Sighting
from fsinfer.scene import Camera, Scene, View
from tests.support.rendered_room import intrinsic, poses

VIEWS = 6
#: Top left corner, right and down directions of three boards in the room.
BOARDS = (
    (np.array([-0.75, 0.15, 0.25]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0])),
    (np.array([0.35, -0.45, 0.20]), np.array([0.96, 0.28, 0]), np.array([-0.28, 0.96, 0])),
    (np.array([-0.2, -0.25, 0.0]), np.array([0.9, 0, -np.sqrt(0.19)]), np.array([0, 1.0, 0])),
)


def corners(board: int, side: float, pose: NDArray[np.float64], bloom_px: float) -> NDArray[np.float64]:
    """Where a view sees the corners (4, 2), every edge shifted outwards by ``bloom_px``."""
    origin, right, down = BOARDS[board]
    world = origin + side * np.array([0 * right, right, right + down, down])
    projected = (world @ pose[:3, :3].T + pose[:3, 3]) @ intrinsic().T
    pixels = projected[:, :2] / projected[:, 2:]
    along = [(np.roll(pixels, -step, axis=0) - pixels) for step in (1, -1)]
    for edge in along:
        pixels = pixels - bloom_px * edge / np.linalg.norm(edge, axis=1, keepdims=True)
    return np.asarray(pixels)


@pytest.mark.parametrize(
    ("side", "least_px", "most_px", "bloom_px", "told"),
    [(0.2, 20, 30, 0.07, False), (0.2, 20, 30, 2.0, True), (1.2, 110, 220, 0.07, False)],
    ids=["far", "far, told", "near"],
)
def test_scales_are_off_by_what_they_say(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    side: float,
    least_px: float,
    most_px: float,
    bloom_px: float,
    told: bool,
) -> None:
    """Far boards are off by blooming, near ones by their print; a term half or twice as large leaves the bounds.

    Where markers tell the blooming, what they tell is a fifth off, as that of small and large ones differs.
    """
    cameras = [
        Camera(intrinsic=intrinsic(), cam_from_world=pose, depth_min=1.0, depth_max=9.0) for pose in poses(VIEWS)
    ]
    views = [View(name=f"v{i}", image_path=tmp_path / f"{i}", camera=c, sources=()) for i, c in enumerate(cameras)]
    scene = Scene(folder=tmp_path, views=tuple(views))
    rng = np.random.default_rng(44020 if side < 0.5 else 44021)
    errors = []
    for _ in range(14):
        bloom, misprint = rng.normal(0.0, bloom_px), rng.normal(0.0, 0.002)
        heard = bloom * (1 + 0.2 * rng.normal()) + rng.normal(0.0, 0.03) if told else None
        seen = {
            view.image_path: [
                (number, corners(number, side * (1 + misprint), view.camera.cam_from_world, bloom))
                for number in range(len(BOARDS))
            ]
            for view in scene.views
        }
        noise = {path: [(n, c + rng.normal(0.0, 0.1, (4, 2))) for n, c in found] for path, found in seen.items()}
        monkeypatch.setattr(marker_search, "read_view_image", lambda view: view.image_path)
        monkeypatch.setattr(marker_search, "luminance", lambda path: path)
        monkeypatch.setattr(marker_search, "bloom_of", lambda *_, heard=heard: heard)
        monkeypatch.setattr(marker_search, "detect_markers", lambda path, *_, noise=noise, **__: noise[path])
        scale = aruco.scale_from_aruco(scene, side)
        assert scale.m_per_unit is not None
        assert scale.rel_std is not None
        assert isinstance(scale.details, MarkerDetails)
        assert least_px < scale.details.mean_side_px < most_px
        errors.append((scale.m_per_unit - 1) / scale.rel_std)
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.35


def scale_of_warped(
    monkeypatch: pytest.MonkeyPatch, folder: Path, boards: int, warp: float, rng: np.random.Generator
) -> Scale:
    """The scale by large sharp boards of a side of 1, each where the model is too large by its own share."""
    pose, side = poses(1)[0], np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    camera = Camera(intrinsic=intrinsic(), cam_from_world=pose, depth_min=1.0, depth_max=9.0)
    scene = Scene(folder=folder, views=(View(name="v", image_path=folder / "v", camera=camera, sources=()),))
    seen = dict.fromkeys(range(boards), 1000.0 * side[:, :2])
    sizes = {number: 1.0 + rng.normal(0.0, warp) for number in seen}

    def fitted(own: list[Sighting], *_: object) -> tuple[list[FittedMarker], list[str]]:
        size = sizes[own[0].marker_id]
        one = FittedMarker(
            sightings=tuple(own), corners=size * side, side_units=size, side_rel_std=2e-4, error_px=0.1, angle_deg=40.0
        )
        return [one], []

    monkeypatch.setattr(marker_search, "read_view_image", lambda view: view.image_path)
    monkeypatch.setattr(marker_search, "luminance", lambda path: path)
    monkeypatch.setattr(marker_search, "bloom_of", lambda *_: None)
    monkeypatch.setattr(marker_search, "detect_markers", lambda *_, **__: list(seen.items()))
    monkeypatch.setattr(aruco, "find_markers", fitted)
    return aruco.scale_from_aruco(scene, 1.0)


@pytest.mark.parametrize(
    ("boards", "warp", "least"),
    [(1, 0.003, 0.95), (2, 0.003, 0.95), (3, 0.003, 0.95), (1, 0.01, 0.6), (2, 0.01, 0.8), (3, 0.01, 0.84)],
)
def test_few_boards_in_a_warped_model_hold_what_they_say(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, boards: int, warp: float, least: float
) -> None:
    # With a warp of 1 % one of three boards is sometimes taken for a wrong print, which costs some of the interval.
    rng = np.random.default_rng(44022)
    scales = [scale_of_warped(monkeypatch, tmp_path, boards, warp, rng) for _ in range(300)]
    inside = [abs((one.m_per_unit or 0.0) - 1.0) <= 1.96 * (one.rel_std or 0.0) for one in scales]
    assert np.mean(inside) >= least


def test_many_boards_tell_their_spread_themselves(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Where boards differ by 0.2 %, which was known before, their own spread and the common length are all there is."""
    rng = np.random.default_rng(44023)
    stds = {n: scale_of_warped(monkeypatch, tmp_path, n, 0.002, rng).rel_std or 0.0 for n in (1, 12)}
    assert stds[12] == pytest.approx(np.hypot(0.002, 0.002 / np.sqrt(12)), rel=0.1)
    assert stds[1] > 2.0 * stds[12]

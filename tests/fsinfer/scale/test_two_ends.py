"""Scale from two points, and from clicks in photographs."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import ScaleError
from fsinfer.geometry.triangulation import triangulate
from fsinfer.scale import two_ends
from fsinfer.scale.agreement import agreement
from fsinfer.scale.scale import EndpointDetails, Scale
from fsinfer.scale.square_fit import MarkerSettings
from fsinfer.scale.two_ends import scale_from_clicks, scale_from_endpoints
from fsinfer.scene import Camera, Scene, View
from tests.support.rendered_room import intrinsic, poses


def with_the_model(rel_std: float) -> float:
    """What a scale is off by whose ends are known so well: with what one board is off by besides its own side."""
    return math.hypot(agreement(np.array([1.0]), np.zeros(1), MarkerSettings()).rel_std, rel_std)


@pytest.mark.parametrize("value", [0.0, -2.0, float("nan"), float("inf")])
def test_lengths_that_are_none(value: float) -> None:
    with pytest.raises(ScaleError, match="above 0"):
        scale_from_endpoints((0, 0, 0), (1, 0, 0), value)


def test_endpoints_follow_the_papers_equation() -> None:
    scale = scale_from_endpoints((1, 2, 3), (1, 5, 7), 1.0)
    assert scale.m_per_unit == pytest.approx(0.2)
    assert scale.source == "endpoints"
    assert isinstance(scale.details, EndpointDetails)
    assert scale.details.length_units == pytest.approx(5)
    assert scale.details.endpoints == ((1.0, 2.0, 3.0), (1.0, 5.0, 7.0))
    # A centimetre at either end, and what one board has besides its own side.
    assert scale.rel_std == pytest.approx(with_the_model(0.014142), abs=1e-5)
    assert scale_from_endpoints((1, 2, 3), (1, 5, 7), 4.0).rel_std == pytest.approx(with_the_model(0.003536), abs=1e-6)
    # However long it is, it has the warp of the model and its own error.
    longest = scale_from_endpoints((1, 2, 3), (1, 5, 7), 1000.0).rel_std
    assert longest == pytest.approx(with_the_model(0.0), rel=1e-3)
    assert longest == pytest.approx(0.0048, abs=1e-4)


@pytest.mark.parametrize("second", [(1, 2, 3), (float("nan"), 0, 0), (1, 2)])
def test_endpoints_that_are_none(second: tuple[float, ...]) -> None:
    with pytest.raises(ScaleError, match="end points"):
        scale_from_endpoints((1, 2, 3), second, 1.0)


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    cameras = [Camera(intrinsic=intrinsic(), cam_from_world=pose, depth_min=1.0, depth_max=9.0) for pose in poses(4)]
    views = [
        View(name=f"v{index}", image_path=tmp_path / f"v{index}.jpg", camera=camera, sources=())
        for index, camera in enumerate(cameras)
    ]
    return Scene(folder=tmp_path, views=tuple(views))


ENDS = np.array([[-0.4, 0.3, 0.2], [0.5, -0.2, 0.4]])


def clicked(
    scene: Scene, view: int, shift_px: float = 0.0, ends: NDArray[np.float64] = ENDS
) -> list[tuple[float, float]]:
    camera = scene.views[view].camera
    projected = (ends @ camera.cam_from_world[:3, :3].T + camera.cam_from_world[:3, 3]) @ camera.intrinsic.T
    pixels = projected[:, :2] / projected[:, 2:] + shift_px
    return [(float(u), float(v)) for u, v in pixels]


def test_clicks_give_the_scale_and_its_error(scene: Scene) -> None:
    length_units = float(np.linalg.norm(ENDS[1] - ENDS[0]))
    exact = scale_from_clicks(scene, {"v0": clicked(scene, 0), "v3": clicked(scene, 3)}, 1.5)
    assert exact.m_per_unit == pytest.approx(1.5 / length_units, rel=1e-6)
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(200):
        clicks = {
            name: [(u + rng.normal(0, 2), v + rng.normal(0, 2)) for u, v in clicked(scene, view)]
            for view, name in ((0, "v0"), (3, "v3"))
        }
        once = scale_from_clicks(scene, clicks, 1.5)
        assert once.m_per_unit is not None
        assert exact.m_per_unit is not None
        ratios.append(once.m_per_unit / exact.m_per_unit)
    # Of 200 the scatter is known to 5 %.
    assert exact.rel_std == pytest.approx(with_the_model(float(np.std(ratios))), rel=0.18)


def test_how_sure_clicks_are_does_not_hang_on_the_units_of_the_model(scene: Scene) -> None:
    """The same photographs, in a model whose unit is a third as long."""
    views = []
    for view in scene.views:
        larger = view.camera.cam_from_world.copy()
        larger[:3, 3] *= 3.0
        views.append(replace(view, camera=replace(view.camera, cam_from_world=larger, depth_min=3.0, depth_max=27.0)))
    clicks = {"v0": clicked(scene, 0), "v3": clicked(scene, 3)}
    one = scale_from_clicks(scene, clicks, 1.5)
    other = scale_from_clicks(replace(scene, views=tuple(views)), clicks, 1.5)
    assert one.m_per_unit is not None
    assert other.m_per_unit == pytest.approx(one.m_per_unit / 3.0, rel=1e-6)
    assert other.rel_std == pytest.approx(one.rel_std, rel=1e-6)


def test_a_clicked_length_in_a_warped_model_holds_what_it_says(scene: Scene) -> None:
    """Seed 44024: clicked sharply in all photographs, in a model that is off there, by a tape that is off, too."""
    rng = np.random.default_rng(44024)
    length_units, inside, told = float(np.linalg.norm(ENDS[1] - ENDS[0])), [], []
    for _ in range(200):
        length_m = length_units * (1 + rng.normal(0.0, 0.002)) * (1 + rng.normal(0.0, 0.002))
        clicks = {
            f"v{view}": [(u + rng.normal(0.0, 0.2), v + rng.normal(0.0, 0.2)) for u, v in clicked(scene, view)]
            for view in range(4)
        }
        # As if it could be hit ten times as well as a click on a phone's photograph: of these pixels are few.
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(two_ends, "CLICK_SIGMA_PX", 0.2)
            found = scale_from_clicks(scene, clicks, length_m)
        assert found.m_per_unit is not None
        assert found.rel_std is not None
        inside.append(abs(found.m_per_unit - 1.0) <= 1.96 * found.rel_std)
        told.append(found.rel_std)
    assert np.mean(inside) >= 0.95
    assert np.mean(told) < 0.009


def test_clicks_that_miss_by_fifteen_pixels_are_used_and_by_twenty_five_not(scene: Scene) -> None:
    def miss(shift_px: float) -> Scale:
        return scale_from_clicks(scene, {"v0": clicked(scene, 0), "v3": clicked(scene, 3, shift_px=shift_px)}, 1.0)

    told = miss(1.0).details
    assert isinstance(told, EndpointDetails)
    a_pixel = 1.0 / max(told.errors_px)
    worse = miss(15.0 * a_pixel)
    assert isinstance(worse.details, EndpointDetails)
    assert max(worse.details.errors_px) == pytest.approx(15.0, rel=0.1)
    assert (worse.rel_std or 0.0) > 3 * (miss(0.0).rel_std or 1.0)
    with pytest.raises(ScaleError, match="same spot"):
        miss(25.0 * a_pixel)


def test_clicks_that_do_not_fit(scene: Scene) -> None:
    with pytest.raises(ScaleError, match="at least two photos"):
        scale_from_clicks(scene, {"v0": clicked(scene, 0)}, 1.0)
    with pytest.raises(ScaleError, match="gone is no view"):
        scale_from_clicks(scene, {"v0": clicked(scene, 0), "gone": clicked(scene, 0)}, 1.0)
    with pytest.raises(ScaleError, match="same spot"):
        scale_from_clicks(scene, {"v0": clicked(scene, 0), "v3": clicked(scene, 3, shift_px=80.0)}, 1.0)


def along_the_walk(folder: Path, *x_m: float) -> Scene:
    """Photographs side by side, all looking ahead; a unit is a metre."""
    matrix = np.array([[3000.0, 0.0, 2000.0], [0.0, 3000.0, 1500.0], [0.0, 0.0, 1.0]])
    views = []
    for index, x in enumerate(x_m):
        pose = np.eye(4)
        # The third stands a little higher and farther back: off the line through the others.
        pose[:3, 3] = [-x, 0.5 * (index == 2), 0.5 * (index == 2)]
        camera = Camera(intrinsic=matrix, cam_from_world=pose, depth_min=1.0, depth_max=9.0)
        views.append(View(name=f"v{index}", image_path=folder / f"v{index}.jpg", camera=camera, sources=()))
    return Scene(folder=folder, views=tuple(views))


# A metre held level, along the line through the cameras, and one that stands upright.
LEVEL = np.array([[-0.5, 0.0, 4.0], [0.5, 0.0, 4.0]])
UPRIGHT = np.array([[0.1, -0.5, 4.0], [0.1, 0.5, 4.0]])


@pytest.mark.parametrize("exchanged", [False, True])
def test_ends_that_fit_in_either_order_need_a_third_photo(tmp_path: Path, exchanged: bool) -> None:
    scene = along_the_walk(tmp_path, -1.5, 1.5, 0.0)
    clicks = {f"v{view}": clicked(scene, view, ends=LEVEL) for view in range(3)}
    if exchanged:
        clicks["v1"].reverse()
    two = {name: clicks[name] for name in ("v0", "v1")}
    # Read the one way they are a metre side by side, read the other way three metres, one end behind the other.
    with pytest.raises(ScaleError, match=r"photos v0 and v1 fit .* in a third photo too"):
        scale_from_clicks(scene, two, 1.0)
    if exchanged:
        with pytest.raises(ScaleError, match="miss each other"):
            scale_from_clicks(scene, clicks, 1.0)
    else:
        assert scale_from_clicks(scene, clicks, 1.0).m_per_unit == pytest.approx(1.0, rel=1e-6)


def test_ends_that_fit_in_one_order_need_no_third_photo(tmp_path: Path) -> None:
    scene = along_the_walk(tmp_path, -1.5, 1.5)
    upright = {f"v{view}": clicked(scene, view, ends=UPRIGHT) for view in range(2)}
    assert scale_from_clicks(scene, upright, 1.0).m_per_unit == pytest.approx(1.0, rel=1e-6)
    # So far away that it is 24 pixels long: exchanged it misses by half of them.
    far = {f"v{view}": clicked(scene, view, ends=UPRIGHT * [1.0, 1.0, 31.0]) for view in range(2)}
    assert scale_from_clicks(scene, far, 1.0).m_per_unit == pytest.approx(1.0, rel=1e-6)
    # Nearer to each other than the length: exchanged, its rays would meet behind the cameras.
    near = along_the_walk(tmp_path, -0.4, 0.4)
    level = {f"v{view}": clicked(near, view, ends=LEVEL) for view in range(2)}
    assert scale_from_clicks(near, level, 1.0).m_per_unit == pytest.approx(1.0, rel=1e-6)


def test_triangulation_of_parallel_rays_is_none() -> None:
    matrix = intrinsic() @ poses(4)[0][:3]
    assert triangulate([matrix, matrix], np.array([[200.0, 100.0], [200.0, 100.0]])) is None

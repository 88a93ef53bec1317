"""Scale from a factor, from two points, and from clicks in photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsinfer.errors import ScaleError
from fsinfer.geometry.triangulation import triangulate
from fsinfer.scale.scale import EndpointDetails, Scale, scale_from_clicks, scale_from_endpoints, scale_from_factor
from fsinfer.scene import Camera, Scene, View
from tests.support.rendered_room import intrinsic, poses


def test_factor() -> None:
    scale = scale_from_factor(0.4)
    assert (scale.m_per_unit, scale.source, scale.rel_std) == (0.4, "factor", None)


@pytest.mark.parametrize("value", [0.0, -2.0, float("nan"), float("inf")])
def test_numbers_that_are_no_scale(value: float) -> None:
    with pytest.raises(ScaleError, match="above 0"):
        scale_from_factor(value)
    with pytest.raises(ScaleError, match="above 0"):
        scale_from_endpoints((0, 0, 0), (1, 0, 0), value)


def test_endpoints_follow_the_papers_equation() -> None:
    scale = scale_from_endpoints((1, 2, 3), (1, 5, 7), 1.0)
    assert scale.m_per_unit == pytest.approx(0.2)
    assert scale.source == "endpoints"
    assert isinstance(scale.details, EndpointDetails)
    assert scale.details.length_units == pytest.approx(5)
    # A centimetre at either end.
    assert scale.rel_std == pytest.approx(0.01414, abs=1e-5)
    assert scale_from_endpoints((1, 2, 3), (1, 5, 7), 4.0).rel_std == pytest.approx(0.003536, abs=1e-6)


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


def clicked(scene: Scene, view: int, shift_px: float = 0.0) -> list[tuple[float, float]]:
    camera = scene.views[view].camera
    projected = (ENDS @ camera.cam_from_world[:3, :3].T + camera.cam_from_world[:3, 3]) @ camera.intrinsic.T
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
    assert exact.rel_std is not None
    # Of 200 the scatter is known to 5 %.
    assert 0.82 < np.std(ratios) / exact.rel_std < 1.2


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


def test_triangulation_of_parallel_rays_is_none() -> None:
    matrix = intrinsic() @ poses(4)[0][:3]
    assert triangulate([matrix, matrix], np.array([[200.0, 100.0], [200.0, 100.0]])) is None

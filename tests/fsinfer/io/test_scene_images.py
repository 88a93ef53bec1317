"""A scene's cameras belong to the pixels as they are stored: no reader turns them, whatever EXIF says."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fsinfer.depth.job import plan_job
from fsinfer.depth.maps import DepthMaps
from fsinfer.depth.model import DepthModel
from fsinfer.depth.settings import DepthSettings
from fsinfer.depth.view_maps import load_view
from fsinfer.fusion.fuse import fuse
from fsinfer.plot_border.sight import Cameras, views_of
from fsinfer.scale.aruco import scale_from_aruco
from fsinfer.scale.clicks.page import click_page
from fsinfer.scale.clicks.server import _photograph
from fsinfer.scene import Scene, View, read_scene, read_view_image, scene_digest, view_image_size
from fsinfer.silhouettes.edges import strips_of_photo
from tests.fsinfer.fusion.test_fuse import make_scene
from tests.fsinfer.scale.test_aruco import make_scene as make_marker_scene
from tests.fsinfer.silhouettes.test_edges import STEM, write_plot
from tests.support.places import ROOT
from tests.support.plane_scene import write_plane_scene


def tagged(scene: Scene, folder: Path, orientation: int = 6) -> Scene:
    """The scene with the same pixels, in files that say how to turn them."""
    folder.mkdir(exist_ok=True)
    exif = Image.Exif()
    exif[0x0112] = orientation

    def written(view: View) -> View:
        path = folder / view.image_path.name
        with Image.open(view.image_path) as image:
            image.save(path, exif=exif.tobytes())
        return replace(view, image_path=path)

    return replace(scene, views=tuple(map(written, scene.views)))


@pytest.mark.parametrize("orientation", range(2, 9))
def test_pixels_and_size_are_those_of_the_file(tmp_path: Path, orientation: int) -> None:
    scene = read_scene(write_plane_scene(tmp_path))
    turned = tagged(scene, tmp_path / "tagged", orientation)
    for plain, view in zip(scene.views, turned.views, strict=True):
        np.testing.assert_array_equal(read_view_image(view), read_view_image(plain))
        assert view_image_size(view) == (140, 108)


def test_what_was_made_of_turned_images_is_not_taken_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = read_scene(write_plane_scene(tmp_path))
    turned = tagged(scene, tmp_path / "tagged")
    plain_digest, digest = scene_digest(scene), scene_digest(turned)
    # As it was when they were turned; other scenes keep what was computed of them.
    monkeypatch.setattr("fsinfer.scene.is_turned", lambda _: False)
    assert scene_digest(turned) != digest
    assert scene_digest(scene) == plain_digest


def test_depth_is_computed_of_the_cameras_pixels(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path))
    turned = tagged(scene, tmp_path / "tagged")
    settings = DepthSettings(threads=1, max_size_px=160, precision="float32")
    job = plan_job(turned.views, settings)
    assert (job.width, job.height) == (140, 108)
    model = DepthModel.load("field", threads=1)
    plain, other = (load_view(model, one.views[0], settings) for one in (scene, turned))
    np.testing.assert_array_equal(other.grey, plain.grey)


def test_colours_of_the_cloud_are_those_of_the_cameras_pixels(tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", tmp_path, cameras=3)
    plain, other = fuse(scene, tmp_path), fuse(tagged(scene, tmp_path / "tagged"), tmp_path)
    assert plain.rgb is not None
    assert other.rgb is not None
    np.testing.assert_array_equal(other.rgb, plain.rgb)


def test_edges_are_those_of_the_cameras_pixels(tmp_path: Path) -> None:
    scene = write_plot(tmp_path)
    turned = tagged(scene, tmp_path / "tagged")
    ((_, plain),), ((_, other),) = (
        strips_of_photo([STEM], 0, one, DepthMaps(one, tmp_path), np.eye(4)) for one in (scene, turned)
    )
    np.testing.assert_array_equal(other.image, plain.image)


def test_boards_are_found_in_the_cameras_pixels(tmp_path: Path) -> None:
    scene = make_marker_scene(tmp_path, {0: 7})
    plain, other = (
        scale_from_aruco(one, dictionary="4X4_50", length_m=0.2) for one in (scene, tagged(scene, tmp_path / "tagged"))
    )
    assert other.m_per_unit == plain.m_per_unit is not None


def test_what_a_photograph_sees_is_counted_in_the_cameras_pixels(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path, height=60, width=200))
    # Along the picture's longer side, beyond the shorter one.
    cells = np.array([[x, 0.0] for x in (-2.0, 0.0, 2.0)])
    counts = [
        views_of(cells, np.full(3, 2.0), np.zeros((0, 3)), Cameras(scene=one, cloud_from_scene=np.eye(4)))
        for one in (scene, tagged(scene, tmp_path / "tagged"))
    ]
    assert counts[0].max() > 0
    np.testing.assert_array_equal(counts[1], counts[0])


def test_ends_are_clicked_in_the_cameras_pixels(tmp_path: Path) -> None:
    scene = read_scene(write_plane_scene(tmp_path))
    turned = tagged(scene, tmp_path / "tagged")
    photo = click_page(turned, 1.0, {}).photos[0]
    assert (photo.width, photo.height) == (140, 108)
    kind, content = _photograph(turned.views[0])
    assert kind == "image/jpeg"
    with Image.open(io.BytesIO(content)) as image:
        assert 0x0112 not in image.getexif()
        difference = np.abs(np.asarray(image).astype(int) - read_view_image(scene.views[0]))
    assert difference.mean() < 4
    # One that says nothing is sent as it lies there.
    assert _photograph(scene.views[0]) == ("image/png", scene.views[0].image_path.read_bytes())


def test_nobody_reads_a_views_image_by_another_way() -> None:
    call = re.compile(r"(?:read_image|image_size)\([^)\n]*image_path")
    modules = [path for path in (ROOT / "fsinfer").rglob("*.py") if path.name != "scene.py"]
    found = [str(path.relative_to(ROOT)) for path in modules if call.search(path.read_text(encoding="utf-8"))]
    assert found == []

"""Which photographs a tree's card shows, and where the line at breast height is drawn in them."""

from pathlib import Path

import numpy as np
import pytest

from fsinfer.depth.maps import DepthMaps
from fsinfer.io.images import read_image
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.processes import worker_processes
from fsinfer.report.cloud.data import MAX_IN_MEMORY, encode_cloud, read_some
from fsinfer.report.contents import read_contents
from fsinfer.report.stems.photos import LINE_RGB, OUTSIDE_RGB, crop_tree, standing_trees, tree_photos
from fsinfer.report.stems.views import RatedView, StandingTree, breast_height_ring, choose_views, rate_view
from fsinfer.scene import Scene, project, read_scene
from tests.support.report_plot import plot_cloud, write_report_folder
from tests.support.synthetic_plot import M_PER_UNIT, SIZE, STEMS


@pytest.fixture(scope="module")
def plot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report_folder(tmp_path_factory.mktemp("plot"))


def rate_all(plot: Path, tree: StandingTree) -> tuple[Scene, list[RatedView]]:
    scene = read_scene(plot / "scene")
    maps = DepthMaps(scene, plot)
    rated = [rate_view(tree, i, view.camera, SIZE, maps.get(i)) for i, view in enumerate(scene.views)]
    return scene, [one for one in rated if one is not None]


def test_trees_stand_where_the_depth_maps_see_them(plot: Path) -> None:
    trees = standing_trees(read_contents(plot))
    scene = read_scene(plot / "scene")
    assert len(trees) == 3
    np.testing.assert_allclose([tree.radius * M_PER_UNIT for tree in trees], STEMS[:, 2])
    for tree in trees:
        (foot, breast), depths = project(np.stack([tree.at(0.0), tree.breast]), scene.views[0].camera)
        assert breast[1] < foot[1] - 10
        depth = read_pfm(plot / "depth" / "view_00.pfm")[round(breast[1]), round(breast[0])]
        # The map sees the near side of the stem, or of the one before it.
        assert depth <= depths[1] - 0.8 * tree.radius


def test_a_hidden_tree_is_not_shown_from_there(plot: Path) -> None:
    # From view 0 (on +x) both right-hand stems stand clear; the left one is seen between them.
    for tree in standing_trees(read_contents(plot)):
        scene, rated = rate_all(plot, tree)
        assert len(rated) >= 4
        maps = DepthMaps(scene, plot)
        view = scene.views[rated[0].view]
        in_front = maps.get(rated[0].view)
        wall = type(in_front)(**{**vars(in_front), "inverse_depth": np.full_like(in_front.inverse_depth, 1 / 0.5)})
        assert rate_view(tree, 0, view.camera, SIZE, wall) is None
        behind = type(in_front)(**{**vars(in_front), "inverse_depth": np.full_like(in_front.inverse_depth, 1 / 90)})
        assert rate_view(tree, 0, view.camera, SIZE, behind) is None


def test_chosen_views_look_from_different_sides() -> None:
    def view(index: int, score: float, angle_deg: float) -> RatedView:
        angle = np.radians(angle_deg)
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        return RatedView(tree_id=1, view=index, score=score, direction=direction, distance_m=4.0)

    rated = [view(0, 0.90, 0), view(1, 0.89, 5), view(2, 0.60, 90), view(3, 0.50, 180), view(4, 0.10, 270)]
    assert [one.view for one in choose_views(rated, 3)] == [0, 2, 3]
    assert [one.view for one in choose_views(rated, 9)] == [0, 2, 3]
    # Where all look from the same side, one that is a little apart is better than none.
    assert [one.view for one in choose_views([view(0, 0.9, 0), view(1, 0.8, 20), view(2, 0.8, 3)], 3)] == [0, 1]
    assert choose_views([], 3) == ()


def test_processes_choose_the_same_photos(plot: Path) -> None:
    contents = read_contents(plot)
    before, _ = tree_photos(contents)
    with worker_processes(("fsinfer.report.stems.photos",), count=2):
        after, _ = tree_photos(contents)
    assert {tree: [photo.name for photo in photos] for tree, photos in after.items()} == {
        tree: [photo.name for photo in photos] for tree, photos in before.items()
    }
    assert any(before.values())


def test_the_line_lies_on_the_stem_at_breast_height(plot: Path) -> None:
    scene = read_scene(plot / "scene")
    for tree in standing_trees(read_contents(plot)):
        _, rated = rate_all(plot, tree)
        best = choose_views(rated, 1)[0]
        camera = scene.views[best.view].camera
        ring = breast_height_ring(tree, camera)
        depth = read_pfm(plot / "depth" / f"view_{best.view:02d}.pfm")
        near = [depth[round(v), round(u)] for u, v in ring[6:-6]]
        _, (distance,) = project(tree.breast[None], camera)
        np.testing.assert_allclose(near, distance, atol=1.2 * tree.radius)
        # Just beyond both ends there is no stem.
        width = np.ptp(ring[:, 0])
        for u in (ring[:, 0].min() - 0.3 * width, ring[:, 0].max() + 0.3 * width):
            assert not abs(depth[round(ring[16, 1]), round(u)] - distance) < tree.radius
        assert width == pytest.approx(camera.intrinsic[0, 0] * 2 * tree.radius / distance, rel=0.05)


def test_crops_stand_upright_and_show_the_line(plot: Path) -> None:
    photos, why = tree_photos(read_contents(plot), per_tree=2, height_px=240)
    assert why == ""
    assert {tree_id: len(views) for tree_id, views in photos.items()} == {1: 2, 2: 2, 3: 2}
    for views in photos.values():
        assert views[0].name != views[1].name
        for photo in views:
            assert photo.image.shape == (240, 160, 3)
            assert 2.0 < photo.distance_m < 6.5
            orange = np.abs(photo.image.astype(int) - LINE_RGB).sum(axis=2) < 60
            rows, columns = np.nonzero(orange)
            assert len(rows) > 5
            # Breast height is a little below the middle of what is shown (0.15 m under the foot to 2.2 m).
            assert np.ptp(rows) < np.ptp(columns)


def test_a_photo_taken_on_its_side_is_turned(plot: Path) -> None:
    scene = read_scene(plot / "scene")
    tree = standing_trees(read_contents(plot))[2]
    view = scene.views[11]
    image = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    upright = crop_tree(image, view, tree, height_px=240)
    # The same photograph turned a quarter to the left: x' = y, y' = width - 1 - x.
    turn = np.array([[0, 1, 0], [-1, 0, SIZE[0] - 1], [0, 0, 1]], dtype=np.float64)
    rotation = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    camera = type(view.camera)(
        **{
            **vars(view.camera),
            "intrinsic": turn @ view.camera.intrinsic @ rotation[:3, :3].T,
            "cam_from_world": rotation @ view.camera.cam_from_world,
        }
    )
    lying = crop_tree(np.rot90(image).copy(), type(view)(**{**vars(view), "camera": camera}), tree, height_px=240)
    drawn = [np.argwhere(np.abs(one.astype(int) - LINE_RGB).sum(axis=2) < 60) for one in (upright, lying)]
    assert len(drawn[0]) > 5
    np.testing.assert_allclose(drawn[0].mean(axis=0), drawn[1].mean(axis=0), atol=2.0)
    np.testing.assert_allclose(np.ptp(drawn[0], axis=0), np.ptp(drawn[1], axis=0), atol=3)


def test_a_photo_from_very_near_fills_its_crop(plot: Path) -> None:
    scene = read_scene(plot / "scene")
    tree = standing_trees(read_contents(plot))[0]
    near = type(tree)(**{**vars(tree), "up": 30 * tree.up})
    crop = crop_tree(np.zeros((SIZE[1], SIZE[0], 3), np.uint8), scene.views[0], near, height_px=240)
    assert (crop == OUTSIDE_RGB).all(axis=2).mean() < 0.02


def test_trees_measured_with_another_scale_are_found_in_the_photos(plot: Path, tmp_path: Path) -> None:
    contents = read_contents(plot)
    assert contents.trees is not None
    rows = [{**row, "x_m": str(2 * float(row["x_m"])), "y_m": str(2 * float(row["y_m"]))} for row in contents.trees]
    changed = type(contents)(
        **{**vars(contents), "trees": rows, "plot": {**contents.plot, "trees_scale": {"m_per_unit": 2.0}}}
    )
    for one, other in zip(standing_trees(contents), standing_trees(changed), strict=True):
        np.testing.assert_allclose(one.at(0.0), other.at(0.0), atol=1e-9)


def test_without_a_tie_to_the_photos_the_reason_is_told(plot: Path, tmp_path: Path) -> None:
    contents = read_contents(plot)
    loose = type(contents)(**{**vars(contents), "plot": {**contents.plot, "cloud_from_scene": None}})
    assert tree_photos(loose) == ({}, "This folder does not hold what ties the trees to their photos.")
    photos, why = tree_photos(type(contents)(**{**vars(contents), "out": tmp_path}))
    assert not photos
    assert "cannot be shown" in why


def test_a_damaged_photo_or_depth_map_leaves_the_others(plot: Path, tmp_path: Path) -> None:
    import shutil

    copy = shutil.copytree(plot, tmp_path / "copy")
    (copy / "scene" / "images" / "view_03.jpg").write_bytes(b"no picture")
    (copy / "depth" / "view_04.pfm").write_bytes(b"Pf\n3 3\n-1\n")
    write_pfm(copy / "depth" / "view_05.pfm", np.zeros((SIZE[1], SIZE[0]), np.float32))
    photos, _ = tree_photos(read_contents(copy), per_tree=9, height_px=120)
    shown = {photo.name for views in photos.values() for photo in views}
    assert shown
    assert not shown & {"view_03", "view_04", "view_05"}


def test_encoded_points_are_where_they_were() -> None:
    import base64

    cloud = plot_cloud()
    data = encode_cloud(cloud, max_points=5000)
    raw = base64.b64decode(data.base64)
    assert data.parts == ("tree", "rgb", "confidence")
    assert len(raw) == 5000 * 12
    xyz = np.frombuffer(raw[: 6 * 5000], "<u2").reshape(-1, 3) * data.step + data.low
    tree = np.frombuffer(raw[6 * 5000 : 8 * 5000], "<u2")
    rgb = np.frombuffer(raw[8 * 5000 : 11 * 5000], np.uint8).reshape(-1, 3)
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(cloud.xyz).query(xyz)
    assert distance.max() < data.step
    np.testing.assert_array_equal(tree, cloud.extra["TreeID"][nearest])
    assert cloud.rgb is not None
    np.testing.assert_array_equal(rgb, cloud.rgb[nearest])
    assert data.step < 0.0003


@pytest.mark.parametrize("suffix", [".ply", ".laz"])
def test_a_very_large_cloud_is_read_in_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    from fsinfer.io.cloud import write_cloud

    cloud = plot_cloud()
    write_cloud(tmp_path / f"c{suffix}", cloud)
    whole, count = read_some(tmp_path / f"c{suffix}")
    assert len(whole) == count == len(cloud) < MAX_IN_MEMORY
    monkeypatch.setattr("fsinfer.report.cloud.data.MAX_IN_MEMORY", 1000)
    monkeypatch.setattr("fsinfer.report.cloud.data.MAX_POINTS", 1000)
    part, count = read_some(tmp_path / f"c{suffix}")
    assert count == len(cloud)
    assert 1000 < len(part) < 3000
    assert set(part.extra) == {"confidence", "TreeID"}
    np.testing.assert_allclose(np.ptp(part.xyz, axis=0), np.ptp(cloud.xyz, axis=0), atol=0.1)
    assert part.rgb is not None
    assert cloud.rgb is not None
    assert int(part.rgb.max()) == int(cloud.rgb.max())


def test_trees_without_scale_get_crops_by_the_height_of_the_cameras(plot: Path) -> None:
    contents = read_contents(plot)
    similarity = np.array(contents.plot["cloud_from_scene"])
    similarity[:3] /= M_PER_UNIT
    larger = dict.fromkeys(("x_m", "y_m"), 1 / M_PER_UNIT)
    assert contents.trees is not None
    rows = [
        {**row, "dbh_cm": "", **{name: str(factor * float(row[name])) for name, factor in larger.items()}}
        for row in contents.trees
    ]
    changed = {"units": "model units", "camera_height": 3.0, "cloud_from_scene": similarity.tolist()}
    loose = type(contents)(**{**vars(contents), "trees": rows, "plot": {**contents.plot, **changed}})
    for one, other in zip(standing_trees(contents), standing_trees(loose), strict=True):
        np.testing.assert_allclose(one.breast, other.breast, atol=1e-9)
        assert not other.measured


def test_crop_is_no_copy_of_the_photo(plot: Path) -> None:
    scene = read_scene(plot / "scene")
    image = read_image(scene.views[0].image_path)
    before = image.copy()
    crop_tree(image, scene.views[0], standing_trees(read_contents(plot))[0], height_px=900)
    np.testing.assert_array_equal(image, before)

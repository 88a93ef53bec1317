"""What becomes of a foreign scene: images, cameras, source views, depth ranges, and what is told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fsinfer.errors import ImageError, SceneError
from fsinfer.importers.foreign import ForeignScene
from fsinfer.importers.formats import reader_of
from fsinfer.importers.write import ImportSettings, read_origin, told, write_scene
from fsinfer.io.images import read_image
from fsinfer.scene import project, read_scene
from tests.support import foreign_scenes as made
from tests.support.foreign_scenes import BROWN, PINHOLE, SIZE, WALL_M


def read(given: Path, images: Path | None = None) -> ForeignScene:
    reader = reader_of(given, images)
    assert reader is not None
    return reader()


@pytest.fixture
def colmap(tmp_path: Path) -> Path:
    scene = made.truth(BROWN)
    made.write_colmap(scene, tmp_path / "sparse" / "0", kind="OPENCV")
    made.write_photos(scene, tmp_path / "images")
    return tmp_path


def test_the_scene_folder_shows_the_wall_where_it_is(colmap: Path, tmp_path: Path) -> None:
    imported = write_scene(read(colmap), tmp_path / "out")
    assert (imported.photos, imported.tie_points, imported.left_out) == (4, 900, ())
    views = read_scene(tmp_path / "out").views
    k1, k2, p1, p2, _ = BROWN.bent
    true = made.truth(replace(BROWN, bent=(k1, k2, p1, p2)))
    assert [view.name for view in views] == [photo.name for photo in true.photos]
    for view, photo in zip(views, true.photos, strict=True):
        np.testing.assert_allclose(view.camera.cam_from_world, photo.cam_from_world, atol=1e-9)
        image = read_image(view.image_path)
        matrix = view.camera.intrinsic
        straight = made.TrueLens(fx=matrix[0, 0], fy=matrix[1, 1], cx=matrix[0, 2], cy=matrix[1, 2])
        # The photograph was rendered with k3 as well, which OPENCV cannot say: a hundredth of a pixel.
        expected = made.render(photo, straight, (image.shape[1], image.shape[0]))
        assert np.abs(image.astype(float) - expected)[3:-3, 3:-3].mean() < 4.0
        # The depth range holds the wall, and the wall is not all of it.
        depth = project(true.points, view.camera)[1]
        seen = depth[made.visible(true)[views.index(view)]]
        assert view.camera.depth_min < seen.min() < seen.max() < view.camera.depth_max
        assert view.camera.depth_min > 0.5 * seen.min()
        assert view.camera.depth_max < 3 * seen.max()
        # Neighbours come first.
        assert view.sources
        assert abs(view.sources[0] - views.index(view)) <= 2


@pytest.mark.parametrize("metric", [True, False])
def test_without_tie_points_ranges_and_sources_come_from_the_cameras(tmp_path: Path, metric: bool) -> None:
    scene = made.truth(PINHOLE, views=6)
    if metric:
        made.write_rtabmap(scene, tmp_path)
    else:
        # In another unit: nothing but the steps between the cameras can tell how far away things are.
        scene = replace(
            scene,
            photos=tuple(
                replace(p, cam_from_world=np.vstack([np.column_stack([p.cam_from_world[:3, :3],
                    7.0 * p.cam_from_world[:3, 3]]), [0, 0, 0, 1]])) for p in scene.photos
            ),
        )  # fmt: skip
        made.write_transforms(scene, tmp_path / "transforms.json")
        made.write_photos(made.truth(PINHOLE, views=6), tmp_path / "images")
    imported = write_scene(read(tmp_path), tmp_path / "out")
    assert imported.tie_points == 0
    assert any("where the cameras stand" in sentence for sentence in told(imported))
    unit = 1.0 if metric else 7.0
    for index, view in enumerate(read_scene(tmp_path / "out").views):
        assert view.camera.depth_min < WALL_M * unit / 2
        assert view.camera.depth_max > WALL_M * unit * 2
        assert len(view.sources) >= 3
        # At 3 m a step of 0.3 m is 5.7°: the best neighbours are a step or two away.
        assert abs(view.sources[0] - index) <= 2
    if metric:
        assert {view.camera.depth_max for view in read_scene(tmp_path / "out").views} == {30.0}


def test_a_view_without_tie_points_gets_the_others_range_and_neighbours(colmap: Path, tmp_path: Path) -> None:
    foreign = read(colmap)
    assert foreign.sparse is not None
    observations = dict(foreign.sparse.observations)
    del observations["IMG_0002"]
    write_scene(replace(foreign, sparse=replace(foreign.sparse, observations=observations)), tmp_path / "out")
    views = read_scene(tmp_path / "out").views
    assert views[2].sources
    assert views[2].camera.depth_min == pytest.approx(views[1].camera.depth_min, rel=0.2)


def test_photographs_without_distortion_are_copied(tmp_path: Path) -> None:
    scene = made.truth(PINHOLE)
    made.write_transforms(scene, tmp_path / "transforms.json")
    made.write_photos(scene, tmp_path / "images")
    write_scene(read(tmp_path), tmp_path / "out")
    for photo in scene.photos:
        copied, given = tmp_path / "out" / "images" / f"{photo.name}.png", tmp_path / "images" / f"{photo.name}.png"
        assert copied.read_bytes() == given.read_bytes()


@pytest.mark.parametrize("kind", ["png", "jpg"])
def test_a_damaged_photograph_is_named_as_it_was_given(tmp_path: Path, kind: str) -> None:
    scene = made.truth(PINHOLE)
    made.write_transforms(scene, tmp_path / "transforms.json")
    made.write_photos(scene, tmp_path / "images")
    damaged = tmp_path / "images" / f"{scene.photos[2].name}.png"
    if kind == "jpg":
        # Programs go by the content, whatever the name says.
        with Image.open(damaged) as image:
            image.convert("RGB").save(damaged, format="JPEG")
    content = damaged.read_bytes()
    damaged.write_bytes(content[: int(0.8 * len(content))])
    with pytest.raises(ImageError, match="is damaged or cut short") as told_of:
        write_scene(read(tmp_path), tmp_path / "out")
    assert str(damaged) in str(told_of.value)


@pytest.mark.parametrize("sized", [True, False], ids=["size given", "size of the photograph"])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("turn", [6, 3])
def test_the_tag_that_turns_a_photograph_does_not_turn_its_camera(
    tmp_path: Path, turn: int, suffix: str, sized: bool
) -> None:
    scene = made.truth(PINHOLE)
    made.write_transforms(scene, tmp_path / "transforms.json")
    values = json.loads((tmp_path / "transforms.json").read_text())
    for record in (values, *values["frames"]):
        for key in () if sized else ("w", "h"):
            record.pop(key, None)
    (tmp_path / "transforms.json").write_text(json.dumps(values).replace(".png", suffix))
    for photo in scene.photos:
        exif = Image.Exif()
        exif[0x0112] = turn  # by a quarter, or head over heels, to look at it
        (tmp_path / "images").mkdir(exist_ok=True)
        Image.fromarray(made.render(photo, PINHOLE)).save(tmp_path / "images" / f"{photo.name}{suffix}", exif=exif)
    write_scene(read(tmp_path), tmp_path / "out")
    for view, photo in zip(read_scene(tmp_path / "out").views, scene.photos, strict=True):
        image = read_image(view.image_path)
        assert image.shape == (SIZE[1], SIZE[0], 3)
        assert np.abs(image.astype(float) - made.render(photo, PINHOLE)).mean() < 3


def test_reduced_copies_of_the_photographs_will_do(tmp_path: Path) -> None:
    scene = made.truth(PINHOLE)
    made.write_transforms(scene, tmp_path / "transforms.json")
    for photo in scene.photos:
        (tmp_path / "half").mkdir(exist_ok=True)
        half = Image.fromarray(made.render(photo, PINHOLE)).resize((80, 60), Image.Resampling.BOX)
        half.save(tmp_path / "half" / f"{photo.name}.png")
    write_scene(read(tmp_path, tmp_path / "half"), tmp_path / "out")
    matrix = read_scene(tmp_path / "out").views[0].camera.intrinsic
    np.testing.assert_allclose(matrix[:2], [[65.0, 0, 40.4], [0, 65.0, 29.2]], atol=1e-9)


def test_photographs_of_another_size_are_told(tmp_path: Path) -> None:
    scene = made.truth(PINHOLE)
    made.write_transforms(scene, tmp_path / "transforms.json")
    for photo in scene.photos:
        (tmp_path / "images").mkdir(exist_ok=True)
        Image.fromarray(made.render(photo, PINHOLE)[:, :100]).save(tmp_path / "images" / f"{photo.name}.png")
    with pytest.raises(SceneError, match=r"IMG_0000\.png: the photo is 100x120.*--images"):
        write_scene(read(tmp_path), tmp_path / "out")


def test_missing_photographs_are_left_out_and_named(colmap: Path, tmp_path: Path) -> None:
    (colmap / "images" / "IMG_0001.png").unlink()
    imported = write_scene(read(colmap), tmp_path / "out")
    assert (imported.photos, imported.left_out) == (3, ("IMG_0001.png",))
    assert any("IMG_0001.png" in sentence for sentence in told(imported))
    assert [view.name for view in read_scene(tmp_path / "out").views] == ["IMG_0000", "IMG_0002", "IMG_0003"]


def test_photographs_that_are_nowhere_are_told_with_the_way_out(colmap: Path) -> None:
    (colmap / "images").rename(colmap / "elsewhere")
    with pytest.raises(SceneError, match=r"4 photographs.*IMG_0000\.png.*--images"):
        read(colmap)
    assert len(read(colmap, colmap / "elsewhere").photos) == 4


def test_names_from_a_file_lead_nowhere(tmp_path: Path) -> None:
    scene = made.truth(PINHOLE)
    # Two cards with the same names, a way up, a drive: all of them end in the folder of images, apart.
    names = ["card1/a.png", "card2/a.png", "../../../a.png", "C:\\photos\\..\\A.png"]
    given = tmp_path / "in" / "one" / "two" / "three"
    made.write_transforms(scene, given / "transforms.json")
    content = json.loads((given / "transforms.json").read_text(encoding="utf-8"))
    for frame, name in zip(content["frames"], names, strict=True):
        frame["file_path"] = name
    (given / "transforms.json").write_text(json.dumps(content), encoding="utf-8")
    made.write_photos(scene, given, ["card1/a", "card2/a", "a", "A"])
    # Where ../../../a.png leads to from there: outside of the folders that are looked at.
    (tmp_path / "in" / "a.png").write_bytes((given / "card1" / "a.png").read_bytes())
    write_scene(read(given), tmp_path / "out")
    views = read_scene(tmp_path / "out").views
    assert sorted(view.name.lower() for view in views) == ["a", "a_2", "card1_a", "card2_a"]
    of_name = {view.name: view.image_path.read_bytes() for view in views}
    assert of_name["a"] == (given / "a.png").read_bytes()
    inside = {path.relative_to(tmp_path).parts[0] for path in tmp_path.rglob("*") if path.is_file()}
    assert inside == {"in", "out"}


def test_the_origin_is_kept_beside_the_scene(tmp_path: Path) -> None:
    made.write_polycam(made.truth(PINHOLE), tmp_path / "export")
    write_scene(read(tmp_path / "export"), tmp_path / "out")
    origin = read_origin(tmp_path / "out")
    assert origin is not None
    assert (origin.program, origin.metric, origin.z_up) == ("Polycam", True, True)
    assert read_origin(tmp_path) is None
    (tmp_path / "out" / "import.json").write_text("[]", encoding="utf-8")
    with pytest.raises(SceneError, match=r"import\.json is damaged"):
        read_origin(tmp_path / "out")


def test_cameras_at_one_place_are_told(tmp_path: Path) -> None:
    scene = made.truth(PINHOLE)
    turned = []
    for photo in scene.photos:
        pose = photo.cam_from_world.copy()
        pose[:3, 3] = pose[:3, :3] @ [-1.0, -2.0, -3.0]
        turned.append(replace(photo, cam_from_world=pose))
    made.write_transforms(replace(scene, photos=tuple(turned)), tmp_path / "transforms.json")
    made.write_photos(scene, tmp_path / "images")
    with pytest.raises(SceneError, match="at one place"):
        write_scene(read(tmp_path), tmp_path / "out")


def test_few_tie_points_do_not_decide(colmap: Path, tmp_path: Path) -> None:
    settings = ImportSettings(least_points=1000)
    assert write_scene(read(colmap), tmp_path / "out", settings=settings).tie_points == 0

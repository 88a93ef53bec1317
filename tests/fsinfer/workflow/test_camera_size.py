"""Cameras that belong to pictures of another size are refused, those of crops are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.errors import SceneError
from fsinfer.io.images import write_image
from fsinfer.scene import Scene, read_scene
from fsinfer.workflow.camera_size import refuse_cameras_of_other_size
from tests.support.synthetic_plot import SIZE, write_scene_folder


def scene_with_principal_point(folder: Path, across: float, down: float) -> Scene:
    """One view of which ``across`` and ``down``, shares of the picture, are where its lens looks."""
    write_scene_folder(folder)
    scene = read_scene(folder)
    intrinsic = scene.views[0].camera.intrinsic.copy()
    intrinsic[:2, 2] = across * SIZE[0] - 0.5, down * SIZE[1] - 0.5
    view = replace(scene.views[0], camera=replace(scene.views[0].camera, intrinsic=intrinsic))
    return replace(scene, views=(view,))


@pytest.mark.parametrize(("across", "down"), [(0.5, 0.5), (0.74, 0.5), (0.5, 0.26), (0.65, 0.35)])
def test_crops_are_taken(tmp_path: Path, across: float, down: float) -> None:
    refuse_cameras_of_other_size(scene_with_principal_point(tmp_path, across, down))


@pytest.mark.parametrize(("across", "down"), [(0.24, 0.5), (0.5, 0.76), (0.26, 0.27), (-0.1, 0.5), (1.0, 1.0)])
def test_others_are_refused(tmp_path: Path, across: float, down: float) -> None:
    with pytest.raises(SceneError, match=r"view_00_cam\.txt: its principal point .* is not near the middle") as told:
        refuse_cameras_of_other_size(scene_with_principal_point(tmp_path, across, down))
    assert ("would fit it" in str(told.value)) == (across > 0)


def scene_of_size(folder: Path, size: tuple[int, int], across: float, down: float) -> Scene:
    """One view of so many pixels whose lens looks at column ``across`` and row ``down``."""
    scene = scene_with_principal_point(folder, 0.5, 0.5)
    view = scene.views[0]
    write_image(view.image_path, np.zeros((size[1], size[0], 3), np.uint8))
    intrinsic = view.camera.intrinsic.copy()
    intrinsic[:2, 2] = across - 0.5, down - 0.5
    return replace(scene, views=(replace(view, camera=replace(view.camera, intrinsic=intrinsic)),))


@pytest.mark.parametrize("size", [(120, 160), (160, 120), (108, 192), (200, 300)])
def test_pictures_that_were_turned_since_are_refused(tmp_path: Path, size: tuple[int, int]) -> None:
    """A phone's picture of 4 to 3, turned upright by another program, passed for a crop."""
    width, height = size
    with pytest.raises(SceneError, match=r"view_00_cam\.txt: .* it was turned by 90 degrees"):
        refuse_cameras_of_other_size(scene_of_size(tmp_path / "turned", size, 0.51 * height, 0.49 * width))
    refuse_cameras_of_other_size(scene_of_size(tmp_path / "as placed", size, 0.51 * width, 0.49 * height))


@pytest.mark.parametrize("size", [(160, 160), (160, 150)])
def test_squares_look_alike_however_they_are_turned(tmp_path: Path, size: tuple[int, int]) -> None:
    refuse_cameras_of_other_size(scene_of_size(tmp_path, size, 0.5 * size[0], 0.5 * size[1]))

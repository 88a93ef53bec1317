"""Cameras that belong to pictures of another size are refused, those of crops are not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fsinfer.errors import SceneError
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

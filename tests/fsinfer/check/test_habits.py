"""What the check says of how the photos were taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fsinfer.check.habits import habits
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.scene import Camera, Scene, View

#: 65 degrees wide.
INTRINSIC = np.array([[1000.0, 0, 640], [0, 1000.0, 360], [0, 0, 1]])


def turned(*headings_deg: float) -> Scene:
    views = []
    for number, heading in enumerate(headings_deg):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("y", heading, degrees=True).as_matrix()
        camera = Camera(intrinsic=INTRINSIC, cam_from_world=pose, depth_min=1.0, depth_max=60.0)
        views.append(View(name=f"p{number}", image_path=Path(f"p{number}.jpg"), camera=camera, sources=()))
    return Scene(folder=Path(), views=tuple(views))


def names(count: int) -> list[str]:
    return [f"p{number}" for number in range(count)]


def test_a_steady_walk_is_not_talked_about() -> None:
    assert habits(turned(0, 20, 40, 60), [], names(4)) == []


def test_a_turn_by_more_than_half_the_view_is_named_with_its_photos() -> None:
    (line,) = habits(turned(0, 20, 70, 75), [], names(4))
    assert "between p1 and p2 (50 degrees):" in line


def test_only_photos_that_follow_each_other_are_compared() -> None:
    # p2 was not placed: nobody knows how it looked.
    scene = turned(0, 20, 50, 80)
    scene = Scene(folder=scene.folder, views=(scene.views[0], scene.views[1], scene.views[3]))
    assert habits(scene, [], names(4)) == []


def test_many_turns_are_counted_and_some_named() -> None:
    (line,) = habits(turned(*(60 * (k % 2) for k in range(9))), [], names(9))
    assert line.count("degrees)") == 5
    assert "and 3 more" in line


def test_what_poses_found_is_told_and_what_does_not_help_here_is_not() -> None:
    found = [
        notice(CaptureCode.rolling_shutter, median_px=3.2),
        notice(CaptureCode.photos_unplaced, photos=9, names=("p3",)),
        notice(CaptureCode.focal_length_changes, percent=0.4),
    ]
    lines = habits(turned(0, 1), found, names(2))
    assert len(lines) == 2
    assert "stand still" in lines[0]
    assert "lock the focus" in lines[1]

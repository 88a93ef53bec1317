"""Parts that nothing ties to the rest are measured apart, if they see boards; what fails there loses nothing."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from fsinfer.errors import PosesError
from fsinfer.io.images import write_image
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.plot_border.request import BorderRequest
from fsinfer.poses.estimate import PosesResult
from fsinfer.scale.detection import predefined_dictionary
from fsinfer.scale.printed_boards import DICTIONARY
from fsinfer.scale.request import ScaleRequest
from fsinfer.workflow.parts import PartResult, measure_parts
from fsinfer.workflow.settings import RunSettings


def photos(folder: Path, count: int, boards: int) -> list[str]:
    """Grey photos, the first ``boards`` of them with a marker; returns their names."""
    folder.mkdir()
    dictionary = predefined_dictionary(DICTIONARY)
    for number in range(count):
        image = np.full((120, 160, 3), 160, np.uint8)
        if number < boards:
            image[30:90, 50:110] = cv2.aruco.generateImageMarker(dictionary, 7, 60)[..., None]
        write_image(folder / f"p{number:02d}.png", image)
    return [f"p{number:02d}" for number in range(count)]


def poses_of(names: list[str], *parts: Notice) -> PosesResult:
    return PosesResult(scene=Path(), photos=len(names), registered=0, left_out=(), warnings=parts)


def apart(names: list[str]) -> Notice:
    return notice(CaptureCode.part_apart, photos=40, names=tuple(names))


SETTINGS = RunSettings(scale=ScaleRequest(factor=2.0), border=BorderRequest(radius_m=9.0))


def test_a_part_with_boards_is_run_by_itself_in_a_folder_of_its_own(tmp_path: Path) -> None:
    names = photos(tmp_path / "images", 14, boards=3)
    asked: list[tuple[Path, Path, RunSettings]] = []

    def run_part(given: Path, folder: Path, settings: RunSettings) -> tuple[int, int, int]:
        asked.append((given, folder, settings))
        return 11, 5, 4

    found = measure_parts(tmp_path, tmp_path / "images", poses_of(names, apart(names[:12])), SETTINGS, run_part)
    assert found == (PartResult(folder="part-2", photos=12, registered=11, trees=5, trees_with_dbh=4),)
    ((given, folder, settings),) = asked
    assert folder == tmp_path / "part-2"
    assert sorted(path.stem for path in given.iterdir()) == names[:12]
    # A factor and a border are of the other frame.
    assert settings.scale == ScaleRequest()
    assert settings.border == BorderRequest()


@pytest.mark.parametrize(("count", "boards"), [(14, 2), (9, 9)])
def test_a_part_without_a_scale_or_of_few_photos_is_none(tmp_path: Path, count: int, boards: int) -> None:
    names = photos(tmp_path / "images", count, boards=boards)

    def run_part(_photos: Path, _folder: Path, _settings: RunSettings) -> tuple[int, int, int]:
        raise AssertionError("is not to be run")

    assert measure_parts(tmp_path, tmp_path / "images", poses_of(names, apart(names)), SETTINGS, run_part) == ()
    assert not (tmp_path / "part-2").exists()


def test_what_fails_in_a_part_is_told_and_the_next_one_is_run(tmp_path: Path) -> None:
    names = photos(tmp_path / "images", 24, boards=24)

    def run_part(_photos: Path, folder: Path, _settings: RunSettings) -> tuple[int, int, int]:
        if folder.name == "part-2":
            raise PosesError("too dark")
        return 12, 1, 1

    poses = poses_of(names, apart(names[:12]), apart(names[12:]))
    first, second = measure_parts(tmp_path, tmp_path / "images", poses, SETTINGS, run_part)
    assert (first.folder, first.error) == ("part-2", "too dark")
    assert (second.folder, second.trees_with_dbh) == ("part-3", 1)

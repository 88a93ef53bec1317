"""Parts that nothing ties to the rest are measured apart, if they see boards; what fails there loses nothing."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fsinfer.errors import PosesError
from fsinfer.frames.settings import FrameSettings
from fsinfer.io.images import read_image, write_image
from fsinfer.io.photo_folders import list_images
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


SETTINGS = RunSettings(
    frames=FrameSettings(equalize="clahe", jpeg_quality=90),
    scale=ScaleRequest(factor=2.0),
    border=BorderRequest(radius_m=9.0),
)


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
    # The photos are frames, which have been evened out.
    assert settings.frames == FrameSettings(equalize="none", jpeg_quality=90)


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


def given_to_parts(out: Path, images: Path, *parts: list[str]) -> dict[str, dict[str, bytes]]:
    """Names and content of the photos that each part is measured with; a part that failed has none."""
    given: dict[str, dict[str, bytes]] = {}

    def run_part(photos: Path, folder: Path, _settings: RunSettings) -> tuple[int, int, int]:
        given[folder.name] = {path.name: path.read_bytes() for path in list_images(photos)}
        return 12, 1, 1

    for part in measure_parts(out, images, poses_of([], *map(apart, parts)), SETTINGS, run_part):
        assert bool(part.error) == (part.folder not in given), part.error
    return given


def of_names(images: Path, names: list[str]) -> dict[str, bytes]:
    return {f"{name}.png": (images / f"{name}.png").read_bytes() for name in names}


def test_a_part_is_measured_with_its_own_photos_whatever_an_earlier_run_left(tmp_path: Path) -> None:
    images = tmp_path / "images"
    names = photos(images, 36, boards=36)
    first, second = names[:12], names[12:24]
    given = given_to_parts(tmp_path, images, first, second)
    assert given == {"part-2": of_names(images, first), "part-3": of_names(images, second)}
    (tmp_path / "part-2" / "photos" / "notes.txt").write_text("mine", encoding="utf-8")
    # The first is tied now, the second has lost a photo, and another one has changed.
    changed = images / f"{second[0]}.png"
    old = changed.read_bytes()
    photo = read_image(changed)
    photo[0, :, 0] = 1
    write_image(changed, photo)
    assert changed.read_bytes() != old
    assert given_to_parts(tmp_path, images, second[:-1]) == {"part-2": of_names(images, second[:-1])}
    assert (tmp_path / "part-2" / "photos" / "notes.txt").read_text(encoding="utf-8") == "mine"
    # And the same part with other content under the same names, after frames that are no more.
    (images / f"{second[1]}.png").rename(images / "renamed.png")
    write_image(changed, photo[::-1])
    now = [second[0], *second[2:], "renamed"]
    assert given_to_parts(tmp_path, images, now) == {"part-2": of_names(images, now)}
    # Nothing is written where nothing has changed.
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "part-2").rglob("*")}
    given_to_parts(tmp_path, images, now)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "part-2").rglob("*")} == written


def test_photos_of_a_version_that_kept_no_notes_are_known_by_the_frames(tmp_path: Path) -> None:
    images = tmp_path / "images"
    names = photos(images, 24, boards=24)
    (tmp_path / "part-2").mkdir()
    shutil.copytree(images, tmp_path / "part-2" / "photos")
    assert given_to_parts(tmp_path, images, names[:12]) == {"part-2": of_names(images, names[:12])}


def test_a_photo_that_somebody_put_into_the_folder_of_a_part_is_neither_measured_nor_touched(tmp_path: Path) -> None:
    images = tmp_path / "images"
    names = photos(images, 12, boards=12)
    given_to_parts(tmp_path, images, names)
    mine = tmp_path / "part-2" / "photos" / "mine.JPG"
    mine.write_bytes(b"film")
    poses = poses_of(names, apart(names))
    (part,) = measure_parts(tmp_path, images, poses, SETTINGS, lambda *_: pytest.fail("is not to be run"))
    assert "holds photos that no run put there or that were changed (mine.JPG); move them away" in part.error
    assert mine.read_bytes() == b"film"

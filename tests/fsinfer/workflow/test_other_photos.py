"""Results of one walk are not replaced by another's: next year's photos, or another plot's, with the same command."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from PIL import Image

from fsinfer.errors import InputError
from fsinfer.frames.settings import FrameSettings
from fsinfer.io.files import make_folder
from fsinfer.io.images import read_image, write_image
from fsinfer.workflow.ledger import Ledger
from fsinfer.workflow.other_photos import refuse_other_photos
from fsinfer.workflow.photo_stages import choose_frames, source_files
from tests.support.command_line import Call
from tests.support.rendered_room import texture


def photograph(path: Path, seed: int, taken: str = "") -> None:
    exif = Image.Exif()
    exif[0x0110] = "Phone 15"
    if taken:
        exif.get_ifd(0x8769)[0x9003] = taken
    make_folder(path.parent)
    Image.fromarray(texture(seed, 300)[:150, :200]).save(path, exif=exif.tobytes(), quality=95)


def walk(folder: Path, *, year: int | None, first: int = 0) -> Path:
    for number in range(4):
        taken = "" if year is None else f"{year}:06:01 10:00:{number:02d}"
        photograph(folder / f"IMG_{first + number}.jpg", seed=first + number + (year or 0), taken=taken)
    return folder


def measured(out: Path, photos: Path) -> Path:
    """An output folder with finished frames and a table of trees."""
    choose_frames(Ledger(make_folder(out)), photos, source_files(photos, out), settings=FrameSettings())
    (out / "trees.csv").write_text("tree_id\n", encoding="utf-8")
    return out


@pytest.mark.parametrize(("year", "first"), [(2026, 0), (None, 50)])
def test_photos_of_another_walk_do_not_replace_its_results(
    tmp_path: Path, call: Call, year: int | None, first: int
) -> None:
    """By the moments, though a counter gave the same names; by the names where photos tell no moment."""
    last = walk(tmp_path / "a", year=None if year is None else year - 1)
    out, photos = measured(tmp_path / "out", last), walk(tmp_path / "b", year=year, first=first)
    for command in ("run", "check"):
        code, _, told = call(command, photos, out)
        assert code == 2
        assert f"{out} holds the results of other photos (IMG_0.jpg to IMG_3.jpg), none of which is in" in told
    refuse_other_photos(photos, tmp_path / "another")
    (out / "trees.csv").unlink()
    refuse_other_photos(photos, out)  # nothing would be lost


def test_photos_that_were_added_renamed_or_converted_are_the_same_walk(tmp_path: Path) -> None:
    photos = walk(tmp_path / "photos", year=2026)
    photograph(photos / "IMG_9.jpg", seed=99)  # by a messenger, without its moment
    out = measured(tmp_path / "out", photos)
    refuse_other_photos(photos, out)
    renamed = make_folder(tmp_path / "renamed")
    for path in photos.iterdir():
        with Image.open(path) as image:
            image.save(renamed / f"b-{path.stem}.png", exif=image.getexif())
    refuse_other_photos(renamed, out)
    more = walk(tmp_path / "more", year=2027, first=20)
    shutil.copy(photos / "IMG_9.jpg", more)
    refuse_other_photos(more, out)
    for path in photos.iterdir():
        write_image(path.with_suffix(".png"), read_image(path))  # the moment is lost
        path.unlink()
    refuse_other_photos(photos, out)
    with pytest.raises(InputError, match="does not exist"):
        refuse_other_photos(tmp_path / "gone", out)

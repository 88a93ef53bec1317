"""Parts of a walk that nothing ties to the rest: each is measured on its own scale, in a folder of its own.

Only a part that sees boards has a scale. Its trees stand in a frame of their own; where the pattern of the stems tells
how that lies in the plot, :mod:`fsinfer.workflow.joined_parts` puts them into its tables. Else a tree that both see is
in both tables: the report of the plot names the part, and the person decides.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fsinfer.errors import FsinferError
from fsinfer.frames.settings import Equalize
from fsinfer.io.images import read_image
from fsinfer.io.photo_folders import list_images
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice
from fsinfer.plot_border.request import BorderRequest
from fsinfer.poses.estimate import PosesResult
from fsinfer.scale.detection import detect_markers, make_detector
from fsinfer.scale.request import ScaleRequest
from fsinfer.workflow.part_photos import fill_part
from fsinfer.workflow.settings import RunSettings

_log = logging.getLogger(__name__)

#: Fewer photos are no plot. Source: judgement; a stem is passed in so many.
_LEAST_PHOTOS = 10
#: A board gives a scale where so many photos see it. Source: as the scale stage, which fits a square to three.
_LEAST_SIGHTINGS = 3


@dataclass(frozen=True, kw_only=True)
class PartResult:
    """A part of the walk in ``OUT/folder``: its photos, those placed, its trees; or why it could not be measured."""

    folder: str
    photos: int
    registered: int = 0
    trees: int = 0
    trees_with_dbh: int = 0
    error: str = ""


#: Photos, output folder and settings to the figures of that run: photos placed, trees, those with a diameter.
RunPart = Callable[[Path, Path, RunSettings], tuple[int, int, int]]


def measure_parts(
    out: Path, images: Path, poses: PosesResult, settings: RunSettings, run_part: RunPart
) -> tuple[PartResult, ...]:
    """Run each part that is large enough and sees boards into ``OUT/part-2``, ``OUT/part-3`` and so on.

    Parameters
    ----------
    images: folder of the photos that the poses were found of, frames of the plot.
    run_part: does the whole job. What fails in it is told in the result; the plot itself is not lost by it.
    """
    files = {path.stem: path for path in list_images(images)}
    found = []
    for told, name in folders_of_parts(poses).items():
        names = told.values["names"]
        paths = [files[str(name)] for name in names if str(name) in files] if isinstance(names, tuple) else []
        if len(paths) < _LEAST_PHOTOS or not _sees_boards(paths, settings.scale):
            _log.info("a part of %d photos has no scale of its own, or is too small", len(paths))
            continue
        folder = out / name
        try:
            photos = fill_part(folder, paths, list(files.values()))
            registered, trees, measured = run_part(photos, folder, _of_part(settings))
        except FsinferError as error:
            found.append(PartResult(folder=folder.name, photos=len(paths), error=str(error)))
            continue
        result = PartResult(
            folder=folder.name, photos=len(paths), registered=registered, trees=trees, trees_with_dbh=measured
        )
        found.append(result)
    return tuple(found)


def folders_of_parts(poses: PosesResult) -> dict[Notice, str]:
    """Name of the folder of each part that the poses left apart, by what they said of it."""
    apart = [told for told in poses.warnings if told.code == CaptureCode.part_apart]
    return {told: f"part-{number}" for number, told in enumerate(apart, start=2)}


def _of_part(settings: RunSettings) -> RunSettings:
    """Without what is said in the frame of the rest, the border and a scale in its units, and what is done already.

    The photographs of a part are frames of the plot, whose brightness is evened out where that was asked for.
    """
    scale = settings.scale
    boards = ScaleRequest(aruco_length_m=scale.aruco_length_m, aruco_dictionary=scale.aruco_dictionary)
    frames = replace(settings.frames, equalize=Equalize.none.value)
    return replace(settings, frames=frames, border=BorderRequest(), scale=boards)


def _sees_boards(paths: Sequence[Path], scale: ScaleRequest) -> bool:
    detector = make_detector(scale.aruco_dictionary)
    seen: Counter[int] = Counter()
    for path in paths:
        seen.update({number for number, _ in detect_markers(read_image(path), detector)})
        if seen and max(seen.values()) >= _LEAST_SIGHTINGS:
            return True
    return False

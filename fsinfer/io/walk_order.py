"""The photographs of a folder in the order of walking: by name, and where the camera's counter began anew, by time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fsinfer.io.exif import taken_at
from fsinfer.io.photo_folders import list_images


def list_walk(folder: Path | str) -> list[Path]:
    """Return the photographs directly in ``folder`` as :func:`list_images` does, by name, but begun at the first one.

    Cameras count to 9999 and begin anew: by name ``IMG_0001`` ... ``IMG_0060``, the end of a walk, come before its
    beginning, ``IMG_9950`` ... ``IMG_9999``. Where all photos are of one camera, noted their moments, and were taken in
    the order of their names but for one such step, those that were taken first come first. Otherwise names alone count.

    Raises
    ------
    ImageError
        ``folder`` is missing or holds no photograph.
    """
    paths = list_images(folder)
    first = _begins_anew(paths)
    return paths[first:] + paths[:first]


def _begins_anew(paths: Sequence[Path]) -> int:
    """Which of the photos was taken first, where one after the other follows from there, round the end; else 0."""
    moments: list[str] = []
    first, by = 0, None
    for path in paths:
        taken = taken_at(path)
        if taken is None or (by is not None and taken[0] != by):
            return 0
        by, moment = taken
        if moments and moment < moments[-1]:
            if first:
                return 0
            first = len(moments)
        moments.append(moment)
    return first if moments[-1] <= moments[0] else 0

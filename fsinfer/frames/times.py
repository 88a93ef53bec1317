"""Whether photos follow each other by name as they were taken: neighbours by name are matched first.

A counter does that. Names that another program gave do not, and a walk of which neighbours are unknown falls apart.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from fsinfer.io.exif import taken_at
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice

#: So many photos of a camera with a moment tell; of fewer than the mapper matches all pairs anyway. Source: judgement.
LEAST_PHOTOS = 10
#: Share of the photos that may have been taken before the one before them. Source: judgement; names without any order
#: make it a half, a counter that begins anew or photos that were added later a few.
MOST_BACKWARDS = 0.2
#: Share of the photos that may follow one of another camera. Source: judgement; one camera after the other changes
#: once, and two in turn make it a half and more.
MOST_CHANGES = 0.2


def names_against_times(photos: Sequence[Path]) -> tuple[Notice, ...]:
    """What is to be said of photos, given in the order of their names, that were taken in another order."""
    taken = [found for path in photos if (found := taken_at(path)) is not None]
    counts = Counter(camera for camera, _ in taken)
    told = [(camera, moment) for camera, moment in taken if counts[camera] >= LEAST_PHOTOS]
    return (*_backwards(told), *_alternating(told))


def _backwards(told: Sequence[tuple[str, str]]) -> tuple[Notice, ...]:
    """Of one camera, by its own clock."""
    by_camera: dict[str, list[str]] = {}
    for camera, moment in told:
        by_camera.setdefault(camera, []).append(moment)
    pairs = len(told) - len(by_camera)
    backwards = sum(later < earlier for moments in by_camera.values() for earlier, later in pairwise(moments))
    if not pairs or backwards <= MOST_BACKWARDS * pairs:
        return ()
    return (notice(CaptureCode.names_not_by_time, backwards=backwards, photos=len(told)),)


def _alternating(told: Sequence[tuple[str, str]]) -> tuple[Notice, ...]:
    """Of two people who walked at the same time with phones that name photos by the moment.

    Their steps go from one to the other, and where the two meet they look like steps of a part that was placed far too
    small.
    """
    changes = sum(one != other for (one, _), (other, _) in pairwise(told))
    if changes <= MOST_CHANGES * max(0, len(told) - 1):
        return ()
    # Some apps do not write which phone it was.
    cameras = tuple(sorted({camera.strip() or "a camera without a name" for camera, _ in told}))
    return (notice(CaptureCode.cameras_alternate, cameras=cameras, changes=changes, photos=len(told)),)

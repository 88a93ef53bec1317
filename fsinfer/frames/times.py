"""Whether photos follow each other by name as they were taken: neighbours by name are matched first.

A counter does that. Names that another program gave do not, and a walk of which neighbours are unknown falls apart.
"""

from __future__ import annotations

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


def names_against_times(photos: Sequence[Path]) -> tuple[Notice, ...]:
    """What is to be said of photos, given in the order of their names, that were taken in another order."""
    by_camera: dict[str, list[str]] = {}
    for path in photos:
        taken = taken_at(path)
        if taken is not None:
            by_camera.setdefault(taken[0], []).append(taken[1])
    told = [moments for moments in by_camera.values() if len(moments) >= LEAST_PHOTOS]
    pairs = sum(len(moments) - 1 for moments in told)
    backwards = sum(later < earlier for moments in told for earlier, later in pairwise(moments))
    if not pairs or backwards <= MOST_BACKWARDS * pairs:
        return ()
    return (notice(CaptureCode.names_not_by_time, backwards=backwards, photos=pairs + len(told)),)

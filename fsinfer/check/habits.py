"""How the photos were taken, for the person who still stands in the forest: what moved, and what turned too fast."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice
from fsinfer.notices.sentences import sentences
from fsinfer.scene import Scene, View

#: What poses found in the photos that the next walk can do better.
_HABITS = frozenset(
    {
        CaptureCode.rolling_shutter,
        CaptureCode.focal_length_changes,
        CaptureCode.lenses_mixed,
        CaptureCode.picture_shifts,
        CaptureCode.parts_joined,
        CaptureCode.part_apart,
    }
)
#: Photos that follow each other should share two thirds of their view; a turn by so much of it leaves half. Source:
#: photogrammetry's usual overlap, and judgement.
_MOST_TURN = 0.5
#: Turns that are named at most. Source: layout.
_MOST_NAMED = 5


def habits(scene: Scene, warnings: Sequence[Notice], order: Sequence[str]) -> list[str]:
    """Sentences on how the photos were taken.

    Parameters
    ----------
    warnings: of the poses stage. order: names of all photos in the order of walking.
    """
    told = [f"{text}." for text in sentences([warning for warning in warnings if warning.code in _HABITS])]
    return told + _fast_turns(scene, order)


def _fast_turns(scene: Scene, order: Sequence[str]) -> list[str]:
    by_name = {view.name: view for view in scene.views}
    fast = []
    for one, other in pairwise(order):
        if one in by_name and other in by_name:
            turn, field = _turn_deg(by_name[one], by_name[other]), _field_deg(by_name[one])
            if turn > _MOST_TURN * field:
                fast.append((turn, one, other))
    if not fast:
        return []
    named = ", ".join(f"{one} and {other} ({turn:.0f} degrees)" for turn, one, other in fast[:_MOST_NAMED])
    more = f" and {len(fast) - _MOST_NAMED} more" if len(fast) > _MOST_NAMED else ""
    return [f"You turned fast between {named}{more}: where you change direction, take a photo every 20 degrees or so."]


def _turn_deg(one: View, other: View) -> float:
    """Angle between the directions in which two photos look."""
    cosine = one.camera.cam_from_world[2, :3] @ other.camera.cam_from_world[2, :3]
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _field_deg(view: View) -> float:
    """Horizontal field of view; the principal point is near the middle of the picture."""
    intrinsic = view.camera.intrinsic
    return 2.0 * float(np.degrees(np.arctan2(intrinsic[0, 2] + 0.5, intrinsic[0, 0])))

"""Of a film's frames those that are a step or a turn apart: the others see what their neighbours see."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fsinfer.importers.photos import Registered

#: A frame is used where it was taken so far from the last one, or in another direction. Source: judgement; a stem 5 m
#: away is seen 3° apart, and the poses are in metres.
_STEP_M, _TURN_DEG = 0.25, 10.0


def keyframes(frames: Sequence[Registered]) -> list[Registered]:
    """The frames that are used, in their order; poses are in metres."""
    kept: list[Registered] = []
    for frame in frames:
        if kept:
            relative = frame.cam_from_world @ np.linalg.inv(kept[-1].cam_from_world)
            step_m = float(np.linalg.norm(relative[:3, 3]))
            cosine = (np.trace(relative[:3, :3]) - 1) / 2
            turn_deg = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
            if step_m < _STEP_M and turn_deg < _TURN_DEG:
                continue
        kept.append(frame)
    return kept

"""What the stages from the photographs to the cloud have to tell: frames, poses, scale, cloud."""

from __future__ import annotations

from enum import StrEnum


class CaptureCode(StrEnum):
    """Warnings of the stages before the trees."""


#: What each code says; ``{name}`` is filled with the notice's values.
SENTENCES: dict[CaptureCode, str] = {}
#: Of use to those who look closely, nothing to act upon.
REMARKS: frozenset[CaptureCode] = frozenset()

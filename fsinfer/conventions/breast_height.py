"""Where the diameter at breast height is measured."""

from __future__ import annotations

from enum import StrEnum

#: Above the ground, metres. Source: the convention of most countries; the United States take 1.37 m.
BREAST_HEIGHT_M = 1.3


class BhRule(StrEnum):
    """Where breast height is counted from: the ground at the middle of the stem, or the highest at its foot."""

    midpoint = "midpoint"
    uphill = "uphill"

"""Where the diameter at breast height is measured."""

from __future__ import annotations

from enum import StrEnum

#: Above the ground, metres. Source: the convention of most countries; the United States take 1.37 m.
BREAST_HEIGHT_M = 1.3
#: What breast height may be, metres: what lies beyond is in feet or centimetres, or no height of a stem. Source:
#: conventions lie between 1.2 and 1.4 m; narrowest places below forks and above butt swells do farther about.
BREAST_HEIGHTS_M = (0.3, 3.0)


class BhRule(StrEnum):
    """Where breast height is counted from: the ground at the middle of the stem, or the highest at its foot."""

    midpoint = "midpoint"
    uphill = "uphill"

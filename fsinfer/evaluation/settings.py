"""Settings of the comparison with measured trees; light to import, for the command line shows their defaults."""

from __future__ import annotations

from enum import StrEnum

#: Farthest that two positions of one tree may lie apart, metres. Source: option; stems that
#: are measured stand farther apart than twice this.
MAX_DISTANCE_M = 0.5


class Align(StrEnum):
    """Whether the extracted positions may be moved and turned onto the measured ones."""

    auto = "auto"
    never = "never"
    always = "always"

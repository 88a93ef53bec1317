"""What the dendrometry has to tell of a plot and of each tree."""

from __future__ import annotations

from enum import StrEnum


class StemCode(StrEnum):
    """Warnings of the tree stage, and reasons for a tree's status."""

    #: A reason that was read back as text, from a table.
    as_written = "as_written"
    no_scale = "no_scale"


#: What each code says; ``{name}`` is filled with the notice's values.
SENTENCES: dict[StemCode, str] = {
    StemCode.as_written: "{text}",
    StemCode.no_scale: "no scale",
}
#: Of use to those who look closely, nothing to act upon.
REMARKS: frozenset[StemCode] = frozenset()
#: The sentence says already that the stem has to be walked round again.
ADVISES_REVISIT: frozenset[StemCode] = frozenset()

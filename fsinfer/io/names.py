"""Names of photographs in the order of their numbers, as the file manager shows them: 2 before 10."""

from __future__ import annotations

import re
from collections.abc import Sequence

_NUMBER = re.compile(r"\d+")
#: Digits that a number is filled up to for comparison; longer ones stay. Source: numerics; a time stamp has 17.
_LONGEST = 20


def by_number(name: str) -> tuple[str, str]:
    """Sorting key: ``photo (2).jpg`` comes before ``photo (10).jpg``."""
    return _filled(name, _LONGEST), name


def sortable(stems: Sequence[str]) -> dict[str, str]:
    """Each of the names to one whose order by letters is that of the numbers in them.

    Stages after the frames sort by letters. Names of cameras and phones have numbers of one length and stay as they
    are; ``photo (2)`` beside ``photo (10)``, as Windows renames many files at once, becomes ``photo (02)``.
    """
    if sorted(stems) == sorted(stems, key=by_number):
        return {stem: stem for stem in stems}
    width = max(len(number) for stem in stems for number in _NUMBER.findall(stem))
    filled = {stem: _filled(stem, min(width, _LONGEST)) for stem in stems}
    # 1 and 01 side by side would become one.
    return filled if len(set(filled.values())) == len(filled) else {stem: stem for stem in stems}


def _filled(name: str, width: int) -> str:
    return _NUMBER.sub(lambda number: number.group().zfill(width), name)

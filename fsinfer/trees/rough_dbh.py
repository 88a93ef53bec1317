"""What a stem without a DBH says of its size all the same: "too uncertain: 6 cm +- 2 cm" is a thin stem.

Its section in a sum is better told by that than by the mean of all others, which is many times that of a sapling: of
thick stems on a walk most are measured, so that those without a DBH are no sample of all.
"""

from __future__ import annotations

import re

from fsinfer.notices.notice import Notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.points.sums import Z95
from fsinfer.trees.tree import Tree

#: Half of an interval, as a share of its diameter or in cm, above which it says nothing of the size. Source: judgement;
#: 7 +- 4 cm is thin for sure, corners of a car are "47 cm +- 47 cm".
_MOST_REL_HALF, _MOST_HALF_CM = 0.5, 8.0
#: Standard deviation of a width that is no measurement, as a share of it: of edges that nothing supports, which may be
#: of nothing, and of what stands there below breast height. Source: judgement; renders of two renderers, afterwards:
#: four such edges are 0.97 to 1.15 times as far apart as the stem is thick; of fourteen such widths eleven are of
#: saplings, 1 to 11 times as wide as those, one of a post, and two of trees far away, half and 0.4 times.
_REL_STD = {StemCode.edges_unsupported: 0.5, StemCode.stands_across: 1.0}
#: As the reason is written in a ``trees.csv``, by itself or in the brackets of another one. Source: format; the
#: sentence of ``too_uncertain``.
_WRITTEN = re.compile(r"too uncertain: (\d+) cm \+- (\d+) cm")
#: The same of widths. Source: format; the sentences of ``edges_unsupported`` and ``stands_across``.
_WIDTH_WRITTEN = re.compile(
    r"edges alone are no measurement: \d+ photos? ha(?:s|ve) some (\d+) cm apart"
    r"|what stands there below breast height is some (\d+) cm across"
)
#: Notices with what the points say of a stem whose edges are no measurement, and those with a width, by its name.
#: Source: format; the codes' values.
_OF_EDGES = frozenset({StemCode.edges_unsupported, StemCode.edges_unsure, StemCode.edges_ragged})
_WIDTHS = {StemCode.edges_unsupported: "edges_cm", StemCode.stands_across: "across_cm"}


def rough_dbh_cm(tree: Tree) -> tuple[float, float] | None:
    """Diameter and standard deviation, cm, by the reasons of a tree without a DBH; None where they tell none."""
    if tree.dbh_cm is not None:
        return None
    for given in tree.reasons:
        # Where edges alone are no measurement, what the points say is in their notice.
        reason = given.values.get("refused") if given.code in _OF_EDGES else given
        if isinstance(reason, Notice) and reason.code == StemCode.too_uncertain:
            # Whole centimetres, as a table has them.
            known = _known(*(_whole(reason, name) for name in ("dbh_cm", "half_width_cm")))
            if known is not None:
                return known
    for reason in tree.reasons:
        for code, name in _WIDTHS.items():
            if reason.code == code:
                return _of_width(_whole(reason, name), code)
    written = (rough_of_text(str(reason.values.get("text", ""))) for reason in tree.reasons)
    return next((known for known in written if known is not None), None)


def is_hardly_known(tree: Tree) -> bool:
    """Whether a tree without a DBH tells no size, or one whose standard deviation is half of it and more."""
    known = rough_dbh_cm(tree)
    return tree.dbh_cm is None and (known is None or known[1] >= min(_REL_STD.values()) * known[0])


def rough_of_text(reason: str) -> tuple[float, float] | None:
    """The same by the reason as it is written in a ``trees.csv``."""
    for written in _WRITTEN.finditer(reason):
        known = _known(int(written[1]), int(written[2]))
        if known is not None:
            return known
    width = _WIDTH_WRITTEN.search(reason)
    if width is None:
        return None
    code = StemCode.stands_across if width[1] is None else StemCode.edges_unsupported
    return _of_width(int(width[1] or width[2]), code)


def _whole(reason: Notice, name: str) -> int:
    return round(float(str(reason.values[name])))


def _known(dbh_cm: int, half_cm: int) -> tuple[float, float] | None:
    most_cm = min(max(_MOST_REL_HALF * dbh_cm, _MOST_HALF_CM), dbh_cm)
    return (float(dbh_cm), half_cm / Z95) if 0 < half_cm <= most_cm else None


def _of_width(width_cm: int, code: StemCode) -> tuple[float, float] | None:
    return (float(width_cm), _REL_STD[code] * width_cm) if width_cm > 0 else None

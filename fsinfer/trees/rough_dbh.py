"""What a stem without a DBH says of its size all the same: "too uncertain: 6 cm +- 2 cm" is a thin stem.

Its section in a sum is better told by that than by the mean of all others, which is many times that of a sapling.
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
#: Edges that are no measurement: they name why the points are none.
_BY_EDGES = frozenset({StemCode.edges_unsupported, StemCode.edges_ragged})
#: As the reason is written in a ``trees.csv``, by itself or in the brackets of another one. Source: format; the
#: sentence of ``too_uncertain``.
_WRITTEN = re.compile(r"too uncertain: (\d+) cm \+- (\d+) cm")


def rough_dbh_cm(tree: Tree) -> tuple[float, float] | None:
    """Diameter and standard deviation, cm, by the reason of a tree without a DBH; None where it tells none."""
    if tree.dbh_cm is not None:
        return None
    for given in tree.reasons:
        # Where edges alone are no measurement, what the points say is in their notice.
        reason = given.values.get("refused") if given.code in _BY_EDGES else given
        if isinstance(reason, Notice) and reason.code == StemCode.too_uncertain:
            # Whole centimetres, as a table has them.
            return _known(*(round(float(str(reason.values[name]))) for name in ("dbh_cm", "half_width_cm")))
    written = (rough_of_text(str(reason.values.get("text", ""))) for reason in tree.reasons)
    return next((known for known in written if known is not None), None)


def rough_of_text(reason: str) -> tuple[float, float] | None:
    """The same by the reason as it is written in a ``trees.csv``."""
    written = _WRITTEN.search(reason)
    return _known(int(written[1]), int(written[2])) if written else None


def _known(dbh_cm: int, half_cm: int) -> tuple[float, float] | None:
    most_cm = min(max(_MOST_REL_HALF * dbh_cm, _MOST_HALF_CM), dbh_cm)
    return (float(dbh_cm), half_cm / Z95) if 0 < half_cm <= most_cm else None

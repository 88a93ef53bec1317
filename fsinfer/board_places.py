"""A board at two places: the plainest sign that photos were placed wrongly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from fsinfer.scale import Scale


def boards_at_two_places(boards: Scale, m_per_unit: float) -> list[str]:
    """One sentence for each board number found at several places: the sign of photos that were placed wrongly.

    ``m_per_unit`` are metres per unit of the scene, guessed where the scale is not known.
    """
    lines = []
    found = boards.details.get("markers", [])
    for number in sorted({entry["id"] for entry in found}):
        places = sorted((entry for entry in found if entry["id"] == number), key=lambda entry: -len(entry["views"]))
        for other in places[1:]:
            apart_m = m_per_unit * float(np.linalg.norm(np.subtract(other["center"], places[0]["center"])))
            views = sorted(other["views"])
            lines.append(
                f"Board {number} was found at two places {apart_m:.1f} m apart. Unless two boards have this number, "
                f"photos were placed wrongly, perhaps {views[0]} to {views[-1]}, and what is said of the trees cannot "
                "be trusted: take more photos there and on the way there, and turn slowly."
            )
    return lines

"""Diameters of two tables in different units, told by how many times the ones are the others."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from fsinfer.errors import InputError

#: Diameters of the same trees that differ by so many times are millimetres and centimetres. Source: judgement; a wide
#: range, for few trees may be measured badly.
_MILLIMETRES = (7.0, 14.0)
#: What else a table may hold instead of diameters in centimetres, and how many times they are. Source: definition.
_OTHERWISE = {"girths": math.pi, "inches": 1 / 2.54}
#: They are told where the median lies within this share, and half of all within so much of that. Source: judgement; no
#: method is wrong by such a factor in every tree alike. (By two a wrong scale may be: radii are not told.)
_NEAR, _ALIKE = 0.06, 0.1
#: Trees that tell. Source: judgement.
_LEAST_TREES = 3


def refuse_other_units(measured_cm: Sequence[float], extracted_cm: Sequence[float]) -> None:
    """Refuse one of two tables that holds millimetres, or a measured one of girths or inches.

    The two are of the same trees.

    Raises
    ------
    InputError
        Says which, and what to do.
    """
    if len(measured_cm) < _LEAST_TREES:
        return
    ratios = np.asarray(measured_cm, np.float64) / np.asarray(extracted_cm, np.float64)
    times = float(np.median(ratios))
    alike = float(np.median(np.abs(ratios / times - 1))) <= _ALIKE
    for name, larger in (("measured", times), ("extracted", 1.0 / times)):
        if _MILLIMETRES[0] <= larger <= _MILLIMETRES[1]:
            msg = f"the {name} diameters are {larger:.0f} times the others: give centimetres, not millimetres"
            raise InputError(msg)
    for what, factor in _OTHERWISE.items():
        if alike and abs(times / factor - 1) <= _NEAR:
            msg = (
                f"the measured diameters are {times:.2f} times the extracted ones, tree by tree: they look like "
                f"{what}; give diameters in centimetres (or the scale of the extracted ones is wrong)"
            )
            raise InputError(msg)

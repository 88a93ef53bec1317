"""Which boards agree on the scale, and how well all that agree know it.

A wrong print (``fit to page``, another paper), another number's size or a false detection gives a scale of its own. The
boards are one measurement each of the same quantity, so the largest subset whose members do not contradict each other
counts (Cox, "The evaluation of key comparison data: determining the largest consistent subset", Metrologia 44, 2007).
However near and sharp a wrong board is seen, two others outvote it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.scale.square_fit import MarkerSettings
from fsinfer.trees.diameter.budget import factor95
from fsinfer.trees.points.sums import Z95

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """What boards say together.

    Attributes
    ----------
    value: the scale. rel_std: its relative standard deviation; 1.96 of it hold 95 %.
    agrees: (N,) bool, whether each of the boards is in it.
    decided: whether those that are in it are the majority. Of two boards that contradict each other both are in it,
        and so are all where no majority agrees: their contradiction is in ``rel_std`` then.
    """

    value: float
    rel_std: float
    agrees: NDArray[np.bool_]
    decided: bool


def agreement(scales: Floats, rel_stds: Floats, settings: MarkerSettings) -> Agreement:
    """The scale by boards (N,), each with the relative standard deviation of its own side.

    How much a board is off beyond that is told by the spread between them and by what is known of other plots: a scaled
    inverse chi-squared prior of the variance (Gelman et al., Bayesian Data Analysis, 3rd ed., section 2.6), which with
    normal errors gives Student's interval. One board, or two that agree by chance, have little but the prior.
    """
    agrees = largest_agreeing(scales, rel_stds, settings)
    decided = bool(agrees.all() or agrees.sum() > len(scales) / 2)
    if not decided:
        agrees = np.ones(len(scales), bool)
    used, own = scales[agrees], rel_stds[agrees]
    # Boards differ by the warp of the model too, which no residual shows: none counts for much more than another.
    weights = 1 / (own**2 + settings.warp_rel_std**2)
    shares, count = weights / weights.sum(), len(used)
    value = float((shares * used).sum())
    own_var = float((shares * own**2).sum())
    expected = float(np.sqrt((shares**2 * own**2).sum()))
    # Who leaves out what contradicts sees less spread than there is: each board left out takes away what one tells.
    dof = max(settings.warp_dof, settings.warp_dof + count - 1 - int((~agrees).sum()))
    prior = settings.warp_dof * (settings.warp_rel_std**2 + own_var)
    variance = (prior + count * float((shares * (used / value - 1) ** 2).sum())) / dof
    spread = float(np.sqrt(variance / count)) * factor95(dof) / Z95
    rel_std = float(np.hypot(max(expected, spread), settings.length_rel_std))
    return Agreement(value=value, rel_std=rel_std, agrees=agrees, decided=decided)


def largest_agreeing(scales: Floats, rel_stds: Floats, settings: MarkerSettings) -> NDArray[np.bool_]:
    """The largest group of boards (N,) no two of which contradict each other; of equally large ones the surest."""
    apart = np.abs(np.log(scales[:, None] / scales[None]))
    stds = np.hypot(rel_stds, settings.warp_rel_std)
    allowed = np.maximum(settings.contradiction_stds * np.hypot(stds[:, None], stds[None]), settings.contradiction_rel)
    order = np.argsort(scales)
    best, best_key = np.zeros(len(scales), bool), (0, 0.0)
    # Sorted by scale, a group without contradictions is a run from its least member on, but for boards known badly.
    for at, first in enumerate(order):
        group = [int(first)]
        for other in order[at + 1 :]:
            if all(apart[other, member] <= allowed[other, member] for member in group):
                group.append(int(other))
        key = (len(group), float((1 / stds[group] ** 2).sum()))
        if key > best_key:
            best, best_key = np.isin(np.arange(len(scales)), group), key
    return best


def markers_of_boards(numbers: Sequence[int], centers: Floats, normals: Floats, sides: Floats) -> list[list[int]]:
    """Indices of markers (N,) grouped into boards, of which each is one opinion.

    The two faces of one board lie nearer than its side and look away from each other. One number that is found at two
    places near to each other, and looks the same way at both, is one board in a walk that drifted a little.

    Parameters
    ----------
    numbers: (N,) of the markers. centers, normals: (N, 3), in units of the scene; unit normals, NaN where not known.
    sides: (N,).
    """
    groups: list[list[int]] = []
    for index in range(len(centers)):
        for group in groups:
            first = group[0]
            ends, looks = (centers[first], centers[index]), (normals[first], normals[index])
            side = max(sides[first], sides[index])
            of_two_faces = len({numbers[member] for member in (*group, index)}) <= 2
            same = numbers[index] in [numbers[member] for member in group]
            if (of_two_faces and back_to_back(ends, looks, side)) or (same and _drifted(ends, looks, side)):
                group.append(index)
                break
        else:
            groups.append([index])
    return groups


#: Cosine between the directions that the two faces of one board look in, at most. Source: judgement; boards are flat.
_FACING_AWAY = -0.8
#: A number that is found at places nearer than so many sides of its square is one board. Source: judgement; nobody puts
#: up two of one number so near to each other, and a walk that drifts by more has photos in a wrong place.
_DRIFTED_SIDES = 2.0


def back_to_back(centers: Sequence[Floats], normals: Sequence[Floats], side: float) -> bool:
    """Whether two places of markers are the two faces of one board: nearer than its ``side``, facing away."""
    near = float(np.linalg.norm(np.subtract(*centers))) < side
    return near and float(np.dot(*normals)) < _FACING_AWAY


def _drifted(centers: Sequence[Floats], normals: Sequence[Floats], side: float) -> bool:
    """Whether two places of one number are those of one board of this ``side``, whichever of its faces they are."""
    near = float(np.linalg.norm(np.subtract(*centers))) < _DRIFTED_SIDES * side
    return near and abs(float(np.dot(*normals))) > -_FACING_AWAY

"""Stems that part below breast height: two by the rule of inventories, one tree to whoever stands before it.

A tree that forks below 1.3 m is measured as two stems, as in Germany's Bundeswaldinventur; one that forks above it has
one diameter, below the swelling of the fork. Both stems are in the table. What forks is told, so that a count of trees
can be made of a count of stems.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.tree import Tree

#: Stems of one tree are at most so many times the sum of their radii apart at breast height. Source: geometry, axes
#: that part at the ground by 25 degrees each way are 1.2 m apart there, four times the radii of two stems of 30 cm.
_MOST_APART = 4.0
#: Their axes part by so many degrees or more. Source: judgement; trees that stand close together do not lean that
#: much.
_LEAST_ANGLE_DEG = 6.0
#: The axes meet within this share of the sum of the radii, from so far below the ground on, metres. Source: judgement.
_MEET, _BELOW_M = 0.5, 0.4


def forks(trees: Sequence[Tree], sections: Sequence[Section]) -> tuple[Notice, ...]:
    """What to say of every two stems that meet below breast height, of those that are measured and not outside."""
    told = []
    stems = [pair for pair in zip(trees, sections, strict=True) if pair[1].dbh_m is not None and not pair[0].outside]
    for first, second in _beside_each_other(stems):
        (one, _), (other, _) = first, second
        height = fork_height(first, second)
        if height is not None:
            ground = min(one.z_ground_m, other.z_ground_m)
            ids = sorted((one.tree_id, other.tree_id))
            told.append(notice(StemCode.forked, tree_id=ids[0], other_id=ids[1], height_m=max(height - ground, 0.0)))
    return tuple(told)


def _beside_each_other(
    stems: Sequence[tuple[Tree, Section]],
) -> Iterator[tuple[tuple[Tree, Section], tuple[Tree, Section]]]:
    """The pairs of stems near enough for a fork, in their order; of thousands hardly any pair is, of millions."""
    places = np.array([_at_breast(tree) for tree, _ in stems]).reshape(-1, 3)
    slopes = np.array([section.slope for _, section in stems]).reshape(-1, 2)
    radii = np.array([float(section.dbh_m or 0.0) / 2 for _, section in stems])
    for row in range(len(stems) - 1):
        later = slice(row + 1, None)
        apart = _apart(places[row], slopes[row], places[later], slopes[later])
        near = np.hypot(apart[:, 0], apart[:, 1]) <= _MOST_APART * (radii[row] + radii[later])
        for other in (row + 1 + np.flatnonzero(near)).tolist():
            yield stems[row], stems[other]


def _apart(
    one: NDArray[np.float64], slope: NDArray[np.float64], others: NDArray[np.float64], slopes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """From axes ``others`` (..., 3) with ``slopes`` (..., 2) to ``one`` (3,) in plan, (..., 2).

    All at the lower breast height of the two: on a slope these differ.
    """
    top = np.minimum(one[2], others[..., 2:])
    return np.asarray((one[:2] - (one[2] - top) * slope) - (others[..., :2] - (others[..., 2:] - top) * slopes))


def fork_height(first: tuple[Tree, Section], second: tuple[Tree, Section]) -> float | None:
    """Height (z of the cloud) below breast height at which two measured stems part, None where they are no fork."""
    return _meeting_height(_at_breast(first[0]), first[1], _at_breast(second[0]), second[1])


def _at_breast(tree: Tree) -> NDArray[np.float64]:
    return np.array([tree.x_m, tree.y_m, tree.z_ground_m + tree.bh_m])


def _meeting_height(
    one: NDArray[np.float64], first: Section, other: NDArray[np.float64], second: Section
) -> float | None:
    """Height (z of the cloud) at which two axes come nearest to each other, if that is a fork; positions (3,)."""
    reach = float(first.dbh_m or 0.0) / 2 + float(second.dbh_m or 0.0) / 2
    top = min(one[2], other[2])
    apart = _apart(one, first.slope, other, second.slope)
    parting = np.asarray(first.slope - second.slope, np.float64)
    lean = float(np.linalg.norm(parting))
    if np.linalg.norm(apart) > _MOST_APART * reach or lean < np.tan(np.radians(_LEAST_ANGLE_DEG)):
        return None
    step = -float(apart @ parting) / lean**2
    lowest = -max(first.bh_m, second.bh_m) - _BELOW_M
    if not lowest <= step < 0 or np.linalg.norm(apart + step * parting) > _MEET * reach:
        return None
    return float(top + step)

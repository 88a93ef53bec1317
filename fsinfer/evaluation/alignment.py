"""Whether two stem maps have one frame, or a motion lays the one on the other better than chance would."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from fsinfer.evaluation.registration import apply, assign, register
from fsinfer.evaluation.settings import MAX_DISTANCE_M, Align

Floats = NDArray[np.float64]
Links = list[tuple[int, int]]

#: Frames are registered where fewer than this share of the trees match as given. Source: judgement.
_FEW_MATCHES = 0.5
#: Registration counts where it finds so many times the matches, so many more, and so many at least. Source: judgement.
_MORE_TIMES, _MORE_MATCHES, _LEAST_MATCHES = 1.5, 2, 3
#: It counts where it finds so many more than the mirror image does, or more and this share of the shorter list. Source:
#: judgement; of two maps of 30 trees that have nothing to do with each other 6 to 9 match, and as many of the image.
_MORE_THAN_CHANCE, _MOST_OF_THEM = 3, 0.6
#: Of a wide distance a motion found within the usual one counts where partners then lie at less than this share of how
#: far apart they lay. Source: judgement; the noise of places stays, a frame of its own goes.
_MUCH_NEARER = 0.5


class AlignmentDoubt(StrEnum):
    """Why a motion cannot be believed, or not be known to be the right one."""

    none = ""
    chance = "chance"
    mirrored = "mirrored"
    symmetric = "symmetric"
    other_numbers = "other_numbers"


def doubt_of_numbers(truth: Floats, found: Floats, limit: float) -> AlignmentDoubt:
    """Whether places (N, 2) of trees of the same numbers are those of the same trees, whatever the frames.

    They are not where half of the distances from tree to tree differ by more than the two ends of one may be off,
    ``limit`` metres each; of places that are no numbers, or of fewer than three, nothing is said.
    """
    known = np.isfinite(truth).all(axis=1) & np.isfinite(found).all(axis=1)
    if known.sum() < _LEAST_MATCHES:
        return AlignmentDoubt.none
    apart = float(np.median(np.abs(pdist(truth[known]) - pdist(found[known]))))
    return AlignmentDoubt.other_numbers if apart > 2.0 * limit else AlignmentDoubt.none


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """Partners (measured, extracted), the extracted positions (N, 2) as they were compared, and the motion if any.

    ``motion`` has the rotation in degrees and the shift in metres. ``doubt``: that a motion was looked for, and the
    best one lays no more trees on each other than it does of the mirror image (by chance, or because the trees stand
    symmetrically), or far fewer.
    """

    links: Links
    moved: Floats
    motion: dict[str, float] | None = None
    doubt: AlignmentDoubt = AlignmentDoubt.none


def align_maps(truth: Floats, found: Floats, limit: float, align: str) -> Alignment:
    """Match ``found`` (N, 2) with ``truth`` (M, 2) within ``limit`` metres, moved where ``align`` has it."""
    mirrored = AlignmentDoubt.none
    if align == Align.auto and limit > MAX_DISTANCE_M:
        nearby = align_maps(truth, found, MAX_DISTANCE_M, align)
        nearer = _aligned_nearby(truth, found, limit, nearby)
        if nearer is not None:
            return nearer
        if nearby.doubt == AlignmentDoubt.mirrored:
            mirrored = nearby.doubt
    links, fewer = assign(truth, found, limit), min(len(truth), len(found))
    alike = len(links) >= _FEW_MATCHES * fewer  # as given
    if align == Align.never or (align == Align.auto and alike):
        return Alignment(links=links, moved=found, doubt=mirrored)
    registered = register(truth, found, limit)
    if registered is None:
        return Alignment(links=links, moved=found)
    candidate = apply(registered, found)
    better = assign(truth, candidate, limit)
    clearly = len(better) >= max(len(links) + _MORE_MATCHES, _LEAST_MATCHES, _MORE_TIMES * len(links))
    doubt = AlignmentDoubt.none if alike else _doubt(truth, found, limit, len(better))
    believed = doubt in (AlignmentDoubt.none, AlignmentDoubt.symmetric)
    if align == Align.auto and not (clearly and believed):
        # Where no motion was about to be used there is nothing to doubt, unless the image fits.
        told = doubt if doubt == AlignmentDoubt.mirrored or (clearly and not believed) else AlignmentDoubt.none
        return Alignment(links=links, moved=found, doubt=told)
    motion = {
        "rotation_deg": float(np.degrees(registered[0])),
        "shift_x_m": float(registered[1]),
        "shift_y_m": float(registered[2]),
    }
    return Alignment(links=better, moved=candidate, motion=motion, doubt=doubt)


def _aligned_nearby(truth: Floats, found: Floats, limit: float, nearby: Alignment) -> Alignment | None:
    """The maps as ``nearby`` lays them on each other, where that explains them better than as they are given.

    ``nearby`` is what :func:`align_maps` finds within the usual distance. Within a ``limit`` of metres about any tree
    has a partner, in any frame, and in the mirror image too: how many find one says nothing. None where no motion is
    found, or partners are fewer by it, or hardly nearer.
    """
    if nearby.motion is None:
        return None
    given, better = assign(truth, found, limit), assign(truth, nearby.moved, limit)
    if len(better) < len(given):
        return None
    if given and _apart(truth, nearby.moved, better) >= _MUCH_NEARER * _apart(truth, found, given):
        return None
    return Alignment(links=better, moved=nearby.moved, motion=nearby.motion, doubt=nearby.doubt)


def _apart(truth: Floats, moved: Floats, links: Links) -> float:
    """How far partners lie apart, metres: the median."""
    return float(np.median([np.linalg.norm(truth[i] - moved[j]) for i, j in links]))


def _doubt(truth: Floats, found: Floats, limit: float, matches: int) -> AlignmentDoubt:
    """The mirror image is a map of as many trees, as far apart, that no motion lays on the truth but by chance."""
    image = found * [-1.0, 1.0]
    registered = register(truth, image, limit)
    by_chance = 0 if registered is None else len(assign(truth, apply(registered, image), limit))
    most = _MOST_OF_THEM * min(len(truth), len(found))
    if by_chance >= matches + _MORE_THAN_CHANCE and by_chance >= most:
        return AlignmentDoubt.mirrored
    if matches >= by_chance + _MORE_THAN_CHANCE or (matches > by_chance and matches >= most):
        return AlignmentDoubt.none
    # A row of trees, or a plantation, is its own mirror image.
    return AlignmentDoubt.symmetric if matches >= most else AlignmentDoubt.chance

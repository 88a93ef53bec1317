"""Photos that were placed at another scale than the walk: the steps between neighbours tell.

Structure from motion may join a part of the walk by a few false matches only. Such a part is consistent in itself, so
that no reprojection error shows it, but nothing ties its scale: a person who walked half a metre from photo to photo
would have walked ten metres there. What a robust look at the steps finds needs no other evidence.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Fewer photos are no walk: they may be in any order. Source: judgement.
MIN_PHOTOS = 40
#: Photos before and after whose steps count. Source: a turn on the spot or a detour is shorter than the window.
HALF_WINDOW = 5
#: The median step of a window may differ from that of the whole walk by this factor. Source: rendered walks and the 23
#: photos round a trunk stay between 0.57 and 1.38; the stretches of a falsely joined part lay at 0.02, 7 and 13.
FACTOR = 4.0
#: Once such a stretch is found, only unbroken stretches of so large a part of the photos are trusted: a falsely joined
#: part comes in several pieces, some of them at the right scale and in the wrong place. Source: judgement, on a
#: rendered slope with a quick turn; renders only.
TRUSTED_PART = 0.2
#: Where somebody walked, what photos show moves by this share of what it usually moves by from one to the next, or
#: more. Source: judgement; one who stands still turns, which moves nothing beside what the turn explains.
_WALKED = 0.5
#: So many short steps in a row are no accident. Source: judgement.
_SHORT_STEPS = 2


def _steps(centers: NDArray[np.float64], order: NDArray[np.intp]) -> NDArray[np.float64]:
    """Length of each step, (N - 1,), a photo's share where one is missing; NaN over wider gaps."""
    gaps = np.diff(order)
    steps: NDArray[np.float64] = np.linalg.norm(np.diff(centers, axis=0), axis=1) / gaps
    steps[gaps > 2] = np.nan
    return steps


def stretches(centers: NDArray[np.float64], order: NDArray[np.intp]) -> NDArray[np.intp]:
    """Number of the unbroken stretch of the walk that each photo belongs to, (N,); see :func:`strays`.

    A stretch ends where photos are missing or where the next one is several steps away.
    """
    steps = _steps(centers, order)
    broken = np.isnan(steps) | (steps > FACTOR * float(np.nanmedian(steps)))
    return np.concatenate([[0], np.cumsum(broken)])


def strays(centers: NDArray[np.float64], order: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether each photo belongs to a stretch whose steps do not fit the walk, or to a small one beside it, (N,) bool.

    Parameters
    ----------
    centers: (N, 3) camera centres in any unit, in the order of walking.
    order: (N,) increasing number of each photo in the walk; numbers are missing where photos were not placed, and no
        step is taken over a gap of more than two.

    Notes
    -----
    Nothing is a stray where it would be half of the photos or more, or where there are fewer than ``MIN_PHOTOS``.
    """
    count = len(centers)
    none = np.zeros(count, dtype=bool)
    if count < MIN_PHOTOS:
        return none
    steps = _steps(centers, order)
    usual = float(np.nanmedian(steps))
    if not usual > 0.0:
        return none
    local = np.full(count, usual)
    for i in range(count):
        window = steps[max(0, i - HALF_WINDOW) : i + HALF_WINDOW]
        if np.isfinite(window).sum() >= HALF_WINDOW:
            local[i] = np.nanmedian(window)
    found = (local > FACTOR * usual) | (local < usual / FACTOR)
    if found.any():
        stretch = stretches(centers, order)
        sizes, wrong = np.bincount(stretch), np.bincount(stretch, weights=found)
        found |= ((sizes < TRUSTED_PART * count) | (wrong > 0.5 * sizes))[stretch]
    return found if found.sum() < count / 2 else none


def shrunk(
    centers: NDArray[np.float64], order: NDArray[np.intp], parallax_px: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Whether each photo stands in a stretch that was placed far too small, (N,) bool.

    Photos that the mapper knew by what is far away, or by each other, may shrink to a place on a straight walk. The
    matches of two photos tell nothing of how far apart they stand, so that all agree with it. But what they show moves
    from one to the next as it does elsewhere, and somebody who walks nowhere sees nothing move.

    Parameters
    ----------
    centers, order: see :func:`strays`.
    parallax_px: (N - 1,) by how much matches of each photo with the next move beside what its turn explains, median;
        NaN where it is not known.
    """
    found = np.zeros(len(centers), dtype=bool)
    if len(centers) < MIN_PHOTOS:
        return found
    steps, moved = _steps(centers, order), parallax_px / np.diff(order)
    if np.isnan(steps).all() or np.isnan(moved).all():
        return found
    short = (steps < float(np.nanmedian(steps)) / FACTOR) & (moved > _WALKED * float(np.nanmedian(moved)))
    first = np.flatnonzero(short & ~np.r_[False, short[:-1]])
    last = np.flatnonzero(short & ~np.r_[short[1:], False])
    for begin, end in zip(first, last, strict=True):
        if end - begin + 1 >= _SHORT_STEPS:
            found[begin : end + 2] = True
    return found if found.sum() < len(centers) / 2 else np.zeros_like(found)

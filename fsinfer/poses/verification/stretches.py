"""Stretches of a walk that are right in themselves, although the mapper put them together wrongly.

Where a few false matches bent a walk, the true ones of the photos on both sides of the bend are left over: hundreds of
them, of photos that follow each other. Cut there, the stretches are what was mapped rightly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.verification.pair_votes import Ballot, PairVote

#: Matches across a cut that must speak against it for each one that speaks for it, and how many at least. Source:
#: judgement; on a rendered plot that was bent in five places it was all of 1,608 and 3,364 and eight times as many.
_AGAINST, _FEWEST_AGAINST = 2.0, 100.0
#: A stretch of so large a part of the walk at most is taken out by its neighbours' word. Source: as of photos at
#: another scale than the walk, ``scale_jumps.py``.
_SHORT_PART = 0.2
#: Matches that contradict a stretch, for each pair that neighbours could make with it, against those of a usual pair
#: of neighbours. Source: a rendered walk whose last seven photos stood 4.3 m off, where the ground looks the same: as
#: many as usual (docs/trials-accuracy.md); renders only.
_AS_NEIGHBOURS = 0.3


def stretches_of_walk(votes: Sequence[PairVote], count: int, neighbours: int) -> NDArray[np.intp]:
    """Number of the stretch that each of ``count`` photos is in, (count,), ascending along the walk.

    Parameters
    ----------
    votes: of pairs of photos, which are numbered in the order of walking.
    neighbours: pairs at most so many photos apart vote on the cuts between them.
    """
    ballot = Ballot.of(votes)
    ends = np.sort(ballot.ends, axis=1)
    near = ends[:, 1] - ends[:, 0] <= neighbours
    first, last = ends[near].T
    weight, agrees = ballot.weight[near], ballot.agrees[near]
    cut = np.zeros(max(count - 1, 0), np.bool_)
    whole = np.ones(len(first), np.bool_)
    while len(cut):
        pro = _across(first[whole & agrees], last[whole & agrees], weight[whole & agrees], count)
        contra = _across(first[whole & ~agrees], last[whole & ~agrees], weight[whole & ~agrees], count)
        open_ = (contra >= _FEWEST_AGAINST) & (contra > _AGAINST * pro) & ~cut
        if not open_.any():
            break
        # The clearest first: pairs across it said all they have to say, also of the cuts beside it.
        at = int(np.argmax(np.where(open_, contra - _AGAINST * pro, -np.inf)))
        cut[at] = True
        whole &= ~((first <= at) & (last > at))
    return np.concatenate([np.zeros(min(count, 1), np.intp), np.cumsum(cut, dtype=np.intp)])


def torn_off(votes: Sequence[PairVote], count: int, neighbours: int) -> NDArray[np.bool_]:
    """Whether each of ``count`` photos is in a short stretch that its neighbours in the walk contradict, (count,) bool.

    Such a stretch was put where something looks alike, and its photos vouch for each other. A walk that was begun anew
    elsewhere is a stretch, too, and false matches with what came before it contradict it; but who shares as much with
    the photos before as neighbours do elsewhere looks at the same.

    Parameters
    ----------
    votes, neighbours: see :func:`stretches_of_walk`.
    """
    stretch = stretches_of_walk(votes, count, neighbours)
    torn = np.zeros(count, np.bool_)
    ballot = Ballot.of(votes)
    near = np.abs(np.diff(ballot.ends, axis=1)[:, 0]) <= neighbours
    ends, weight, against = ballot.ends[near], ballot.weight[near], ~ballot.agrees[near]
    usual = float(np.median(weight[~against])) if not against.all() else np.inf
    for number, size in enumerate(np.bincount(stretch)):
        if size > _SHORT_PART * count:
            continue
        mine = stretch == number
        across = mine[ends].sum(axis=1) == 1
        # Pairs that share nothing count as none: neighbours would.
        apart = np.abs(np.subtract.outer(np.flatnonzero(mine), np.flatnonzero(~mine)))
        possible = int((apart <= neighbours).sum())
        if weight[across & against].sum() >= _AS_NEIGHBOURS * usual * possible:
            torn |= mine
    return torn


def _across(
    first: NDArray[np.intp], last: NDArray[np.intp], weight: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Weight of the pairs that span each of the ``count - 1`` cuts between a photo and the next."""
    change = np.zeros(count + 1)
    np.add.at(change, first, weight)
    np.add.at(change, last, -weight)
    return np.cumsum(change)[: count - 1]

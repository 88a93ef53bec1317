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


def _across(
    first: NDArray[np.intp], last: NDArray[np.intp], weight: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Weight of the pairs that span each of the ``count - 1`` cuts between a photo and the next."""
    change = np.zeros(count + 1)
    np.add.at(change, first, weight)
    np.add.at(change, last, -weight)
    return np.cumsum(change)[: count - 1]

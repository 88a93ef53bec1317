"""Which photos to match: neighbours in the walk, a wide net over the rest, and what lies beside its catch."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from statistics import median

Pair = tuple[int, int]

#: Matches that a pair needs after the geometric check; fewer are none. Source: COLMAP's default.
MIN_INLIERS = 15
#: So many matches of a pair promise as much for those beside it as more would. Source: judgement.
_ENOUGH_INLIERS = 100


@dataclass(frozen=True, kw_only=True)
class PairSettings:
    """How pairs of photos are chosen.

    Attributes
    ----------
    exhaustive_up_to: with at most this many photos every pair is matched; above, photos are taken to be in the order
        of walking (names). Source: their 1,770 pairs take about a minute on two cores.
    overlap: above that, each photo is matched with this many next ones.
    loop_stride: and every so many-th photo with every other such photo: the net.
    net_pairs_per_photo: the stride grows with the photos, so that the net holds at most so many pairs a photo.
    rounds, pairs_per_round: beside pairs that did match, others are tried: so many rounds, so many pairs a photo each.
    reach: at most so many photos beside, on both sides.
    order_ratio, order_share: few photos are in the order of walking if, of those that follow each other, this share
        match, and their median is so many times that of photos farther apart. Source: judgement.

    Notes
    -----
    Chosen on 200 photos of a rendered plot, walked round outside and inside, all 19,900 pairs of which were matched:
    3,505 pairs more than 12 apart hold 15 matches or more. A net of every fifth photo, twelve neighbours and those 16,
    32, 64 and 128 further on found 242 of them with 3,585 pairs; these settings find 1,162 with 3,292.

    Source of the rest: 200 photos of a rendered plot with all pairs matched, see the notes; renders only.
    """

    exhaustive_up_to: int = 60
    overlap: int = 8
    loop_stride: int = 6
    net_pairs_per_photo: float = 3.4
    rounds: int = 2
    pairs_per_round: float = 3.0
    reach: int = 3
    order_ratio: float = 3.0
    order_share: float = 0.8


def first_pairs(count: int, settings: PairSettings) -> list[Pair]:
    """Pairs of photos (by rank of the name) to be matched first, each ``first < second``, sorted.

    All of them for few photos; otherwise neighbours and a net that finds where the walk comes back to a place, without
    a vocabulary to download. The number of pairs grows in proportion to the photos.
    """
    if count <= settings.exhaustive_up_to:
        return list(combinations(range(count), 2))
    stride = max(settings.loop_stride, math.ceil(math.sqrt(count / (2 * settings.net_pairs_per_photo))))
    pairs = set(combinations(range(0, count, stride), 2))
    for first in range(count):
        pairs |= {(first, second) for second in range(first + 1, min(first + settings.overlap, count - 1) + 1)}
    return sorted(pairs)


def most_pairs(count: int, settings: PairSettings) -> int:
    """Pairs that are matched at most: those of :func:`first_pairs` and full rounds beside them."""
    first = len(first_pairs(count, settings))
    return first if count <= settings.exhaustive_up_to else first + settings.rounds * _budget(count, settings)


def _budget(count: int, settings: PairSettings) -> int:
    return math.ceil(settings.pairs_per_round * count)


def in_walking_order(inliers: Mapping[Pair, int], count: int, settings: PairSettings) -> bool:
    """Whether photos that follow each other by name were taken one after the other.

    More than ``exhaustive_up_to`` are taken to be; fewer are judged by what they share.

    Parameters
    ----------
    inliers: of the pairs that matched, the matches that passed the geometric check.
    """
    if count > settings.exhaustive_up_to:
        return True
    following = [inliers.get((first, first + 1), 0) for first in range(count - 1)]
    apart = [inliers.get(pair, 0) for pair in combinations(range(count), 2) if pair[1] - pair[0] > settings.overlap]
    if not apart:
        return False
    matching = sum(found >= MIN_INLIERS for found in following)
    if matching < settings.order_share * len(following):
        return False
    return median(following) >= settings.order_ratio * median(apart)


def pairs_beside(inliers: Mapping[Pair, int], count: int, settings: PairSettings) -> list[Pair]:
    """Pairs to be matched next, sorted: beside those that closed a loop, the most promising first into the budget.

    Parameters
    ----------
    inliers: of every pair that was tried, the matches that passed the geometric check; 0 where none did.
    count: photos in the walk.
    """
    promise: dict[Pair, float] = {}
    steps = range(-settings.reach, settings.reach + 1)
    for (first, second), found in inliers.items():
        if found < MIN_INLIERS or second - first <= settings.overlap:
            continue
        for left in steps:
            for right in steps:
                pair = (first + left, second + right)
                if pair[0] < 0 or pair[1] >= count or pair[1] - pair[0] <= settings.overlap or pair in inliers:
                    continue
                # A pair in the middle of several good ones is the best guess; a hundred matches are as good as more.
                promise[pair] = promise.get(pair, 0.0) + min(found, _ENOUGH_INLIERS) / (1 + abs(left) + abs(right))
    return sorted(sorted(promise, key=lambda pair: (-promise[pair], pair))[: _budget(count, settings)])

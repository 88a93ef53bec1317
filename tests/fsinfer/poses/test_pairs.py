"""Pairs of photos to match: all of few, neighbours and a net of many, and what lies beside a loop that was found."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fsinfer.poses.pairs import PairSettings, first_pairs, in_walking_order, most_pairs, pairs_beside


def test_few_photos_are_all_matched() -> None:
    settings = PairSettings(exhaustive_up_to=20)
    assert len(first_pairs(20, settings)) == most_pairs(20, settings) == 190


def test_neighbours_and_a_net() -> None:
    settings = PairSettings(exhaustive_up_to=20, overlap=3, loop_stride=10)
    pairs = first_pairs(50, settings)
    assert len(set(pairs)) == len(pairs) < 50 * 49 / 4
    assert all(0 <= first < second < 50 for first, second in pairs)
    assert {(0, 1), (0, 3), (46, 49), (48, 49), (0, 40), (10, 30)} <= set(pairs)
    assert not {(1, 48), (0, 4), (5, 15)} & set(pairs)
    # Every photo hangs together with the rest through its neighbours.
    assert {second for first, second in pairs if first == second - 1} == set(range(1, 50))


def test_pairs_grow_in_proportion_to_the_photos_and_the_net_still_spans_the_walk() -> None:
    settings = PairSettings()
    for count in (100, 200, 300, 600, 1200):
        pairs = first_pairs(count, settings)
        assert len(pairs) <= count * (settings.overlap + settings.net_pairs_per_photo)
        assert most_pairs(count, settings) <= count * (8 + 3.4 + 2 * 3) + 2
        stride = max(6, int(np.ceil(np.sqrt(count / 6.8))))
        assert (0, (count - 1) // stride * stride) in pairs


@given(st.integers(70, 300), st.integers(0, 9999))
def test_pairs_beside_are_new_near_a_seed_and_within_the_budget(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    settings = PairSettings()
    inliers = {pair: int(rng.choice([0, 0, 0, 20, 90])) for pair in first_pairs(count, settings)}
    found = pairs_beside(inliers, count, settings)
    assert found == sorted(set(found))
    assert len(found) <= np.ceil(settings.pairs_per_round * count)
    seeds = np.array([pair for pair, value in inliers.items() if value >= 15 and pair[1] - pair[0] > settings.overlap])
    for pair in found:
        assert pair not in inliers
        assert 0 <= pair[0] < pair[1] - settings.overlap < count
        assert np.abs(seeds - pair).max(axis=1).min() <= settings.reach


def test_the_most_promising_come_first() -> None:
    settings = PairSettings(pairs_per_round=0.02)
    # Both good pairs speak for what lies between them; the poor one is not alone, but last.
    inliers = {(10, 60): 80, (12, 62): 80, (30, 90): 16}
    found = pairs_beside(inliers, 100, settings)
    assert found == [(10, 61), (11, 60)]
    assert (30, 91) in pairs_beside(inliers, 100, PairSettings())


def test_a_straight_walk_has_nothing_beside_its_neighbours() -> None:
    settings = PairSettings()
    inliers = {pair: 200 if pair[1] - pair[0] <= 8 else 0 for pair in first_pairs(100, settings)}
    assert pairs_beside(inliers, 100, settings) == []


def test_a_loop_is_found_all_along_from_a_few_hits_of_the_net() -> None:
    count, settings = 200, PairSettings()
    # The walk comes back after a hundred photos: i and i + 100 see the same.
    truth = {(i, j): 60 for i in range(count) for j in range(i + 1, count) if abs(j - i - 100) <= 2 or j - i <= 8}
    known = {pair: truth.get(pair, 0) for pair in first_pairs(count, settings)}
    before = sum(value > 0 for (i, j), value in known.items() if j - i > 8)
    for _ in range(settings.rounds):
        known |= {pair: truth.get(pair, 0) for pair in pairs_beside(known, count, settings)}
    after = sum(value > 0 for (i, j), value in known.items() if j - i > 8)
    assert after > 10 * before
    assert len(known) <= most_pairs(count, settings)


def test_few_photos_are_in_the_order_of_walking_or_not() -> None:
    rng = np.random.default_rng(0)
    count, settings = 30, PairSettings()
    # A walk: what two photos share falls off with the steps between them, and one step is blurred.
    walk = {(i, j): int(600 / (j - i) ** 2) for i, j in combinations(range(count), 2)} | {(7, 8): 3}
    assert in_walking_order(walk, count, settings)
    shuffled = rng.permutation(count)
    ends = {pair: sorted(int(shuffled[i]) for i in pair) for pair in walk}
    mixed = {(first, last): walk[pair] for pair, (first, last) in ends.items()}
    assert not in_walking_order(mixed, count, settings)
    # All photos look at one trunk: names tell nothing that the matches would not.
    assert not in_walking_order(dict.fromkeys(combinations(range(count), 2), 200), count, settings)
    assert not in_walking_order({(0, 1): 500, (1, 2): 500}, 3, settings)
    # Too many to match all: only their order says which.
    assert in_walking_order({}, settings.exhaustive_up_to + 1, settings)

"""Who computes which view: each once, neighbours together, and nothing lost with a worker."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from fsinfer.depth.runs_of_views import RunsOfViews


def test_workers_of_one_speed_have_a_run_each() -> None:
    runs = RunsOfViews(12, workers=3)
    given_out: dict[str, list[int]] = {name: [] for name in "abc"}
    for _ in range(4):
        for name, views in given_out.items():
            view = runs.take(name)
            assert view is not None
            views.append(view)
    assert sorted(given_out.values()) == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11]]
    assert [runs.take(name) for name in "abc"] == [None] * 3


def test_whoever_is_quick_takes_half_of_what_the_slow_one_has_left() -> None:
    runs = RunsOfViews(20, workers=2)
    first = runs.take("slow")
    taken = list(iter(lambda: runs.take("quick"), None))
    assert first is not None
    assert sorted([first, *taken]) == list(range(20))
    # Ten of its own in one run, then ever shorter halves of the other's nine.
    steps = [b - a for a, b in pairwise(taken)]
    assert steps.count(1) >= 14


def test_the_run_of_a_lost_worker_goes_to_another_in_one_piece() -> None:
    runs = RunsOfViews(8, workers=2)
    lost = [runs.take("lost"), runs.take("lost")]
    assert lost == [0, 1]
    runs.give_back("lost", 1)
    assert runs.left == 7
    assert [runs.take("new") for _ in range(4)] == [4, 5, 6, 7]
    assert [runs.take("new") for _ in range(4)] == [1, 2, 3, None]


@given(
    count=st.integers(0, 40),
    workers=st.integers(0, 6),
    steps=st.lists(st.tuples(st.sampled_from("abcd"), st.booleans()), max_size=60),
)
def test_every_view_is_computed_once_whoever_is_lost(count: int, workers: int, steps: list[tuple[str, bool]]) -> None:
    runs = RunsOfViews(count, workers=workers)
    done: list[int] = []
    for worker, dies in steps:
        view = runs.take(worker)
        if view is None:
            assert len(done) == count
        elif dies:
            runs.give_back(worker, view)
        else:
            done.append(view)
        assert runs.left == count - len(done)
    done += list(iter(lambda: runs.take("last"), None))
    assert sorted(done) == list(range(count))

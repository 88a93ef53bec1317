"""Work shared out over threads comes back in order, a few items ahead, and stops where an item fails."""

from __future__ import annotations

import threading
import time

import pytest

from fsinfer.threads import in_order


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_order_of_the_items(threads: int) -> None:
    def slow_first(item: int) -> int:
        time.sleep(0.02 if item % 3 == 0 else 0)
        return item * item

    assert list(in_order(slow_first, range(17), threads)) == [item * item for item in range(17)]
    assert list(in_order(slow_first, [], threads)) == []


def test_so_many_are_worked_on_at_a_time() -> None:
    together = threading.Barrier(3, timeout=30)
    assert list(in_order(lambda item: (together.wait(), item)[1], range(6), 3)) == [*range(6)]


@pytest.mark.parametrize("ahead", [0, 3])
def test_no_more_is_begun_than_is_soon_taken(ahead: int) -> None:
    begun: list[int] = []
    results = in_order(begun.append, range(100), 2, ahead=ahead)
    for taken in range(1, 20):
        next(results)
        assert len(begun) <= taken + 2 + ahead
    results.close()
    assert len(begun) < 25 + ahead


def test_so_many_more_are_begun_as_are_asked_for() -> None:
    begun: list[int] = []
    all_begun = threading.Event()

    def begin(item: int) -> int:
        begun.append(item)
        if len(begun) == 1 + 2 + 3:
            all_begun.set()
        return item

    results = in_order(begin, range(100), 2, ahead=3)
    assert next(results) == 0
    assert all_begun.wait(timeout=10)
    results.close()


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_comes_in_its_turn_and_ends_the_work(threads: int) -> None:
    begun: list[int] = []

    def fail_at_three(item: int) -> int:
        begun.append(item)
        if item == 3:
            raise ValueError("three")
        return item

    taken: list[int] = []
    with pytest.raises(ValueError, match="three"):
        taken.extend(in_order(fail_at_three, range(100), threads))
    assert taken == [0, 1, 2]
    assert max(begun) <= 3 + 2

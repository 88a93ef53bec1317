"""Work in a thread beside what is done within a block."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from fsinfer.threads import beside

WAIT_S = 10.0


def test_the_work_goes_on_beside_the_block_and_its_result_is_waited_for() -> None:
    from_within = threading.Event()

    def work(_go_on: Callable[[], None]) -> int:
        assert from_within.wait(WAIT_S)
        return 7

    with beside(work) as result:
        from_within.set()
        assert result() == 7


def test_its_error_comes_where_its_result_would() -> None:
    def work(_go_on: Callable[[], None]) -> int:
        raise ValueError("in the thread")

    with beside(work) as result, pytest.raises(ValueError, match="in the thread"):
        result()


def test_work_that_nobody_waits_for_ends_soon_and_the_block_s_own_error_is_told() -> None:
    begun, steps = threading.Event(), []

    def work(go_on: Callable[[], None]) -> None:
        for step in range(10_000):
            begun.set()
            go_on()
            steps.append(step)
            time.sleep(0.01)

    def interrupted() -> None:
        with beside(work):
            assert begun.wait(WAIT_S)
            raise KeyboardInterrupt

    before = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len(steps) < 1000
    assert time.monotonic() - before < WAIT_S

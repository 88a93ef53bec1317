"""Work in processes: in order, beside each other, and done all the same when one of them ends."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest
from threadpoolctl import threadpool_info

from fsinfer import processes
from fsinfer.errors import SceneError
from fsinfer.process_worker import Answer
from fsinfer.processes import as_ready, shared_out, worker_processes, workers_peak_mb
from fsinfer.trees.measure import analyse_plot
from fsinfer.trees.stem_curve import stem_curves
from fsinfer.workflow.memory_peak import MemoryPeak
from fsinfer.workflow.tree_stage import tree_workers
from tests.support.stem_clouds import stem_plot

#: More than any of these takes on a busy machine.
PATIENCE_S = 60.0


@pytest.fixture
def answered(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How many items other processes did, by the work's name."""
    found: Counter[str] = Counter()
    ask = processes._Worker.ask

    def noted(self: processes._Worker, work: Callable[[object], object], item: object) -> Answer:
        answer = ask(self, work, item)
        found[getattr(work, "func", work).__name__] += 1
        return answer

    monkeypatch.setattr(processes._Worker, "ask", noted)
    return found


def number_and_process(number: int) -> tuple[int, int]:
    time.sleep(0.02)
    return number, os.getpid()


def refuse(number: int) -> int:
    if number == 2:
        msg = "no scene"
        raise SceneError(msg)
    return number


def end_itself(parent: int, number: int) -> tuple[int, int]:
    if number == 1 and os.getpid() != parent:
        os._exit(9)
    return number, os.getpid()


def no_answer(_number: int) -> Callable[[], None]:
    return lambda: None


class CannotBeSent(Exception):
    """An error that needs two words."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(f"{one} {other}")


def raise_what_cannot_be_sent(_number: int) -> None:
    raise CannotBeSent("one", "other")


def is_there(process: int) -> bool:
    try:
        os.kill(process, 0)
    except OSError:
        return False
    return Path(f"/proc/{process}/stat").read_text(encoding="ascii").split()[2] != "Z"


def test_work_is_done_by_other_processes_in_order() -> None:
    with worker_processes((), count=2):
        found = list(shared_out(number_and_process, range(12)))
    assert [number for number, _ in found] == list(range(12))
    by_process = {process for _, process in found}
    assert len(by_process) == 2
    assert os.getpid() not in by_process


@pytest.mark.parametrize("count", [None, 1])
def test_without_processes_it_is_done_here(count: int | None) -> None:
    def found() -> set[int]:
        return {process for _, process in shared_out(number_and_process, range(3))}

    if count is None:
        assert found() == {os.getpid()}
    else:
        with worker_processes((), count=count):
            assert found() == {os.getpid()}


def test_one_works_beside_this_one_where_it_is_asked_to() -> None:
    with worker_processes((), count=1, beside=True):
        found = {process for _, process in shared_out(number_and_process, range(3))}
        assert len(found) == 1
        assert os.getpid() not in found
    with worker_processes((), count=0, beside=True):
        assert {process for _, process in shared_out(number_and_process, range(3))} == {os.getpid()}


def test_within_another_no_more_are_started() -> None:
    with worker_processes((), count=2):
        before = {process for _, process in shared_out(number_and_process, range(8))}
        with worker_processes((), count=3):
            assert {process for _, process in shared_out(number_and_process, range(12))} == before
        assert {process for _, process in shared_out(number_and_process, range(8))} == before
    assert not any(is_there(process) for process in before)


def test_an_error_comes_where_its_result_would() -> None:
    with worker_processes((), count=2):
        found = shared_out(refuse, range(5))
        assert [next(found), next(found)] == [0, 1]
        with pytest.raises(SceneError, match="no scene") as error:
            next(found)
        # Who looks for it finds out where in the other process it arose.
        assert any("in refuse" in note for note in error.value.__notes__)
        assert list(shared_out(refuse, (3, 4))) == [3, 4]


def test_each_process_keeps_to_its_own_and_results_come_as_they_get_ready() -> None:
    own = {0: iter(range(6)), 1: iter(range(10, 16))}
    with worker_processes((), count=2):
        found = list(as_ready(number_and_process, lambda process: next(own[process], None)))
    assert sorted(number for number, _ in found) == [*range(6), *range(10, 16)]
    for first in (0, 10):
        of_run = [pair for pair in found if first <= pair[0] < first + 6]
        assert [number for number, _ in of_run] == list(range(first, first + 6))
        assert len({process for _, process in of_run}) == 1
    assert len({process for _, process in found} | {os.getpid()}) == 3


def test_without_processes_the_first_takes_all() -> None:
    items = iter(range(3))

    def take(process: int) -> int | None:
        assert process == 0
        return next(items, None)

    assert [process for _, process in as_ready(number_and_process, take)] == [os.getpid()] * 3


def test_what_a_process_had_taken_when_it_ended_is_done_all_the_same(caplog: pytest.LogCaptureFixture) -> None:
    own = {0: iter((0, 1, 2)), 1: iter((10, 11, 12))}
    with worker_processes((), count=2):
        found = list(as_ready(partial(end_itself, os.getpid()), lambda process: next(own[process], None)))
    assert sorted(number for number, _ in found) == [0, 1, 2, 10, 11, 12]
    assert {number for number, process in found if process == os.getpid()} == {1, 2}
    assert "its share is done by the run itself" in caplog.text


def test_an_error_of_one_process_ends_the_others_work() -> None:
    own = {0: iter((0, 1, 2, 3)), 1: itertools.count(10)}
    with worker_processes((), count=2):
        with pytest.raises(SceneError, match="no scene"):
            list(as_ready(refuse, lambda process: next(own[process], None)))
        # The processes are there for what comes next.
        assert os.getpid() not in {process for _, process in shared_out(number_and_process, range(4))}
        endless = as_ready(number_and_process, lambda process: next(own[1]))
        next(endless)
        endless.close()
        before = next(own[1])
        time.sleep(0.2)
        assert next(own[1]) == before + 1  # nothing more is taken


@pytest.mark.parametrize("work", [no_answer, raise_what_cannot_be_sent])
def test_what_cannot_be_sent_is_an_error_and_no_end(work: Callable[[int], object]) -> None:
    with worker_processes((), count=2):
        with pytest.raises(RuntimeError, match="cannot send"):
            list(shared_out(work, range(2)))
        assert list(shared_out(refuse, (3, 4))) == [3, 4]


def test_what_a_process_had_to_do_when_it_ended_is_done_all_the_same() -> None:
    with worker_processes((), count=2):
        found = list(shared_out(partial(end_itself, os.getpid()), range(6)))
        assert [number for number, _ in found] == list(range(6))
        assert found[1][1] == os.getpid()
        assert os.getpid() not in {process for number, process in found if number == 0}
        # One is gone, one is left.
        assert list(shared_out(refuse, (3, 4, 5, 6))) == [3, 4, 5, 6]


def test_what_work_holds_is_sent_once(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[object] = []
    send = processes._Worker._send

    def noted(self: processes._Worker, message: tuple[str, object]) -> None:
        sent.append(message)
        send(self, message)

    monkeypatch.setattr(processes._Worker, "_send", noted)
    with worker_processes((), count=2):
        list(shared_out(partial(number_and_process), range(10)))
    assert sum(isinstance(message, tuple) and message[0] == "work" for message in sent) == 2


def test_items_are_taken_as_they_are_needed() -> None:
    taken = 0

    def items() -> Iterator[int]:
        nonlocal taken
        for number in range(40):
            taken += 1
            yield number

    with worker_processes((), count=2):
        next(shared_out(number_and_process, items()))
        assert taken < 10


def test_a_process_has_one_thread_for_linear_algebra() -> None:
    with worker_processes(("numpy.linalg",), count=2):
        assert set(shared_out(_threads_of_blas, range(4))) == {1}


def _threads_of_blas(_number: int) -> int:
    return max((entry["num_threads"] for entry in threadpool_info() if entry["user_api"] == "blas"), default=1)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell")
def test_their_memory_is_told() -> None:
    assert workers_peak_mb() == 0.0
    with worker_processes((), count=2):
        list(shared_out(refuse, (3, 4)))
        assert 20.0 < workers_peak_mb() < 2000.0


def test_a_program_that_is_no_interpreter_works_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/opt/qgis/bin/qgis")
    monkeypatch.setattr(subprocess, "Popen", None)
    with worker_processes((), count=2):
        assert list(shared_out(refuse, (3, 4))) == [3, 4]


def test_where_no_process_can_be_started_it_is_done_here(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_more(*_: object, **__: object) -> None:
        raise BlockingIOError

    monkeypatch.setattr(subprocess, "Popen", no_more)
    with worker_processes((), count=2):
        assert {process for _, process in shared_out(number_and_process, range(3))} == {os.getpid()}


def test_a_script_without_a_guarded_main_part_is_run_once(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "print('begun')\n"
        "import math\n"
        "from fsinfer.processes import shared_out, worker_processes\n"
        "with worker_processes(('math',), count=2):\n"
        "    print(list(shared_out(math.factorial, range(5))))\n",
        encoding="utf-8",
    )
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=PATIENCE_S, check=True)
    assert done.stdout.splitlines() == ["begun", "[1, 1, 2, 6, 24]"]
    assert done.stderr == ""


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_processes_end_with_the_one_that_started_them(tmp_path: Path, number: signal.Signals) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import os, time\n"
        "from fsinfer.processes import shared_out, worker_processes\n"
        "with worker_processes((), count=2):\n"
        '    print(*set(shared_out(eval, [\'(__import__("time").sleep(0.2), __import__("os").getpid())[1]\'] * 4)))\n'
        "    print('ready', flush=True)\n"
        "    list(shared_out(time.sleep, [60.0, 60.0]))\n",
        encoding="utf-8",
    )
    parent = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert parent.stdout is not None
    with parent.stdout:
        children = [int(word) for word in parent.stdout.readline().split()]
        assert parent.stdout.readline() == "ready\n"
        assert len(children) == 2
        time.sleep(0.5)
        parent.send_signal(number)
        parent.wait(PATIENCE_S)
    until = time.monotonic() + PATIENCE_S
    while any(is_there(child) for child in children) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(is_there(child) for child in children)


def test_trees_are_the_same_in_processes(answered: Counter[str]) -> None:
    points = stem_plot(trees=4, seed=8, slope=0.1, lean_deg=4.0).points
    before = analyse_plot(points)
    curves = stem_curves(points, before)
    assert not answered
    with worker_processes(("fsinfer.trees.stem_curve",), count=2):
        after = analyse_plot(points)
        assert stem_curves(points, after) == curves
    assert after.trees == before.trees
    assert len(before.trees) == 4
    assert answered == {"_sections": 1, "_curves_of": 1}


def test_what_the_trees_need_can_be_loaded(answered: Counter[str]) -> None:
    with tree_workers(10**6, threads=2):
        assert list(shared_out(refuse, (3, 4))) == [3, 4]
        assert answered == {"refuse": 2}
    with tree_workers(10**6, threads=1):
        assert list(shared_out(refuse, (3, 4))) == [3, 4]
    with tree_workers(1000):
        assert list(shared_out(refuse, (3, 4))) == [3, 4]
    assert answered == {"refuse": 2}


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell")
def test_their_memory_counts_when_they_have_ended() -> None:
    peak = MemoryPeak()
    with tree_workers(10**6, threads=2):
        list(shared_out(refuse, (3, 4)))
        there = peak.read_mb()
        of_workers = workers_peak_mb()
    after = peak.read_mb()
    assert there is not None
    assert after is not None
    assert of_workers > 100.0
    # This process itself holds as much when they end as at its peak, but for a little.
    assert after >= 0.95 * there
    assert after - MemoryPeak().read_mb() > 0.8 * of_workers  # type: ignore[operator]


def test_who_cannot_load_what_is_needed_leaves_the_work_to_the_run(
    answered: Counter[str], caplog: pytest.LogCaptureFixture
) -> None:
    with worker_processes(("fsinfer.silhouettes.jion",), count=2):
        assert {process for _, process in shared_out(number_and_process, range(4))} == {os.getpid()}
    assert not answered
    assert len(caplog.messages) == 2
    assert "cannot load fsinfer.silhouettes.jion" in caplog.messages[0]


def test_who_cannot_read_the_work_leaves_it_to_the_run(
    answered: Counter[str], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A module that is there for this process alone.
    here = ModuleType("only_here")
    here.__dict__["work"] = number_and_process
    monkeypatch.setitem(sys.modules, "only_here", here)
    monkeypatch.setattr(number_and_process, "__module__", "only_here")
    monkeypatch.setattr(number_and_process, "__qualname__", "work")
    with worker_processes((), count=2):
        assert {process for _, process in shared_out(number_and_process, range(4))} == {os.getpid()}
    assert not answered
    assert "cannot read what it is told" in caplog.messages[0]


def test_a_search_path_may_hold_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path("somewhere"))
    with worker_processes((), count=2):
        assert os.getpid() not in {process for _, process in shared_out(number_and_process, range(4))}

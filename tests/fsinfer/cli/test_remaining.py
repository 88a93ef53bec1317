"""The remaining time, held against recorded runs replayed on a clock of our own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from fsinfer.cli.remaining import STEPS, RemainingTime, Step, as_words
from tests.bench.results import read_result
from tests.bench.steps import figure_of

#: Runs whose seconds of each step a benchmark wrote down: quick machines and a slow one that others share, thin stems
#: and thick ones, 120 to 300 photographs, some of 12 megapixels. None beside a program that ended halfway: nobody can
#: tell that beforehand.
RECORDED = (
    "plot-300-955057-processes",
    "plot-300-955048",
    "plot-clean-900111",
    "plot-300-avx2",
    "plot-300-955055",
    "plot-300-955057",
    "plot-300-955057-large",
    "plot-phone-955052",
)


#: The same photographs on the same machine before trees and report were shared out over processes, and since.
BEFORE, SINCE = "plot-300-955057", "plot-300-955057-processes"
SHARED_OUT = ("trees", "report")


def quicker_since(steps: list[Step]) -> float:
    """What some steps take since they are shared out over what they took before, the machine's pace (depth) aside."""
    before, since = read_result(BEFORE).figures, read_result(SINCE).figures
    taken = [sum(figures.get(figure_of(step), 0.0) for step in steps) for figures in (before, since)]
    return taken[1] / taken[0] * before["step_depth_s"] / since["step_depth_s"]


def steps_of(name: str) -> list[tuple[str, str, float]]:
    """Stage, step and seconds of a recorded run, in order.

    Older files have the trees as a whole, shared out here; of all but the newest trees and report are made as quick as
    they are since.
    """
    figures = read_result(name).figures
    photos = int(figures["photos"])
    trees = [step for step in STEPS if step.stage == "trees"]
    found = []
    for step in STEPS:
        seconds = figures.get(figure_of(step))
        if seconds is None and "step_trees_s" not in figures:
            # Recorded before stem curves told how far they are: what they took is that of the step before.
            assert step.what == "measuring stem curves"
            continue
        if seconds is None:
            assert step.stage == "trees"
            share = step.cost(photos) / sum(other.cost(photos) for other in trees)
            seconds = figures["step_trees_s"] * quicker_since(trees) * share
        elif name != SINCE and step.stage in SHARED_OUT:
            seconds *= quicker_since([step])
        found.append((step.stage, step.what or step.stage, seconds))
    return found


def seconds_of(name: str, stage: str) -> float:
    return sum(seconds for of, _, seconds in steps_of(name) if of == stage)


class Clock:
    """Seconds that pass when told to."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def _replay(run: str, clock: Clock, remaining: RemainingTime, speed: float) -> Iterator[float]:
    """Feed the run to ``remaining``; yields the seconds really left at each report."""
    photos = int(read_result(run).figures["photos"])
    steps = [(stage, what, seconds * speed) for stage, what, seconds in steps_of(run)]
    end = clock.now + sum(seconds for _, _, seconds in steps)
    for stage, what, seconds in steps:
        total = 18 * photos if what == "matching photos" else photos
        for done in range(0, total + 1, max(1, total // 40)):
            remaining.update(stage, done, total, what)
            yield end - clock.now
            clock.now += seconds / len(range(0, total + 1, max(1, total // 40)))


@pytest.mark.parametrize("run", RECORDED)
@pytest.mark.parametrize("speed", [0.4, 1.0, 3.0])
def test_after_the_first_tenth_it_is_right_within_30_percent(run: str, speed: float) -> None:
    clock = Clock()
    remaining = RemainingTime(clock=clock)
    begin = clock.now
    checked = 0
    for left in _replay(run, clock, remaining, speed):
        whole = left + clock.now - begin
        # In the last tenth what is left is a few seconds, of which nobody asks a third.
        if 0.1 * whole <= clock.now - begin <= 0.9 * whole:
            told = remaining.seconds()
            assert told is not None
            assert abs(told / left - 1) < 0.3, (clock.now - begin, told, left)
            checked += 1
    assert checked > 50
    assert remaining.seconds() == pytest.approx(0.0, abs=0.01 * (clock.now - begin))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_photos_that_are_easy_or_hard_to_match_say_little_of_the_rest(factor: float) -> None:
    clock, photos = Clock(), 300
    remaining = RemainingTime(clock=clock)
    hard = ("matching photos", "following the walk", "placing photos", "adjusting")
    seconds = [photos * step.cost(photos) * (factor if step.what in hard else 1.0) for step in STEPS]
    whole, begin, checked = sum(seconds), clock.now, 0
    for step, taken in zip(STEPS, seconds, strict=True):
        for done in range(40):
            remaining.update(step.stage, done * photos // 40, photos, step.what or step.stage)
            passed = clock.now - begin
            if 0.1 * whole <= passed <= 0.9 * whole:
                assert remaining.seconds() == pytest.approx(whole - passed, rel=0.3), (step, done)
                checked += 1
            clock.now += taken / 40
    assert checked > 200


@pytest.mark.parametrize("quicker", [0.1, 8.0])
@pytest.mark.parametrize("there_before", [0.0, 0.5])
def test_depth_on_other_computers_has_a_pace_of_its_own(quicker: float, there_before: float) -> None:
    clock = Clock()
    remaining = RemainingTime(clock=clock, elsewhere=("depth",))
    name = RECORDED[1]
    photos = int(read_result(name).figures["photos"])
    for stage, what, seconds in steps_of(name):
        if stage in ("frames", "poses"):
            remaining.update(stage, 0, photos, what)
            clock.now += seconds
            remaining.update(stage, photos, photos, what)
    first = int(photos * there_before)
    for done in range(first):
        remaining.update("depth", done, photos, "depth of a view that is there")
        clock.now += 1e-4
    each = seconds_of(name, "depth") / photos / quicker
    after = sum(seconds_of(name, stage) for stage in ("fuse", "scale", "cloud", "trees", "report"))
    for done in range(first, photos):
        remaining.update("depth", done, photos, "depth of a view")
        if done > first + 5:
            assert remaining.seconds() == pytest.approx(after + (photos - done) * each, rel=0.3)
        clock.now += each
    remaining.update("depth", photos, photos, "depth")
    assert remaining.seconds() == pytest.approx(after, rel=0.3)
    remaining.update("fuse", 0, photos, "fuse")
    clock.now += seconds_of(name, "fuse")
    remaining.update("fuse", photos, photos, "fuse")
    assert remaining.seconds() == pytest.approx(after - seconds_of(name, "fuse"), rel=0.3)


def test_steps_done_in_an_earlier_run_do_not_count() -> None:
    clock = Clock()
    remaining = RemainingTime(clock=clock)
    for done in range(51):
        remaining.update("depth", done, 100, f"depth of {done}")
        clock.now += 1.0
    # Half of depth took 51 s; as much again, and nearly as much as depth in all for what follows, is left.
    left = remaining.seconds()
    assert left is not None
    assert 100 < left < 150


def test_a_run_that_goes_on_at_its_costs_is_told_to_the_second_however_often_it_is_asked() -> None:
    clock, photos = Clock(), 100
    remaining = RemainingTime(clock=clock)
    first = next(i for i, step in enumerate(STEPS) if step.stage == "depth")
    each = STEPS[first].cost(photos)
    for done in range(51):
        remaining.update("depth", done, photos, f"depth of {done}")
        clock.now += each
    # The photo at work counts once it is done: its seconds are spent, and still told as left.
    after = photos * sum(step.cost(photos) for step in STEPS[first + 1 :])
    expected = 51 / 50 * (50 * each + after)
    assert [remaining.seconds() for _ in range(3)] == pytest.approx([expected] * 3, rel=1e-9)


def test_what_a_stopped_stage_had_done_does_not_make_it_look_fast() -> None:
    clock = Clock()
    remaining = RemainingTime(clock=clock)
    # Sixty of a hundred depth maps are there already, and are looked at quickly.
    for done in range(61):
        remaining.update("depth", done, 100, f"depth of {done}")
        clock.now += 0.01
    for done in range(60, 81):
        remaining.update("depth", done, 100, f"depth of {done}")
        clock.now += 2.0
    left = remaining.seconds()
    assert left is not None
    # Twenty maps at 2 s, and what follows in proportion.
    assert 40 < left < 130


def test_nothing_is_told_before_there_is_anything_to_tell_it_from() -> None:
    clock = Clock()
    remaining = RemainingTime(clock=clock)
    assert remaining.seconds() is None
    remaining.update("frames", 0, 100, "judging photos")
    clock.now += 1
    assert remaining.seconds() is None
    remaining.update("unheard of", 5, 10, "anything")
    assert remaining.seconds() is None


@pytest.mark.parametrize(("seconds", "words"), [(2, "5 s"), (41, "40 s"), (700, "12 min"), (6600, "1 h 50 min")])
def test_words(seconds: float, words: str) -> None:
    assert as_words(seconds) == words

"""The remaining time, held against recorded runs replayed on a clock of our own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from fsinfer.cli.remaining import RemainingTime, as_words

# Seconds of the stages of whole runs on the first photographs of a rendered plot (python -m tests.bench.plot_speed),
# and how poses split on 300 of them (python -m tests.bench.check PLOT OUT --keep 0-1, which prints the steps).
RUNS: dict[int, dict[str, float]] = {
    100: {
        "frames": 1.2, "poses": 110.8, "depth": 149.0, "fuse": 27.1, "scale": 3.2, "cloud": 4.9, "trees": 16.3,
        "report": 6.1,
    },
    300: {
        "frames": 3.8, "poses": 391.1, "depth": 478.0, "fuse": 79.8, "scale": 9.0, "cloud": 6.1, "trees": 29.4,
        "report": 8.8,
    },
}  # fmt: skip
POSES = {
    "reading photos": 0.005,
    "finding features": 0.105,
    "matching photos": 0.445,
    "placing photos": 0.215,
    "adjusting": 0.19,
    "undistorting": 0.04,
}


class Clock:
    """Seconds that pass when told to."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def _replay(photos: int, clock: Clock, remaining: RemainingTime, speed: float) -> Iterator[float]:
    """Feed the run to ``remaining``; yields the seconds really left at each report."""
    steps: list[tuple[str, str, float]] = []
    for stage, seconds in RUNS[photos].items():
        if stage == "poses":
            steps += [(stage, what, share * seconds * speed) for what, share in POSES.items()]
        else:
            steps.append((stage, stage, seconds * speed))
    end = clock.now + sum(seconds for _, _, seconds in steps)
    for stage, what, seconds in steps:
        total = 18 * photos if what == "matching photos" else photos
        for done in range(0, total + 1, max(1, total // 40)):
            remaining.update(stage, done, total, what)
            yield end - clock.now
            clock.now += seconds / len(range(0, total + 1, max(1, total // 40)))


@pytest.mark.parametrize("photos", RUNS)
@pytest.mark.parametrize("speed", [0.4, 1.0, 3.0])
def test_after_the_first_tenth_it_is_right_within_30_percent(photos: int, speed: float) -> None:
    clock = Clock()
    remaining = RemainingTime(clock=clock)
    begin = clock.now
    checked = 0
    for left in _replay(photos, clock, remaining, speed):
        whole = left + clock.now - begin
        # In the last tenth what is left is a few seconds, of which nobody asks a third.
        if 0.1 * whole <= clock.now - begin <= 0.9 * whole:
            told = remaining.seconds()
            assert told is not None
            assert abs(told / left - 1) < 0.3, (clock.now - begin, told, left)
            checked += 1
    assert checked > 50
    assert remaining.seconds() == pytest.approx(0.0, abs=0.01 * (clock.now - begin))


@pytest.mark.parametrize("quicker", [0.1, 8.0])
@pytest.mark.parametrize("there_before", [0.0, 0.5])
def test_depth_on_other_computers_has_a_pace_of_its_own(quicker: float, there_before: float) -> None:
    clock = Clock()
    remaining = RemainingTime(clock=clock, elsewhere=("depth",))
    run, photos = RUNS[100], 100
    for stage in ("frames", "poses"):
        for what, share in POSES.items() if stage == "poses" else (("", 1.0),):
            remaining.update(stage, 0, photos, what)
            clock.now += share * run[stage]
            remaining.update(stage, photos, photos, what)
    first = int(photos * there_before)
    for done in range(first):
        remaining.update("depth", done, photos, "depth of a view that is there")
        clock.now += 1e-4
    each = run["depth"] / photos / quicker
    after = sum(run[stage] for stage in ("fuse", "scale", "cloud", "trees", "report"))
    for done in range(first, photos):
        remaining.update("depth", done, photos, "depth of a view")
        if done > first + 5:
            assert remaining.seconds() == pytest.approx(after + (photos - done) * each, rel=0.3)
        clock.now += each
    remaining.update("depth", photos, photos, "depth")
    assert remaining.seconds() == pytest.approx(after, rel=0.3)
    remaining.update("fuse", 0, photos, "fuse")
    clock.now += run["fuse"]
    remaining.update("fuse", photos, photos, "fuse")
    assert remaining.seconds() == pytest.approx(after - run["fuse"], rel=0.3)


def test_steps_done_in_an_earlier_run_do_not_count() -> None:
    clock = Clock()
    remaining = RemainingTime(clock=clock)
    for done in range(51):
        remaining.update("depth", done, 100, f"depth of {done}")
        clock.now += 1.0
    # Half of depth took 51 s; as much again, and a little for what follows, is left.
    left = remaining.seconds()
    assert left is not None
    assert 50 < left < 110


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

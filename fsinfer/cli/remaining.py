"""How long a run will still take, from the progress of its stages and what each step costs beside the others.

Each step has a cost for each photo. What the steps done so far took, over what they should cost, is the speed of the
machine on these photos; the cost of what is left, at this speed, is the remaining time. What reading photos takes goes
by how large they are, and what matching and placing them takes by what is on them, more than by the machine: it tells
less of the rest. Steps that were done in an earlier run report nothing and count for nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import lru_cache


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of a stage; ``what`` is how its progress begins ("" takes all of the stage's progress).

    ``weight``: how much the time that it takes tells of the speed at which the others will go.
    """

    stage: str
    what: str
    cost: Callable[[int], float]
    weight: float = 1.0


#: Photos among which costs that grow hold, and the power of the photos with which they do. Source: layout; measured, 50
#: to 300 photos of rendered plots; renders only.
_AMONG_PHOTOS, _GROWTH = 300, 0.4
#: Seconds up to which seconds are told, in steps of so many. Source: layout.
_SHORT_S, _STEP_S = 90, 5


def _each(cost: float) -> Callable[[int], float]:
    return lambda _photos: cost


def _growing(cost: float) -> Callable[[int], float]:
    """Cost among ``_AMONG_PHOTOS`` photos; where there are more, each takes a little longer."""
    return lambda photos: cost * (photos / _AMONG_PHOTOS) ** _GROWTH


def _besides(once: float, cost: Callable[[int], float]) -> Callable[[int], float]:
    """Cost of each photo besides what is paid once."""
    return lambda photos: cost(photos) + once / photos


@lru_cache
def _pairs_per_photo(photos: int) -> float:
    from fsinfer.poses.pairs import PairSettings, most_pairs

    return most_pairs(photos, PairSettings()) / photos


#: Weight of steps that take by the photos what they take. Source: layout; measured, the runs below.
_BY_PHOTOS = 0.1
#: For each photo of 1280x720, about seconds on two cores; their proportions matter. Source: layout; measured, the runs
#: that tests/fsinfer/cli/test_remaining.py replays.
STEPS = (
    Step(stage="frames", what="", cost=_each(0.01), weight=_BY_PHOTOS),
    Step(stage="poses", what="reading photos", cost=_each(0.015), weight=_BY_PHOTOS),
    Step(stage="poses", what="finding features", cost=_each(0.11)),
    Step(stage="poses", what="matching photos", cost=lambda n: 0.008 * _pairs_per_photo(n), weight=_BY_PHOTOS),
    Step(stage="poses", what="following the walk", cost=_growing(0.03), weight=_BY_PHOTOS),
    Step(stage="poses", what="placing photos", cost=_growing(0.08), weight=_BY_PHOTOS),
    Step(stage="poses", what="adjusting", cost=_growing(0.11), weight=_BY_PHOTOS),
    Step(stage="poses", what="undistorting", cost=_each(0.04)),
    Step(stage="depth", what="", cost=_each(0.40)),
    Step(stage="fuse", what="", cost=_each(0.105)),
    Step(stage="scale", what="", cost=_each(0.022)),
    Step(stage="cloud", what="", cost=_besides(0.6, _each(0.018))),
    Step(stage="trees", what="finding the ground", cost=_each(0.01)),
    Step(stage="trees", what="looking for stems", cost=_each(0.009)),
    Step(stage="trees", what="measuring stems", cost=_each(0.006)),
    Step(stage="trees", what="edges of stems", cost=_each(0.015)),
    Step(stage="trees", what="looking again", cost=_each(0.037)),
    Step(stage="trees", what="measuring stem curves", cost=_each(0.006)),
    Step(stage="trees", what="drawing sections", cost=_besides(0.7, _each(0.022))),
    Step(stage="trees", what="writing trees", cost=_each(0.008)),
    Step(stage="report", what="", cost=_besides(1.0, _each(0.022))),
)
#: What goes so many times faster than on the machine of the costs, which are about seconds there, was there already.
#: Source: layout; judgement; no machine is so much faster.
_SKIPPED = 50.0
#: Before this share of the cost is done an estimate would be a guess. Source: layout; judgement.
_LEAST_SHARE = 0.02


def step_of(stage: str, what: str) -> int | None:
    """Place in :data:`STEPS` of the step that a report of a stage's progress is of; None of what is no known step."""
    return next((i for i, step in enumerate(STEPS) if step.stage == stage and what.startswith(step.what)), None)


class RemainingTime:
    """Takes the progress of all stages of a run; :meth:`seconds` is what is left.

    Parameters
    ----------
    photos: how many, if known; else learnt from the first step that counts photos.
    clock: seconds, rising.
    elsewhere: stages that other computers do: what they take tells of no other stage, and the reverse.
    """

    def __init__(
        self, *, photos: int = 0, clock: Callable[[], float] = time.monotonic, elsewhere: Collection[str] = ()
    ) -> None:
        self._photos = photos
        self._clock = clock
        self._elsewhere = frozenset(i for i, step in enumerate(STEPS) if step.stage in elsewhere)
        # Of the step at hand: when it had counted what was there before, and how far it was then.
        self._began = (clock(), 0.0)
        self._at = -1
        self._part = 0.0
        self._reported = clock()
        # Of each step: seconds that it took up to the last report, and the part of it that was there before.
        self._took: dict[int, float] = {}
        self._there_before: dict[int, float] = {}

    def update(self, stage: str, done: int, total: int, what: str) -> None:
        """Take one report of a stage's progress callback; steps that are not known are passed over."""
        found = step_of(stage, what)
        if found is None or total <= 0 or found < self._at:
            return
        now = self._clock()
        # What passed since the last report belongs to the step that it was of; before the first there was none.
        reported = found if self._at < 0 else self._at
        self._took[reported] = self._took.get(reported, 0.0) + now - self._reported
        if found != self._at:
            # The stage itself, or an earlier step of it, told how many photos there are.
            self._at = found
            self._part = 0.0
            self._began = (now, 0.0)
            self._took.setdefault(found, 0.0)
        if what in ("reading photos", "finding features", "following the walk", "placing photos") or stage == "depth":
            self._photos = total
        before, self._part = self._part, max(self._part, min(1.0, done / total))
        photos = max(2, self._photos)
        gained = self._part - before
        if gained * STEPS[self._at].cost(photos) * photos > _SKIPPED * (now - self._reported):
            # A stage that goes on after a stop counts quickly through what it did before.
            self._there_before[self._at] = self._there_before.get(self._at, 0.0) + gained
            self._began = (now, self._part)
        self._reported = now

    def seconds(self) -> float | None:
        """Seconds left of the whole run, or None as long as nothing can be said."""
        if self._at < 0:
            return None
        photos = max(2, self._photos)
        # What other computers have done says nothing of this one.
        costs = [0.0 if i in self._elsewhere and i <= self._at else s.cost(photos) for i, s in enumerate(STEPS)]
        left = (1 - self._part) * costs[self._at] + sum(costs[self._at + 1 :])
        now = self._clock()
        there = 0.0
        if self._at in self._elsewhere and self._part < 1:
            since, part = self._began
            if self._part - part < _LEAST_SHARE * (1 - part):
                return None
            there = (now - since) * (1 - self._part) / (self._part - part)
        done = {
            i: costs[i] * ((self._part if i == self._at else 1.0) - self._there_before.get(i, 0.0)) for i in self._took
        }
        if sum(done.values()) >= _LEAST_SHARE * (sum(done.values()) + left):
            took = self._took | {self._at: self._took[self._at] + now - self._reported}
            told = sum(STEPS[i].weight * cost for i, cost in done.items())
            spent = sum(STEPS[i].weight * seconds for i, seconds in took.items() if i not in self._elsewhere)
            return there + spent * left / told
        # With all before done in an earlier run, the costs themselves are the best guess.
        return there + photos * left if there else None


def as_words(seconds: float) -> str:
    """Write "40 s", "12 min", "1 h 50 min"; no finer than the estimate deserves."""
    if seconds < _SHORT_S:
        return f"{max(_STEP_S, _STEP_S * round(seconds / _STEP_S))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"

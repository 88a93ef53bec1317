"""Which unknowns of each photo's own the photos bear out: those that predict points which the fit did not see.

Each group is tried on top of those that are kept already, and once more when all are known. A point held out is placed
anew by all photos that see it, under the model with the group and under the one without; both place it with three
numbers, so what is left of its observations tells which cameras are nearer to the truth. An unknown that only follows
the noise predicts worse.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.adjustment.fit import Weighting, fit, noise_of, with_points_fitted
from fsinfer.poses.adjustment.problem import Group, Ints, Observations, Unknowns
from fsinfer.poses.adjustment.projection import Floats
from fsinfer.poses.adjustment.reduced_system import Structure
from fsinfer.poses.adjustment.settings import AdjustmentSettings

_log = logging.getLogger(__name__)

#: The order in which groups are tried, the usually greatest first.
ORDER = (Group.turn, Group.focal, Group.drift, Group.principal)
#: Photos that must see a point that is held out. Source: two always agree in one direction.
_MIN_PHOTOS = 3
#: Standard deviations of an observation, before any effect is known, beyond which a larger error hardly counts as more.
#: Source: three sigma.
_JUDGED_TO = 3.0
#: A fit that only decides ends where a step gains less than this share of its cost, or the next would gain less than
#: that. Source: numerics; what a group does to points held out was the same to 0.1 % with 0.0001 for the first alone,
#: in one and a half times the time; renders only.
_ENOUGH, _FORESEEN = 1e-3, 2.5e-4


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What a group did to points held out.

    Attributes
    ----------
    group: tried on top of those kept before it, and once more beside all that were kept.
    gain: share by which their mean robust error (pixels^2) fell; below zero it rose.
    surety: that fall over its standard error, each point counted once.
    kept: whether it stays.
    """

    group: Group
    gain: float
    surety: float
    kept: bool


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """What was found.

    Attributes
    ----------
    groups: those to keep. trials: every one. weighting: with the noise that is left.
    cameras: poses, lenses and each photo's own as they were fitted with ``groups``, with the points given at first.
    """

    groups: tuple[Group, ...]
    trials: tuple[Trial, ...]
    weighting: Weighting
    cameras: Unknowns


@dataclass(frozen=True, kw_only=True)
class _Judge:
    """The points held out: their observations, and where they stood at first (P, 3)."""

    seen: Observations
    points: Floats
    loss_px: float
    noise_px: float

    def errors_of(self, cameras: Unknowns) -> Floats:
        """(P,) robust squared errors, pixels^2, of the points placed anew by these cameras."""
        bound = (_JUDGED_TO * self.noise_px) ** 2
        placed = with_points_fitted(self.seen, replace(cameras, points=self.points), self.loss_px)
        squared = (placed.residuals(self.seen) ** 2).sum(1)
        # Geman and McClure: a wrong match counts as a bound, whatever the cameras are, and hides nothing.
        return np.asarray(np.bincount(self.seen.point, squared / (1 + squared / bound), len(self.points)))


@dataclass(frozen=True, kw_only=True)
class InTurn:
    """The groups as each was tried on top of those before it, and what is needed to try them once more.

    ``current`` was fitted with the groups ``kept``; ``errors`` (P,) are what it does to the points held out, and
    ``points`` (Q, 3) all that were given at first.
    """

    structure: Structure
    judge: _Judge
    points: Floats
    kept: tuple[Group, ...]
    trials: Mapping[Group, Trial]
    weighting: Weighting
    current: Unknowns
    errors: Floats

    @property
    def evidence(self) -> Evidence:
        """What is borne out, should no group go when it is tried once more."""
        cameras = replace(self.current, points=self.points)
        return Evidence(groups=self.kept, trials=tuple(self.trials.values()), weighting=self.weighting, cameras=cameras)

    def without(self, group: Group) -> tuple[Unknowns, Floats]:
        """Fitted with the other groups alone, and what that does to the points held out."""
        others = [other for other in self.kept if other is not group]
        own = self.current.own.copy()
        own[:, group.value] = 0
        start = replace(self.current, own=own)
        tried = fit(self.structure, start, others, self.weighting, enough=_ENOUGH, foreseen=_FORESEEN)
        return tried, self.judge.errors_of(tried)


def tried_in_turn(
    seen: Observations, start: Unknowns, weighting: Weighting, settings: AdjustmentSettings
) -> InTurn | None:
    """Try each group on top of those that were kept before it; None where there is no point to hold out."""
    held, fitted = split(seen, len(start.points), settings)
    judged, judged_points = seen.of_points(held)
    learned, learned_points = seen.of_points(fitted)
    if len(judged_points) == 0:
        return None
    structure = Structure(learned, len(learned_points))
    first = replace(start, points=start.points[learned_points])
    current = fit(structure, first, (), weighting, enough=_ENOUGH, foreseen=_FORESEEN)
    weighting = replace(weighting, noise_px=noise_of(current.residuals(learned)))
    judge = _Judge(
        seen=judged, points=start.points[judged_points], loss_px=weighting.loss_px, noise_px=weighting.noise_px
    )
    errors = judge.errors_of(current)
    kept: list[Group] = []
    trials: dict[Group, Trial] = {}
    for group in ORDER:
        tried = fit(structure, current, (*kept, group), weighting, enough=_ENOUGH, foreseen=_FORESEEN)
        there = judge.errors_of(tried)
        trials[group] = _trial(group, errors, there, settings.min_gain, settings)
        if trials[group].kept:
            kept, current, errors = [*kept, group], tried, there
            weighting = replace(weighting, noise_px=noise_of(current.residuals(learned)))
    return InTurn(
        structure=structure,
        judge=judge,
        points=start.points,
        kept=tuple(kept),
        trials=trials,
        weighting=weighting,
        current=current,
        errors=errors,
    )


def confirmed(found: InTurn, settings: AdjustmentSettings) -> Evidence:
    """Each group but the last is tried once more beside all others: it may only have stood for what came after it."""
    now, trials = found, dict(found.trials)
    for group in found.kept[:-1]:
        tried, there = now.without(group)
        trials[group] = _trial(group, there, now.errors, settings.min_gain_beside, settings)
        if not trials[group].kept:
            others = tuple(other for other in now.kept if other is not group)
            now = replace(now, kept=others, current=tried, errors=there)
    return replace(now, trials=trials).evidence


def _trial(group: Group, without: Floats, with_it: Floats, least: float, settings: AdjustmentSettings) -> Trial:
    """From the (P,) errors of the points held out without and with a group."""
    fall = without - with_it
    gain = float(fall.sum() / max(without.sum(), np.finfo(float).tiny))
    spread = float(fall.std() * np.sqrt(len(fall)))
    surety = float(fall.sum()) / spread if spread > 0 else 0.0
    _log.info("%s: held-out error falls by %.1f %% (%.1f standard errors)", group.name, 100 * gain, surety)
    keep = gain >= least and surety >= settings.min_surety
    return Trial(group=group, gain=gain, surety=surety, kept=keep)


def split(seen: Observations, points: int, settings: AdjustmentSettings) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(P,) masks of the points to be held out, and of those to fit: the longest tracks, as many as each photo needs."""
    lengths = np.bincount(seen.point, minlength=points)
    rank = np.cumsum(lengths >= _MIN_PHOTOS)
    held = (lengths >= _MIN_PHOTOS) & (rank % settings.held_out == 0)
    fitted = np.zeros(points, dtype=bool)
    order = np.argsort(seen.point, kind="stable")
    photos: Ints = seen.photo[order]
    ends = np.cumsum(lengths)
    filled = np.zeros(len(seen.camera), dtype=np.int64)
    for point in np.argsort(-lengths, kind="stable"):
        if held[point] or lengths[point] < 2:
            continue
        track = photos[ends[point] - lengths[point] : ends[point]]
        if (filled[track] < settings.decide_with).any():
            fitted[point] = True
            filled[track] += 1
    return held, fitted

"""Which unknowns of each photo's own the photos bear out: those that predict points which the fit did not see.

Each group is tried on top of those that are kept already. A point held out is placed anew by all photos that see it,
under the model with the group and under the one without; both place it with three numbers, so what is left of its
observations tells which cameras are nearer to the truth. An unknown that only follows the noise predicts worse.
"""

from __future__ import annotations

import logging
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


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What a group did to points held out.

    Attributes
    ----------
    group: tried on top of those kept before it.
    gain: share by which their mean robust error (pixels^2) fell; below zero it rose.
    surety: that fall over its standard error, each point counted once.
    kept: whether it stays.
    """

    group: Group
    gain: float
    surety: float
    kept: bool


def groups_borne_out(
    seen: Observations, start: Unknowns, weighting: Weighting, settings: AdjustmentSettings
) -> tuple[tuple[Group, ...], tuple[Trial, ...], Weighting]:
    """Try each group; returns those to keep, every trial, and the weighting with the noise that is left."""
    held, fitted = split(seen, len(start.points), settings)
    judged, judged_points = seen.of_points(held)
    learned, learned_points = seen.of_points(fitted)
    if len(judged_points) == 0:
        return (), (), weighting
    structure = Structure(learned, len(learned_points))
    current = fit(structure, replace(start, points=start.points[learned_points]), (), weighting)
    weighting = replace(weighting, noise_px=noise_of(current.residuals(learned)))
    errors = _errors(judged, replace(current, points=start.points[judged_points]), weighting)
    kept: tuple[Group, ...] = ()
    trials = []
    for group in ORDER:
        tried = fit(structure, current, (*kept, group), weighting)
        there = _errors(judged, replace(tried, points=start.points[judged_points]), weighting)
        fall = errors - there
        gain = float(fall.sum() / errors.sum())
        spread = float(fall.std() * np.sqrt(len(fall)))
        surety = float(fall.sum()) / spread if spread > 0 else 0.0
        keep = gain >= settings.min_gain and surety >= settings.min_surety
        trials.append(Trial(group=group, gain=gain, surety=surety, kept=keep))
        _log.info("%s: held-out error falls by %.1f %% (%.1f standard errors)", group.name, 100 * gain, surety)
        if keep:
            kept, current, errors = (*kept, group), tried, there
            weighting = replace(weighting, noise_px=noise_of(current.residuals(learned)))
    return kept, tuple(trials), weighting


def _errors(judged: Observations, cameras: Unknowns, weighting: Weighting) -> Floats:
    """(P,) robust error of each point, placed anew."""
    placed = with_points_fitted(judged, cameras, weighting.loss_px)
    losses = weighting.losses(placed.residuals(judged))
    return np.asarray(np.bincount(judged.point, losses, len(cameras.points)))


def split(
    seen: Observations, points: int, settings: AdjustmentSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
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

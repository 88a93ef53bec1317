"""Stems of a plot that are all cut in halves in the same way: two parts of the cloud that do not fit together.

A single stem cannot tell halves that lie apart from a shape of its own, and its interval is too narrow then. A plot
can: the shift is one for all stems, in metres and in its direction, whatever their radii, while stems that grew are out
of round each its own way and in proportion to the radius. How well one shift explains all sections is compared with the
best that stems without one can do (:mod:`fsinfer.trees.diameter.two_halves`), be they several times as far from round
as usual.

The ratio of both is at most 1 in the mean over plots without a shift, so that it comes out above 1,000 on less than one
of 1,000 of them (Markov's inequality; such ratios are the e-values of Gruenwald, de Heide & Koolen 2024, JRSS B 86,
1091). A stem counts for a bounded part of it, which only lowers the ratio: one with an odd section proves nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.two_halves import HalvesEvidence, HalvesSettings, directions_rad, log_prior

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CommonShiftSettings:
    """Constants of :func:`find_shift`, and of what follows from it (:mod:`fsinfer.trees.torn`).

    Attributes
    ----------
    min_stems: that show enough of their sides; fewer may look alike by chance. Source: judgement, with the next.
    least_odds: how many times better one shift explains the sections than none, in the mean over sizes and directions.
        Source: statistics, less than 0.1 % of plots without a shift (Markov's inequality).
    most_of_one: greatest logarithm of what one stem adds to that. Source: judgement, below that of ``least_odds``, so
        that no stem decides alone.
    part_factor: what a shift does to a diameter, times what is found of it. Source: simulated walks that are torn,
        seeds 43000-43011 of both kinds: where both parts see a side the bark lies between, and a shift comes out a
        fifth too small.
    halves: of each stem.
    """

    min_stems: int = 6
    least_odds: float = 1000.0
    most_of_one: float = 5.0
    part_factor: float = 1.2
    halves: HalvesSettings = field(default_factory=HalvesSettings)


@dataclass(frozen=True, kw_only=True)
class Shift:
    """A shift of halves that all ``stems`` have: its mean size in metres and direction, and how likely which is.

    ``direction_rad`` counts counter-clockwise from x, in [0, pi). ``chance`` (S, D, P, C) sums up to one.
    """

    stems: int
    size_m: float
    direction_rad: float
    chance: Floats

    def radius_std(self, stem: HalvesEvidence) -> float:
        """Root of the mean square of what it does to the fitted radius of a stem, metres."""
        return float(np.sqrt((self.chance * stem.square_m2).sum()))


def find_shift(evidence: Sequence[HalvesEvidence], *, settings: CommonShiftSettings | None = None) -> Shift | None:
    """The shift that all stems have; None where there is none, or too few stems to tell."""
    s = settings or CommonShiftSettings()
    if len(evidence) < s.min_stems:
        return None
    whole = np.array([own.whole for own in evidence])
    shifted = np.array([own.shifted for own in evidence])
    before = log_prior(s.halves)
    # Whatever the shape of stems without a shift, it must do worse.
    odds = min(
        _log_mean(np.minimum(shifted - of_scale[:, None, None, None, None], s.most_of_one).sum(axis=0), before)
        for of_scale in whole.T
    )
    if odds < np.log(s.least_odds):
        return None
    total = shifted.sum(axis=0) + before
    chance = np.exp(total - total.max())
    chance /= chance.sum()
    # Opposite directions are one: the mean of the doubled angles.
    doubled = complex(chance.sum(axis=(0, 1, 3)) @ np.exp(2j * directions_rad()))
    return Shift(
        stems=len(evidence),
        size_m=float(chance.sum(axis=(0, 2, 3)) @ s.halves.sizes_m),
        direction_rad=float(0.5 * np.angle(doubled)) % np.pi,
        chance=chance,
    )


def _log_mean(values: Floats, log_weights: Floats) -> float:
    """Logarithm of the mean of exponentials, over all axes but the last alike and over that by its weights."""
    weighted = values + log_weights
    most = float(weighted.max())
    return most + float(np.log(np.exp(weighted - most).sum() * values.shape[-1] / values.size))

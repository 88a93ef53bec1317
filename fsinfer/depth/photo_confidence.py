"""How sure a depth is by the photographs: what the last sub-pixel step has seen there, beside the network's own word.

The network judges features at half of the resolution. At the full size it shows whether a source looks the same there,
whether a depth 1 % beside would look different at all, whether the step was still on its way, and how many sources
show the place. Each of these quantities has a curve, and the sum of the curves is the logit of the probability that the
depth is within 1 %: a generalised additive model (Hastie and Tibshirani, Statistical Science 1, 1986), which keeps the
network's confidence as one of its terms. ``python -m training.photo_confidence`` fits it.

That a source looks the same says little where every depth does: at baselines of a few per cent of the depth, on flat
surfaces. So the curves are fitted on scenes with such baselines too. How far the depth leaps about a pixel is left out:
it tells something, but all of a thin stem lies beside a leap (docs/trials-accuracy.md, "How sure a pixel is").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.blocks import over_blocks

Float32 = NDArray[np.float32]

#: A source shows the surroundings of a pixel where it shows this share of them. Source: judgement.
LEAST_SEEN = 0.5
#: Misfit where no source shows the place: more than that of any two signals. Source: definition.
NO_MISFIT = 9.0
#: Added before logarithms: far below what tells anything. Source: numerics.
LEAST_INFORMATION, LEAST_SHIFT, LEAST_MISFIT, LEAST_VARIANCE = 1e-6, 1e-3, 1e-3, 1e-2
#: What is looked at, in the order of the fit. ``network``: its confidence. ``sources``: how many show the place.
#: ``information``: logarithm of what the least squares know of a shift by 1 % of the depth. ``shift``: logarithm of the
#: last step, per cent of the depth. ``misfit``: logarithm of half the mean squared difference to the most alike source
#: over the variance.
QUANTITIES = ("network", "sources", "information", "shift", "misfit")
#: Rows whose probability is computed at a time. Source: numerics.
_ROWS = 32


@dataclass(frozen=True, kw_only=True)
class LastStep:
    """What the last sub-pixel step saw, (h, w) each.

    ``sources`` is how many show the place; ``misfit`` half the mean squared difference of the grey values to the most
    alike of them (1 less their correlation, of grey values of variance 1), ``variance`` that of the grey values;
    ``texture`` the mean information on a shift, 1/px^2 of grey values of variance 1; ``shift_px`` the step and
    ``px_per_percent`` what 1 % of the depth moves, in pixels of the source that moves fastest.
    """

    sources: Float32
    misfit: Float32
    variance: Float32
    texture: Float32
    shift_px: Float32
    px_per_percent: Float32


@dataclass(frozen=True, kw_only=True)
class ConfidenceCurves:
    """Of each of :data:`QUANTITIES`: rising places (K,) and what it adds to the logit there (K,); and a constant."""

    places: Mapping[str, Float32]
    values: Mapping[str, Float32]
    constant: float


def quantities(network: Float32, last: LastStep) -> dict[str, Float32]:
    """Maps (h, w) of :data:`QUANTITIES`; ``network`` (h, w) is its confidence."""
    moves = np.maximum(last.px_per_percent, np.float32(LEAST_SHIFT))
    return {
        "network": network,
        "sources": last.sources,
        "information": _log(np.maximum(last.texture, 0) * moves**2, LEAST_INFORMATION),
        "shift": _log(np.abs(last.shift_px) / moves, LEAST_SHIFT),
        "misfit": _log(last.misfit / (last.variance + np.float32(LEAST_VARIANCE)), LEAST_MISFIT),
    }


def _log(values: NDArray[np.floating], least: float) -> Float32:
    return np.asarray(cv2.log(np.asarray(values, np.float32) + np.float32(least)), np.float32)


def probability(found: Mapping[str, Float32], curves: ConfidenceCurves, *, threads: int = 1) -> Float32:
    """Probability (h, w) that a depth is within 1 % of the true one, of :func:`quantities`."""
    result = np.empty_like(found["network"])

    def fill(first: int) -> None:
        rows = slice(first, first + _ROWS)
        logit = np.full(result[rows].shape, curves.constant)
        for name in QUANTITIES:
            logit += np.interp(found[name][rows], curves.places[name], curves.values[name])
        result[rows] = 1 / (1 + np.exp(-logit))

    over_blocks(fill, len(result), _ROWS, threads)
    return result

"""Looking wider for a stem whose axis the cloud has beside the stem.

Depth maps know a stem that all photographs see from 10 m as a haze, whose axis may lie a radius beside the stem. Its
edges are out of reach there, and a fit takes the pair of other edges that agree best: of a stem of 13 cm one became
30 cm. So what the cloud refused, and whose edges agree as those of stems seldom do, is looked for in a wider strip
about the haze. Where the most edges agree there it is looked at anew, and where they agree better than before, that
look counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fsinfer.processes import shared_out
from fsinfer.silhouettes.one_look import Look, Looked, LookSettings, fitted_looks
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.trees.diameter.edge_problem import EdgeProblem
from fsinfer.trees.diameter.edge_set import Edges, chosen_edges, two_sided
from fsinfer.trees.diameter.silhouette import FAINT_CONTRAST
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class WideLookSettings:
    """Constants of :func:`look_wider`; lengths in metres.

    Attributes
    ----------
    sure_contrast: a stem that the cloud could not measure, and whose edges agree no better, is looked for wider, and
        stays doubtful where that finds none. Source: renders only, seed 955048, afterwards: edges beside the stem have
        1.21 to 1.28 (fitted as 19.6, 20.4 and 29.8 cm, 23.1, 23.1 and 12.6 in truth), its own 1.54 to 1.83; nine right
        ones of three plots 1.58 and more.
    reach_m: to either side of the haze's axis. Source: renders only, as before: stems stand 8 to 18 cm beside it.
    radius_range: of the haze's radius; the greatest is :attr:`SilhouetteSettings.beyond_m` more at least. Source:
        renders only, as before: 0.5 to 2.5 times.
    place_step_m, radius_step_m: of the vote. Source: numerics, its tolerance.
    """

    sure_contrast: float = FAINT_CONTRAST
    reach_m: float = 0.2
    radius_range: tuple[float, float] = (0.4, 1.5)
    place_step_m: float = 0.015
    radius_step_m: float = 0.006


def look_wider(
    stems: Sequence[StemAxis],
    looked: Sequence[Looked],
    look: Look,
    wide: Callable[[Sequence[StemAxis]], list[Edges]],
    *,
    fit: SilhouetteSettings,
    looks: LookSettings,
    settings: WideLookSettings,
    measured: Sequence[StemAxis] = (),
) -> list[Looked]:
    """Look wider about ``stems``, which the cloud refused; ``looked`` is what they showed there.

    ``wide`` finds edges as ``look`` does, in strips that reach :attr:`WideLookSettings.reach_m` farther. Where
    they are those of a neighbour that the cloud ``measured``, the look before stays.
    """
    best = list(looked)
    lost = [number for number, one in enumerate(looked) if _contrast(one, looks) < settings.sure_contrast]
    if not lost:
        return best
    axes = []
    asked_wide = [stems[number] for number in lost]
    seen_wide = zip(asked_wide, wide(asked_wide), strict=True)
    found = shared_out(partial(_beside, fit, settings), seen_wide)
    for number, beside in zip(lost, found, strict=True):
        # Where the most edges are a neighbour's, the other places are chance: a haze beside one was given 15 cm so.
        if beside and not any(_stands_in(beside[0][0], other) for other in measured):
            axes += [(number, axis, moved) for axis, moved in beside]
    if not axes:
        return best
    seen = zip(axes, *look([axis for _, axis, _ in axes]), strict=True)
    asked = [(axis, moved, edges, strips, None) for (_, axis, moved), edges, strips in seen]
    for (number, _, _), new in zip(axes, fitted_looks(asked, fit, looks), strict=True):
        if _contrast(new, looks) > _contrast(best[number], looks):
            best[number] = new
    return best


def _beside(
    fit: SilhouetteSettings, s: WideLookSettings, seen: tuple[StemAxis, Edges]
) -> list[tuple[StemAxis, Floats]]:
    return axes_beside(*seen, fit, s)


def axes_beside(
    stem: StemAxis, edges: Edges, fit: SilhouetteSettings, s: WideLookSettings
) -> list[tuple[StemAxis, Floats]]:
    """The axes about which the most rays of a wide strip about ``stem`` have an edge equally far away.

    Each with how far it is from ``stem``'s, (2,) metres along its directions across. ``edges`` are those of the strip.
    """
    edges = chosen_edges(edges, two_sided(edges))
    if len(np.unique(edges.ray)) < fit.min_edges:
        return []
    wide = replace(fit, place_range_m=s.reach_m, radius_range=s.radius_range)
    problem = EdgeProblem(edges, stem.radius_m, stem.taper, wide)
    peaks, _ = problem.vote(place_step_m=s.place_step_m, radius_step_m=s.radius_step_m)
    return [(stem.moved(peak[1:], peak[0]), peak[1:]) for peak in peaks]


def _stands_in(axis: StemAxis, other: StemAxis) -> bool:
    """Whether the axis passes through the other stem at breast height."""
    return float(np.linalg.norm((axis.breast - other.breast)[:2])) < other.radius_m


def _contrast(looked: Looked, s: LookSettings) -> float:
    """How well the edges of a look agree, 0 where it found no stem."""
    return looked.fit.contrast if looked.fit is not None and looked.clear(s) else 0.0

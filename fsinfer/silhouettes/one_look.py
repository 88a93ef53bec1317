"""One look at a stem in the photographs, and the fit of what it shows.

Whether there is a stem, and about how thick, is said by photographs that show both of its edges. Where they see too few
sides to know its section, photographs that show one edge are asked too, and the cloud, where it is sharp.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from fsinfer.processes import shared_out
from fsinfer.silhouettes.edges import Strip
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.trees.diameter.edge_set import Edges, chosen_edges, joined_edges, two_sided
from fsinfer.trees.diameter.faces import Faces, sector_of_angle, sharp_faces
from fsinfer.trees.diameter.sides import NOISE_SECTORS
from fsinfer.trees.diameter.silhouette import SilhouetteFit, fit_silhouette
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings

Floats = NDArray[np.float64]


#: Edges that are less likely the stem's do not move its fit. Source: numerics.
LEAST_OF_OTHERS = 0.01


@dataclass(frozen=True, kw_only=True)
class LookSettings:
    """Constants of a look and of looking again. "Five plots": docs/trials-accuracy.md, "A second look".

    Attributes
    ----------
    min_photos: in which the stem's edges agree. Source: renders only, three renders.
    sure_radius_px: of the stem in the photographs that are fitted, where there are ``min_photos`` of them; smaller ones
        only say whether a second pair of sides has that size. Source: renders only, five plots: stems of 8 to 9 cm come
        out 0.2 to 0.4 cm too thick where those of 3 pixels are fitted with the others.
    again_rel: share by which a radius has to differ from the one before to be looked at again. Source: renders only,
        five plots: at 0.10 a stem of 8.1 cm stays at 12.2 cm, which the second look finds at 7.9 cm.
    looks: about one axis at most. Source: renders only, five plots: nothing changed after the third.
    contradict_std: standard deviations between two looks beyond which the later counts though it is less sure. Source:
        statistics, 95 %.
    against_std: standard deviations of the fit of both edges within which single edges and faces have to leave the
        radius. Source: statistics, 95 %.
    fitting_faces: probability of what faces are off by, beyond which they do not count: they lie beside the edges, as
        where two parts of the walk do not stand where they should. Source: statistics; renders only, six plots: one of
        31 stems, 70 cm, whose parts stand 3 cm beside each other.
    well_seen: of the sides: a stem of which both edges are seen from fewer is asked of single edges and sharp faces as
        well. Source: renders only, 74 stems of six plots (docs/trials-accuracy.md, "Sharp faces").
    """

    min_photos: int = 4
    sure_radius_px: float = 4.0
    again_rel: float = 0.05
    looks: int = 3
    contradict_std: float = 2.0
    against_std: float = 2.0
    fitting_faces: float = 0.95
    well_seen: float = 0.75


@dataclass(frozen=True, kw_only=True)
class Looked:
    """What the photographs show of one stem.

    ``edges`` are all candidates of photographs that show both edges, about the axis ``stem``, ``single`` those of
    photographs that show one. ``fitted`` are those of ``edges`` that say whether there is a stem. ``fit`` (about
    ``stem``) is what it is like, None where they do not agree, and ``of_fit`` what it was made of, the candidates of
    its ``weight`` and ``gain``. ``moved_m`` (2,) is how far ``stem`` lies from the axis that was asked for, along its
    two directions across; ``strips`` are some to look at.
    """

    stem: StemAxis
    edges: Edges
    single: Edges
    fitted: Edges
    of_fit: Edges
    fit: SilhouetteFit | None
    moved_m: Floats
    strips: list[Strip] = field(default_factory=list)

    def clear(self, settings: LookSettings) -> bool:
        """Whether enough photographs agree on the stem."""
        return self.fit is not None and self.fit.photos >= settings.min_photos


#: A look at some stems: their edges and strips.
Look = Callable[[Sequence[StemAxis]], tuple[list[Edges], list[list[Strip]]]]
#: Points of the cloud round a stem: (N, 2) from its axis, along its two directions across, and (N,) along it, metres.
Surface = Callable[[StemAxis], tuple[Floats, Floats]]


def fitted_look(
    stem: StemAxis,
    moved_m: Floats,
    edges: Edges,
    strips: list[Strip],
    points: tuple[float, float] | None,
    fit: SilhouetteSettings,
    s: LookSettings,
) -> Looked:
    """One look: the fit to the photographs that show the stem large, or to all where those are too few or not clear."""
    both = two_sided(edges)
    single, edges = chosen_edges(edges, ~both), edges if both.all() else chosen_edges(edges, both)
    large = _is_large(edges, stem, s)
    enough = len(np.unique(edges.photo[large])) >= s.min_photos
    tries = []
    for some in (chosen_edges(edges, large), edges) if enough else (edges,):
        found = fit_silhouette(some, stem.radius_m, taper=stem.taper, settings=fit, points=points)
        one = Looked(
            stem=stem,
            edges=edges,
            single=single,
            fitted=some,
            of_fit=some,
            fit=found,
            moved_m=moved_m,
            strips=strips,
        )
        tries.append(one)
        if one.clear(s):
            return one
    return tries[0]  # what is no stem in the large pictures is asked of them, too, whether it is a shrub


def fitted_looks(
    asked: Iterable[tuple[StemAxis, Floats, Edges, list[Strip], tuple[float, float] | None]],
    fit: SilhouetteSettings,
    s: LookSettings,
) -> list[Looked]:
    """:func:`fitted_look` of each: axis, how far it is from the one asked for, edges, strips and the points' radius."""
    asked = list(asked)
    looked = shared_out(
        partial(_fitted, fit, s), [(stem, moved, edges, points) for stem, moved, edges, _, points in asked]
    )
    return [replace(one, strips=strips) for one, (_, _, _, strips, _) in zip(looked, asked, strict=True)]


def _fitted(
    fit: SilhouetteSettings,
    s: LookSettings,
    asked: tuple[StemAxis, Floats, Edges, tuple[float, float] | None],
) -> Looked:
    """:func:`fitted_look` without the strips, which only people look at."""
    stem, moved, edges, points = asked
    return fitted_look(stem, moved, edges, [], points, fit, s)


def own_look(looked: Looked, points: tuple[float, float] | None, fit: SilhouetteSettings, s: LookSettings) -> Looked:
    """The look fitted without the edges that are another's, where the fit rests on such.

    Whether there is a stem is asked of all edges: where the depth map has one, those that are left would agree on it in
    a picture of leaves.
    """
    first, edges = looked.fit, looked.of_fit
    if first is None or not rests_on_others(looked, s):
        return looked
    own = chosen_edges(edges, edges.own)
    found = fit_silhouette(own, looked.stem.radius_m, taper=looked.stem.taper, settings=fit, points=points)
    if found is None:
        return looked
    of_all = replace(found, contrast=first.contrast, share=found.rays * first.share / first.rays)
    new = replace(looked, fit=of_all, of_fit=own)
    return new if new.clear(s) else looked


def own_looks(
    looked: Sequence[Looked], points: Sequence[tuple[float, float] | None], fit: SilhouetteSettings, s: LookSettings
) -> list[Looked]:
    """:func:`own_look` of each."""
    best = list(looked)
    asking = [number for number, one in enumerate(best) if rests_on_others(one, s)]
    asked = ((replace(looked[number], strips=[]), points[number]) for number in asking)
    for number, found in zip(asking, shared_out(partial(_own, fit, s), asked), strict=True):
        best[number] = replace(found, strips=looked[number].strips)
    return best


def rests_on_others(looked: Looked, s: LookSettings) -> bool:
    """Whether there is a stem whose fit has edges that are another's."""
    fit = looked.fit
    return fit is not None and looked.clear(s) and bool((fit.weight[~looked.of_fit.own] > LEAST_OF_OTHERS).any())


def _own(fit: SilhouetteSettings, s: LookSettings, asked: tuple[Looked, tuple[float, float] | None]) -> Looked:
    looked, points = asked
    return own_look(looked, points, fit, s)


def fuller_look(
    looked: Looked,
    points: tuple[float, float] | None,
    fit: SilhouetteSettings,
    s: LookSettings,
    surface: Surface | None,
) -> Looked:
    """The look with what else knows a half-seen stem: single edges first, then the cloud's sharp faces about those.

    What contradicts both edges of the photographs that have them does not count.
    """
    if not asks_for_more(looked, s):
        return looked
    best = looked
    large = _is_large(looked.single, looked.stem, s) & looked.single.own
    if large.any():
        more = joined_edges(looked.of_fit, chosen_edges(looked.single, large))
        best = _unless_against(looked, best, more, None, points, fit, s)
    faces = None if surface is None else _faces(best, *surface(looked.stem), fit)
    return best if faces is None else _unless_against(looked, best, best.of_fit, faces, points, fit, s)


def fuller_looks(
    looked: Sequence[Looked],
    points: Sequence[tuple[float, float] | None],
    fit: SilhouetteSettings,
    s: LookSettings,
    surface: Surface | None,
) -> list[Looked]:
    """:func:`fuller_look` of each; points that gave no radius have no say in what the edges have to agree with."""
    best = list(looked)
    asking = [number for number, one in enumerate(best) if asks_for_more(one, s)]

    def asked() -> Iterator[tuple[Looked, tuple[float, float] | None, tuple[Floats, Floats] | None]]:
        for number in asking:
            one, radius = best[number], points[number]
            about = None if surface is None or radius is None else surface(one.stem)
            yield replace(one, strips=[]), radius, about

    for number, found in zip(asking, shared_out(partial(_fuller, fit, s), asked()), strict=True):
        best[number] = replace(found, strips=looked[number].strips)
    return best


def _fuller(
    fit: SilhouetteSettings,
    s: LookSettings,
    asked: tuple[Looked, tuple[float, float] | None, tuple[Floats, Floats] | None],
) -> Looked:
    looked, points, about = asked
    return fuller_look(looked, points, fit, s, None if about is None else lambda _: about)


def asks_for_more(looked: Looked, s: LookSettings) -> bool:
    """Whether there is a stem of which both edges are seen from too few sides to know its section."""
    return looked.fit is not None and looked.clear(s) and looked.fit.sectors < s.well_seen


def _unless_against(
    looked: Looked,
    best: Looked,
    edges: Edges,
    faces: Faces | None,
    points: tuple[float, float] | None,
    fit: SilhouetteSettings,
    s: LookSettings,
) -> Looked:
    """The look with a fit of ``edges`` and ``faces``, or the ``best`` so far where that contradicts the first."""
    stem, first = looked.stem, looked.fit
    found = fit_silhouette(edges, stem.radius_m, taper=stem.taper, settings=fit, points=points, faces=faces)
    if found is None or first is None:
        return best
    new = replace(best, fit=replace(found, fuller=True, contrast=first.contrast), of_fit=edges)
    fits = found.faces_misfit * found.faces <= 2.0 * gammaincinv(0.5 * max(found.faces, 1), s.fitting_faces)
    if not (new.clear(s) and fits):
        return best
    return new if abs(found.radius_m - first.radius_m) <= s.against_std * first.std_m else best


def _faces(looked: Looked, offsets_m: Floats, height_m: Floats, fit: SilhouetteSettings) -> Faces | None:
    """Sharp faces of the cloud on the sides that no edge of the fit lies on."""
    found = looked.fit
    if found is None or len(height_m) == 0:
        return None
    seen = np.zeros(NOISE_SECTORS, dtype=bool)
    seen[sector_of_angle(looked.of_fit.angle_rad[found.weight > 0.5])] = True
    return sharp_faces(offsets_m, height_m, found.section, seen, settings=fit.faces)


def _is_large(edges: Edges, stem: StemAxis, s: LookSettings) -> NDArray[np.bool_]:
    """Whether each edge's (N,) photograph shows the stem large."""
    return np.asarray(edges.pixel_m * s.sure_radius_px <= stem.radius_m)

"""Looking at a stem in the photographs, and again about what was found there.

Where its edges are looked for, and which photographs show it large and unhidden enough, goes by what is known of a stem
before: by the cloud. That may be a haze half again as wide as the stem and some centimetres aside of it. What counts as
bark then has the stem's own edges in it, and some photographs show something else where the haze's near side is. So a
stem that turns out to have another radius is looked at once more about what was found. A true edge is found again; what
only lay where the haze ended is not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMaps
from fsinfer.progress import Progress, silent
from fsinfer.scene import Scene
from fsinfer.silhouettes.edges import EdgeSettings, StemAxis, Strip, find_edges
from fsinfer.silhouettes.strips import keep_strip
from fsinfer.trees.cylinder.axis import LEAST_RADIUS_M
from fsinfer.trees.diameter.edge_problem import Edges, SilhouetteSettings, chosen_edges
from fsinfer.trees.diameter.silhouette import SilhouetteFit, fit_silhouette

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class LookSettings:
    """Constants of :func:`look_at_stems`. "Five plots": docs/trials-accuracy.md, "A second look".

    Attributes
    ----------
    min_photos: in which the stem's edges agree. Source: renders only, three renders.
    sure_radius_px: of the stem in the photographs that are fitted, where there are ``min_photos`` of them; smaller ones
        only say whether a second pair of sides has that size. Source: renders only, five plots: stems of 8 to 9 cm come
        out 0.2 to 0.4 cm too thick where those of 3 pixels are fitted with the others.
    again_rel: share by which a radius has to differ from the one before to be looked at again. Source: renders only,
        five plots: at 0.10 a stem of 8.1 cm stays at 12.2 cm, which the second look finds at 7.9 cm.
    looks: at a stem at most. Source: renders only, five plots: nothing changed after the third.
    contradict_std: standard deviations between two looks beyond which the later counts though it is less sure. Source:
        statistics, 95 %.
    """

    min_photos: int = 4
    sure_radius_px: float = 4.0
    again_rel: float = 0.05
    looks: int = 3
    contradict_std: float = 2.0


@dataclass(frozen=True, kw_only=True)
class Looked:
    """What the photographs show of one stem.

    ``edges`` are all candidates about the axis ``stem``, ``fitted`` those that were fitted, ``fit`` (about ``stem``) is
    None where they do not agree. ``moved_m`` (2,) is how far ``stem`` lies from the axis that was asked for, along its
    two directions across; ``strips`` are some to look at.
    """

    stem: StemAxis
    edges: Edges
    fitted: Edges
    fit: SilhouetteFit | None
    moved_m: Floats
    strips: list[Strip] = field(default_factory=list)

    def clear(self, settings: LookSettings) -> bool:
        """Whether enough photographs agree on the stem."""
        return self.fit is not None and self.fit.photos >= settings.min_photos


#: A look at some stems: their edges and strips.
Look = Callable[[Sequence[StemAxis]], tuple[list[Edges], list[list[Strip]]]]


def look_at_stems(
    stems: Sequence[StemAxis],
    points: Sequence[tuple[float, float] | None],
    scene: Scene,
    maps: DepthMaps,
    cloud_from_scene: Floats,
    *,
    edges: EdgeSettings,
    fit: SilhouetteSettings,
    settings: LookSettings | None = None,
    keep_strips: bool = False,
    progress: Progress = silent,
) -> list[Looked]:
    """Find each stem in the photographs and fit its silhouette; ``points`` are the cloud's radii and their deviations.

    Raises :class:`~fsinfer.errors.FsinferError` where a photograph or a depth map cannot be read.
    """
    s = settings or LookSettings()

    def look(at: Sequence[StemAxis], progress: Progress = silent) -> tuple[list[Edges], list[list[Strip]]]:
        strips: list[list[Strip]] = [[] for _ in at]

        def on_strip(number: int, strip: Strip) -> None:
            keep_strip(strips[number], strip)

        wanted = on_strip if keep_strips else None
        found = find_edges(at, scene, maps, cloud_from_scene, settings=edges, on_strip=wanted, progress=progress)
        return found, strips

    first = look(stems, progress)
    here = np.zeros(2)
    looked = [
        fitted_look(stem, here, found, strips, radius, fit, s)
        for stem, found, strips, radius in zip(stems, *first, points, strict=True)
    ]
    return again(looked, points, look, fit=fit, settings=s)


def again(
    looked: Sequence[Looked],
    points: Sequence[tuple[float, float] | None],
    look: Look,
    *,
    fit: SilhouetteSettings,
    settings: LookSettings,
) -> list[Looked]:
    """Look once more at the stems whose radius is another than was thought, until it stays; the surer look counts."""
    s, best = settings, list(looked)
    moving = list(range(len(best)))
    for _ in range(1, s.looks):
        moving = [number for number in moving if _other_than_thought(best[number], s)]
        if not moving:
            break
        counted = []
        axes = [_axis_found(best[number], fitted) for number in moving if (fitted := best[number].fit) is not None]
        for number, (stem, moved), edges, strips in zip(moving, axes, *look([stem for stem, _ in axes]), strict=True):
            new = fitted_look(stem, moved, edges, strips, points[number], fit, s)
            if _counts(new, best[number], s):
                best[number] = new
                counted.append(number)
        moving = counted
    return best


def _other_than_thought(looked: Looked, s: LookSettings) -> bool:
    thought = looked.stem.radius_m
    return looked.fit is not None and abs(looked.fit.radius_m - thought) > s.again_rel * thought


def _axis_found(looked: Looked, fit: SilhouetteFit) -> tuple[StemAxis, Floats]:
    """The axis where the fit has it, and how far that is from the one that was asked for."""
    stem = looked.stem
    first, second = stem.across
    breast = stem.breast + fit.shift_m[0] * first + fit.shift_m[1] * second
    found = replace(stem, breast=breast, radius_m=max(fit.radius_m, LEAST_RADIUS_M))
    return found, np.asarray(looked.moved_m + fit.shift_m)


def _counts(new: Looked, old: Looked, s: LookSettings) -> bool:
    """Whether the later look counts: it is clear, and surer than the one before or against it."""
    if not new.clear(s) or new.fit is None:
        return False
    if not old.clear(s) or old.fit is None:
        return True
    apart, both = abs(new.fit.radius_m - old.fit.radius_m), float(np.hypot(new.fit.std_m, old.fit.std_m))
    return new.fit.std_m <= old.fit.std_m or apart > s.contradict_std * both


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
    large = edges.pixel_m * s.sure_radius_px <= stem.radius_m
    enough = len(np.unique(edges.photo[large])) >= s.min_photos
    tries = []
    for some in (chosen_edges(edges, large), edges) if enough else (edges,):
        found = fit_silhouette(some, stem.radius_m, taper=stem.taper, settings=fit, points=points)
        tries.append(Looked(stem=stem, edges=edges, fitted=some, fit=found, moved_m=moved_m, strips=strips))
        if tries[-1].clear(s):
            return tries[-1]
    return tries[0]  # what is no stem in the large pictures is asked of them, too, whether it is a shrub

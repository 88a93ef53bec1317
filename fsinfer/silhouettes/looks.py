"""Looking at a stem in the photographs, and again about what was found there.

Where its edges are looked for, and which photographs show it large and unhidden enough, goes by what is known of a stem
before: by the cloud. That may be a haze half again as wide as the stem and some centimetres aside of it. What counts as
bark then has the stem's own edges in it, and some photographs show something else where the haze's near side is. So a
stem that turns out to have another radius is looked at once more about what was found. A true edge is found again; what
only lay where the haze ended is not.

What the cloud refused, and whose edges agree little or not at all, is looked for wider
(:mod:`fsinfer.silhouettes.wide_look`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMaps
from fsinfer.progress import Progress, silent
from fsinfer.scene import Scene
from fsinfer.silhouettes.edge_settings import EdgeSettings
from fsinfer.silhouettes.edges import Strip, find_edges
from fsinfer.silhouettes.one_look import Look, Looked, LookSettings, Surface, fitted_looks, fuller_looks, own_looks
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.silhouettes.strips import keep_strip
from fsinfer.silhouettes.visibility import BOTH_SIDES
from fsinfer.silhouettes.wide_look import WideLookSettings, look_wider
from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.silhouette import SilhouetteFit
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings

Floats = NDArray[np.float64]


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
    wider: WideLookSettings | None = None,
    keep_strips: bool = False,
    surface: Surface | None = None,
    progress: Progress = silent,
) -> list[Looked]:
    """Find each stem in the photographs and fit its silhouette; ``points`` are the cloud's radii and their deviations.

    Stems without a radius by their points are looked for ``wider``. ``surface`` gives the points of the cloud round a
    stem, None where there are none.
    Raises :class:`~fsinfer.errors.FsinferError` where a photograph or a depth map cannot be read.
    """
    s, of_wide = settings or LookSettings(), wider or WideLookSettings()
    in_wide_strips = replace(edges, margin_m=edges.margin_m + of_wide.reach_m)

    def look(at: Sequence[StemAxis], progress: Progress = silent) -> tuple[list[Edges], list[list[Strip]]]:
        strips: list[list[Strip]] = [[] for _ in at]

        def on_strip(number: int, strip: Strip) -> None:
            if strip.sides == BOTH_SIDES:  # half a stem says little to who looks at it
                keep_strip(strips[number], strip)

        wanted = on_strip if keep_strips else None
        found = find_edges(at, scene, maps, cloud_from_scene, settings=edges, on_strip=wanted, progress=progress)
        return found, strips

    def wide(at: Sequence[StemAxis]) -> list[Edges]:
        return find_edges(at, scene, maps, cloud_from_scene, settings=in_wide_strips)

    first = look(stems, progress)
    here = np.zeros(2)
    progress(0, 4, "looking again")
    seen = zip(stems, *first, points, strict=True)
    looked = fitted_looks([(stem, here, found, strips, radius) for stem, found, strips, radius in seen], fit, s)
    progress(1, 4, "looking again")
    looked = again(looked, points, look, fit=fit, settings=s)
    progress(2, 4, "looking again")
    refused = [number for number, of_points in enumerate(points) if of_points is None]
    found_wider = look_wider(
        [stems[number] for number in refused],
        [looked[number] for number in refused],
        look,
        wide,
        fit=fit,
        looks=s,
        settings=of_wide,
        measured=[stem for stem, of_points in zip(stems, points, strict=True) if of_points is not None],
    )
    progress(3, 4, "looking again")
    moved = {number: new for number, new in zip(refused, found_wider, strict=True) if new is not looked[number]}
    surest = again(list(moved.values()), [None] * len(moved), look, fit=fit, settings=s)
    for number, new in zip(moved, surest, strict=True):
        looked[number] = new

    return fuller_looks(own_looks(looked, points, fit, s), points, fit, s, surface)


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
        seen = zip(moving, axes, *look([stem for stem, _ in axes]), strict=True)
        asked = [(stem, moved, edges, strips, points[number]) for number, (stem, moved), edges, strips in seen]
        for number, new in zip(moving, fitted_looks(asked, fit, s), strict=True):
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
    return looked.stem.moved(fit.shift_m, fit.radius_m), np.asarray(looked.moved_m + fit.shift_m)


def _counts(new: Looked, old: Looked, s: LookSettings) -> bool:
    """Whether the later look counts: it is clear, and surer than the one before or against it."""
    if not new.clear(s) or new.fit is None:
        return False
    if not old.clear(s) or old.fit is None:
        return True
    apart, both = abs(new.fit.radius_m - old.fit.radius_m), float(np.hypot(new.fit.std_m, old.fit.std_m))
    return new.fit.std_m <= old.fit.std_m or apart > s.contradict_std * both

"""Stems where a person says that some stand: looked for there by much less evidence, and measured as the plot's are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fsinfer.trees.diameter.section import Section
from fsinfer.trees.ground.ground import Ground
from fsinfer.trees.measure import PlotResult, near_plot
from fsinfer.trees.points.cells import rows
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.sanity import as_numbers, finite_points
from fsinfer.trees.search.find import StemSearch, find_stems
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.stem_measurement import SAME_M, measure_stems
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
#: A point set by hand on a map lies within this of the stem's middle, besides its radius, metres. Source: not recorded.
REACH_M = 0.35
#: Points around a place that are looked at, metres. Source: geometry; a stem that leans by 45 degrees is 1.2 m aside at
#: the search's upper end, beside ``REACH_M``, the widest radius, and what it has to stand out from.
AROUND_M = 3.0
#: Of two stems as near to a place the better one is taken; metres a unit of quality. Source: numerics.
TIE = 1e-3
#: A person says that a stem stands there: much less evidence is asked for than where nobody said so. Source: not
#: recorded.
SEEN_BY_PERSON = StemSettings(
    min_votes=0.8, min_length_m=0.3, min_arc=0.08, max_filled=0.6, max_noise=0.6, min_contrast=1.1, rough_m=0.025,
    sure_length_m=0.3, sure_arc=0.08, thin_m=0.0,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PlotAgain:
    """The cloud of a plot that was measured before, to be asked again.

    ``stand`` (N, 3) are x, y about ``origin`` (3,) and height above ``ground``, which is about it too; metres.
    ``errors`` are those of the points, ``known`` the stems that the search of the plot found, in the cloud's frame.
    """

    stand: Floats
    ground: Ground
    origin: Floats
    errors: PointErrors | None
    settings: TreeSettings
    scale_rel_std: float
    known: Sequence[Stem] = ()

    @classmethod
    def of(
        cls,
        result: PlotResult,
        points: ArrayLike,
        settings: TreeSettings,
        scale_rel_std: float,
        errors: PointErrors | None,
    ) -> PlotAgain | None:
        """That of points (N, 3) in the frame of the ``result``, metres; None without ground, or without points."""
        xyz = as_numbers(points)
        finite = finite_points(xyz)
        if result.ground is None or not finite.any():
            return None
        xyz = rows(xyz, finite)
        box = np.array(result.extent_m).reshape(2, 2)
        near = near_plot(xyz, box)
        xyz = rows(xyz, near)
        # About an origin of its own, as in the search: map coordinates would cost precision in the fits.
        origin = np.array([*np.floor(box.mean(axis=0)), 0.0])
        x, y, z = xyz[:, 0] - origin[0], xyz[:, 1] - origin[1], xyz[:, 2]
        ground = result.ground.moved(-origin[:2])
        return cls(
            stand=np.stack([x, y, z - ground.height_at(np.stack([x, y]).T)]).T,
            ground=ground,
            origin=origin,
            errors=None if errors is None else errors.select(finite).select(near),
            settings=settings,
            scale_rel_std=scale_rel_std,
            known=[found.stem for found in result.stems],
        )

    def stem_at(self, places: Floats, taken: Callable[[Floats], bool]) -> Stem | None:
        """The best stem at one place (1, 2), or over two (2, 2) that are the same tree; None where none can be seen.

        Places and stem are in the frame of the cloud. No stem whose middle (2,) is ``taken``: those have entries.
        """
        middle = places.mean(axis=0)
        apart = float(np.linalg.norm(places - middle, axis=1).max())
        about = np.hypot(*(self.stand[:, :2] + (self.origin[:2] - middle)).T) <= AROUND_M + apart
        own = rows(self.stand, about)
        best: tuple[Stem, float] | None = None
        for wanted in (self.settings.stems, SEEN_BY_PERSON):
            search = find_stems(
                own,
                bh_m=self.settings.bh_m,
                settings=wanted,
                seed=self.settings.seed,
                gradient_at=self.ground.gradient_at,
            )
            for found in search.stems:
                stem = found.moved(self.origin[:2])
                center = self._middle(stem)
                off = float(np.linalg.norm(center - middle))
                if off > REACH_M + apart + stem.axis.radius_m or taken(center):
                    continue
                # One place: the nearest. Two: the one with the most to show for itself.
                worth = stem.quality if len(places) > 1 else -max(off - stem.axis.radius_m, 0.0) + TIE * stem.quality
                if best is None or worth > best[1]:
                    best = stem, worth
            if best is not None:
                return self._as_known(best[0])
        return None

    def _as_known(self, stem: Stem) -> Stem:
        """The stem as the search of the whole plot has it, where it does: cells and spacing were others there."""
        apart = [float(np.linalg.norm(self._middle(other) - self._middle(stem))) for other in self.known]
        nearest = int(np.argmin(apart)) if apart else 0
        return self.known[nearest] if apart and apart[nearest] < SAME_M else stem

    def _middle(self, stem: Stem) -> Floats:
        return stem.axis.center_at(self.settings.bh_m)

    def measured(self, stems: Sequence[Stem], beside: Sequence[Stem]) -> list[tuple[Tree, Section] | None]:
        """The stems as they measure among those ``beside`` them, all in the frame of the cloud; None for no tree's."""
        own, others = ([stem.moved(-self.origin[:2]) for stem in those] for those in (stems, beside))
        search = StemSearch(stems=tuple(own), candidates=len(own), rejected={}, spacing_m=float("nan"))
        pairs = measure_stems(
            self.stand,
            search,
            self.ground,
            self.settings,
            self.scale_rel_std,
            self.origin,
            errors=self.errors,
            neighbours=others,
        )
        of = {tree.tree_id: (tree, section) for tree, section in pairs}
        return [of.get(number) for number in range(len(stems))]

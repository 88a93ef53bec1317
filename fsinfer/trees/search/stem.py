"""A stem as the search finds it, and the constants of the search."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import Axis


@dataclass(frozen=True, kw_only=True)
class StemSettings:
    """Constants of :func:`find_stems`. "Simulated stems" are the seeds of tests/bench/stems.py below 1000.

    Attributes
    ----------
    heights_m: above most herbs, below most crowns. Source: not recorded.
    band_m: thick enough to hold every row of a sparse scan, thin enough for leaning stems. Source: geometry.
    window_m: bands that vote together; 6 degrees of lean shift a centre by 10 cm over it. Source: geometry.
    cell_m: of the order of the noise; grows with the spacing of sparse clouds, and centres are voted for in cells twice
        as wide. Source: chosen on simulated stems.
    radius_m: of the stems looked for. Source: inventories start at 4 cm of DBH.
    giant_radius_m: of those looked for in a second search (:mod:`fsinfer.trees.search.giants`). Source: the thickest
        trees of Europe's forests have 2 to 2.5 m of DBH.
    min_votes: cells per band. Source: geometry, a third of what a stem of 6 cm diameter seen from one side gives.
    min_points: about a candidate. Source: not recorded.
    min_ring: share of its circle that a start shows. Source: geometry, 43 degrees in two thirds of the layers.
    max_lean_deg: of an axis; beyond it lies a log. Source: judgement; with 25 simulated stems that lean by 26 to 40
        degrees were lost, with 45 all come out within 0.2 cm, and neither two scanned plots nor four clouds of rendered
        photographs nor 267 other simulated stems have an entry more (docs/trials-accuracy.md).
    min_length_m: of supported layers; the bands span 2 m and undergrowth may hide half of them. Source: chosen on
        simulated stems.
    min_arc: 43 degrees; a stem seen by a sliver is found, though not measured. Source: chosen on simulated stems.
    max_filled: share of points well inside; stems are hollow to the eye, shrubs are not. Source: chosen on simulated
        stems.
    min_contrast: density on the wall against the density just outside of it. Source: chosen on simulated stems.
    max_noise: sigma over radius; more is a bush. Source: chosen on simulated stems.
    max_sigma_m: the fit's own bound is 3 cm: whoever reaches it has found no wall. Source: ``AxisSettings.sigma_m``.
    blurred_sigma_m: the same in a third search (:mod:`fsinfer.trees.search.blurred`), which asks for more height and
        girth. Source: renders only, the undergrown plots of seeds 955022 to 955024.
    rough_m: noisier than the usual photogrammetric cloud (1.5 cm): a shrub, unless it is ``sure_length_m`` long.
        Source: chosen on simulated stems.
    sure_length_m: supported length of what is rough or touches another stem. Source: chosen on simulated stems.
    sure_arc: share of the circumference seen of a stem that touches another. Source: chosen on simulated stems.
    thin_m: posts and boards: thinner than this and ... Source: chosen on simulated posts and boards.
    post_top_m: ... ending below this is no tree. Source: chosen on simulated posts and boards.
    """

    heights_m: tuple[float, float] = (0.5, 2.5)
    band_m: float = 0.25
    window_m: float = 1.0
    cell_m: float = 0.015
    radius_m: tuple[float, float] = (0.02, 0.60)
    giant_radius_m: float = 1.25
    min_votes: float = 2.5
    min_points: int = 8
    min_ring: float = 0.08
    max_lean_deg: float = 45.0
    min_length_m: float = 0.7
    min_arc: float = 0.12
    max_filled: float = 0.35
    min_contrast: float = 1.6
    max_noise: float = 0.40
    max_sigma_m: float = 0.028
    blurred_sigma_m: float = 0.045
    rough_m: float = 0.017
    sure_length_m: float = 1.2
    sure_arc: float = 0.25
    thin_m: float = 0.06
    post_top_m: float = 2.0


@dataclass(frozen=True, kw_only=True)
class Stem:
    """A verified stem: its axis (heights above ground), the supported height range, and the evidence."""

    axis: Axis
    bottom_m: float
    top_m: float
    length_m: float
    arc_coverage: float
    quality: float

    def moved(self, by: NDArray[np.float64]) -> Stem:
        """The same stem elsewhere in plan, by (2,) metres."""
        parameters = self.axis.parameters.copy()
        parameters[:2] += by
        return replace(self, axis=replace(self.axis, parameters=parameters))

"""A stem as the search finds it, and the constants of the search."""

from __future__ import annotations

from dataclasses import dataclass

from fsinfer.trees.cylinder.axis import Axis


@dataclass(frozen=True, kw_only=True)
class StemSettings:
    """Constants of :func:`find_stems`."""

    heights_m: tuple[float, float] = (0.5, 2.5)  # above most herbs, below most crowns
    band_m: float = 0.25  # thick enough to hold every row of a sparse scan, thin enough for leaning stems
    window_m: float = 1.0  # bands that vote together; 6 degrees of lean shift a centre by 10 cm over it
    cell_m: float = 0.015  # of the order of the noise; grows with the spacing of sparse clouds
    vote_cell_m: float = 0.03
    radius_m: tuple[float, float] = (0.02, 0.60)
    min_votes: float = 2.5  # cells per band: a third of what a stem of 6 cm diameter seen from one side gives
    min_points: int = 8  # about a candidate
    start_sigma_m: float = 0.02  # of the fits: wide, so that they find walls two centimetres off
    min_ring: float = 0.08  # share of its circle that a start shows, as at 43 degrees in two thirds of the layers
    ring_points: int = 3000  # of which rings are looked for: some twenty in each sector and layer of a stem
    few_points: int = 150  # for the first steps of a fit, in which most candidates run away
    few_steps: int = 7
    more_points: int = 300  # for some more, after which most of the others are not round
    more_steps: int = 10
    fit_points: int = 700
    tolerance_m: float = 5e-5  # of the last fit: finer than any limit below
    apart_m: float = 0.3  # candidates farther apart are looked at together; both may find one stem, which is resolved
    together: int = 256  # candidates looked at at once: bounds the memory, and fills the batches of the fits
    max_lean_deg: float = 25.0
    layer_m: float = 0.10  # layers of the persistence check
    min_length_m: float = 0.7  # of supported layers; the bands span 2 m and undergrowth may hide half of them
    min_arc: float = 0.12  # 43 degrees: a stem seen by a sliver is found, though not measured
    max_filled: float = 0.35  # share of points well inside: stems are hollow to the eye, shrubs are not
    min_contrast: float = 1.6  # density on the wall against the density just outside of it
    max_noise: float = 0.40  # sigma over radius; more is a bush
    max_sigma_m: float = 0.028  # the fit's own bound is 3 cm: whoever reaches it has found no wall
    rough_m: float = 0.017  # noisier than the usual photogrammetric cloud (1.5 cm): a shrub, unless it shows ...
    min_rough_length_m: float = 1.2  # ... this much of a stem
    thin_m: float = 0.06  # posts and boards: thinner than this and ...
    post_top_m: float = 2.0  # ... ending below this is no tree
    min_fork_length_m: float = 1.2  # a stem that touches another must show itself more clearly:
    min_fork_arc: float = 0.25
    index_cell_m: float = 0.375  # half of the reach of a look around
    max_seeds_per_m2: float = 3.0  # 30,000 candidates a hectare bound the time in a thicket


@dataclass(frozen=True, kw_only=True)
class Stem:
    """A verified stem: its axis (heights above ground), the supported height range, and the evidence."""

    axis: Axis
    bottom_m: float
    top_m: float
    length_m: float
    arc_coverage: float
    quality: float

"""The constants of the fit of a stem's silhouette to its edges."""

from __future__ import annotations

from dataclasses import dataclass, field

from fsinfer.trees.diameter.faces import FaceSettings


@dataclass(frozen=True, kw_only=True)
class SilhouetteSettings:
    """Constants of :func:`fsinfer.trees.diameter.silhouette.fit_silhouette`; lengths in metres.

    "Two renders" are the open and the sloped plot.

    Attributes
    ----------
    radius_range: of the radius known before, which may come from a haze. Source: renders only, two renders.
    beyond_m: the greatest radius looked at is that much greater at least: thin stems would have nothing to stand out
        from. Source: renders only, a stem of 8 cm (seed 953002) had a contrast of 1.07 instead of 1.26 and was taken
        for a shrub; no other stem on two plots changed.
    place_range_m: to either side of where the cloud has the axis. Source: renders only, two renders.
    place_std_m: prior of where the cloud has the axis. Source: renders only, two renders.
    slope_std: prior of its slope. Source: renders only, two renders.
    taper_std: prior of its taper, radius per metre of height. Source: renders only, two renders.
    hull_of_rough_bark: harmonics of the hull over those of the surface, in the priors of the cloud's fit. Source:
        renders only, so that the intervals of stems seen from one side hold the truth on all plots.
    edge_std_px: of one edge in one band. Source: renders only, two renders.
    background: likelihood of "none of these is the stem's edge", against an edge of strength 1. Source: renders only,
        two renders.
    min_contrast: votes of the best radius over those of the median one. Source: renders only, stems have 1.4 to 1.9; of
        five on four development plots that had 1.2 to 1.3 four came out right, the fifth with what a fit of few sides
        is off; shrubs have 1.02 to 1.12.
    offset_m: scale of the prior of each photograph's offset. Source: cameras of plots stand 2 to 18 mm from the truth,
        those next to each other the same way; on five development plots the RMSE of the edges of stems seen from 60 %
        of their sides is 0.20 cm without offsets, 0.16 at 1 mm, 0.15 at 2 mm; renders only.
    sector_m: what bark, light and cover move all edges by that are seen from one of the sectors round the stem, by
        which a harmonic is not told from a few of them. Source: renders only, 121 stems of four development plots
        (docs/trials-accuracy.md).
    common_px: what all edges share (blur, light from one side, undistortion), typical pixels. Source: renders only,
        so that the intervals of stems seen from one side hold the truth on all plots.
    common_std: what a few harmonics do not describe, share of the radius. Source: renders only, two renders.
    one_sided_std: what else a stem may be off that is seen from one direction, share of the radius: two sides leave
        its size to shadows, to what covers an edge, to a shape that nobody saw. Source: simulated edges
        (training/simulate/stem_edges.py), seeds 43000 to 43179, and 43200 to 43419 on arcs below 110 degrees.
    sides_enough: share of the sides from which that is nothing. Source: as ``one_sided_std``.
    min_edges: rays. Source: twice the unknowns that no prior holds.
    min_share: of the rays that must agree on the stem. Source: renders only, two renders.
    faces: of sharp faces of the cloud.
    """

    radius_range: tuple[float, float] = (0.6, 1.5)
    beyond_m: float = 0.09
    place_range_m: float = 0.04
    place_std_m: float = 0.05
    slope_std: float = 0.03
    taper_std: float = 0.006
    hull_of_rough_bark: float = 1.5
    edge_std_px: float = 0.5
    background: float = 0.13
    min_contrast: float = 1.2
    offset_m: float = 0.002
    sector_m: float = 0.002
    common_px: float = 0.08
    common_std: float = 0.003
    one_sided_std: float = 0.05
    sides_enough: float = 0.6
    min_edges: int = 8
    min_share: float = 0.5
    faces: FaceSettings = field(default_factory=FaceSettings)

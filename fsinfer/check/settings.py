"""Settings of the check: which photo sees which stem, and when a stem is named; light to import."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """When a direction counts as seen, and when a stem is named.

    Attributes
    ----------
    margin_m: stems are judged up to so far outside the walk; farther ones cannot be seen from all sides. Source:
        option.
    one_sided_deg: a stem is called seen from one side where no photo sees it in so wide a fan of directions; a
        half-plane has 180. Source: two rendered plots, walked all round, whose widest fans were 161 and 147 degrees
        (both stems of 10 cm, in a corner of the plot), the next 130; renders only.
    far_m: a stem that no five photos are nearer to is called far. Source: judgement; the depth of far stems is a haze
        of centimetres from 8 m on.
    few_photos, few_share: with fewer photos than this number and this share of all, a stem was hardly seen, and its
        directions mean little. Source: rendered plots (`tests.bench.check`); renders only.
    """

    margin_m: float = 0.5
    one_sided_deg: float = 165.0
    far_m: float = 9.0
    few_photos: int = 10
    few_share: float = 0.08


@dataclass(frozen=True, kw_only=True)
class SightingSettings:
    """When a photo counts as seeing a stem.

    Attributes
    ----------
    heights_m: lowest and highest of the places on the stem that are looked up. Source: judgement; above ferns, below
        branches.
    tolerance_m, of_radius, of_distance: how far the depth may be off, in all: metres, and shares. Source: small depth
        maps are off by 2 % of the distance; stems seldom have something else so near behind them.
    min_share: of the places. A photo from nearby shows only some of them. Source: judgement.
    near: what is nearer than so many times the nearest depth that was searched has none, and counts as seen: a photo
        taken an arm's length from a stem. Source: judgement.
    together_m: a photo counts where another one, not farther off than this, sees the stem too: one alone may be
        mistaken, and gives no depth. Source: judgement; three steps of a walker.
    """

    heights_m: tuple[float, float] = (0.5, 2.4)
    tolerance_m: float = 0.1
    of_radius: float = 0.5
    of_distance: float = 0.02
    min_share: float = 0.2
    near: float = 1.25
    together_m: float = 1.5


@dataclass(frozen=True, kw_only=True)
class SparseStemSettings:
    """Of the search for stems in sparse points, metres where the scale is known (else by the height of the cameras).

    Attributes
    ----------
    min_height_m, max_height_m: part of the stems that is looked at. Source: judgement; below are ferns, above branches.
    max_error_px: points that are trusted. Source: judgement.
    reach_m: points this near in plan belong together. Source: a stem leaning by 5 degrees shifts by 0.1 m over a metre.
    slice_m, min_slices: a point is part of something upright when its neighbours fill so many slices of this height.
        Source: judgement.
    min_points: fewer points on the circle are no stem. Source: five rendered plots, on which 15 find one stem of 8 cm
        more than 20, and nothing that is no tree; renders only.
    min_radius_m, max_radius_m: of a stem. Source: stems of 4 to 120 cm.
    tolerance_m: distance from the circle of a point on it. Source: sparse points of a stem scatter by 1 to 3 cm.
    min_inlier_share: of the cluster's points. Source: judgement; shrubs and stacks of wood stay below.
    max_lean: metres sideways for each metre up. Source: judgement; 11 degrees.
    """

    min_height_m: float = 0.4
    max_height_m: float = 2.6
    max_error_px: float = 2.0
    reach_m: float = 0.13
    slice_m: float = 0.25
    min_slices: int = 5
    min_points: int = 15
    min_radius_m: float = 0.02
    max_radius_m: float = 0.6
    tolerance_m: float = 0.03
    min_inlier_share: float = 0.5
    max_lean: float = 0.2

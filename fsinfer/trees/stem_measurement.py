"""Each stem of a search measured on its own ground, without its neighbours' points: diameter, height, table row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fsinfer.conventions.breast_height import BhRule
from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.processes import shared_out
from fsinfer.progress import Progress, silent
from fsinfer.trees.cylinder.axis import above_level
from fsinfer.trees.diameter.dbh import measure_together
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.ends import COLUMN_M, Ends, ends_of, with_ends
from fsinfer.trees.ground.at_stems import level_std
from fsinfer.trees.ground.ground import Ground
from fsinfer.trees.height import FOOT_M, axis_path, lean_shares, top_may_be_seen, tree_height
from fsinfer.trees.height import INDEX_CELL_M as TOP_CELL_M
from fsinfer.trees.points.cells import PlanIndex, near_paths, rows
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.search.find import StemSearch
from fsinfer.trees.search.giants import is_no_giant
from fsinfer.trees.search.stem import Stem
from fsinfer.trees.search.verify import INDEX_CELL_M
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
#: Stems whose points are held at once, and directions in which the ground round a stem is looked up.
#: Source: numerics.
TOGETHER, FOOT_DIRECTIONS = 16, 16
#: Above and below the heights of the search, metres, points are used too: a stem is measured on its own ground.
#: Source: not recorded.
SLAB_MARGIN_M = 0.5
#: Points this far outside a stem are looked at, metres. Source: not recorded.
BESIDE_M = 0.35
#: Stems whose surfaces are nearer than this share their points out, metres; the same stem found twice, whose axes are
#: nearer than ``SAME_M``, does not. Source: not recorded.
NEIGHBOUR_M, SAME_M = 0.25, 0.05
#: The place at breast height above the ground there and above another stem's level differ by less, metres. Source:
#: geometry; leans of 45 degrees on slopes of 40.
LEANT_M = 1.5
#: The ground's noise over that of the ground level at a stem. Source: not recorded.
GROUND_POINTS_STD = 3.0
#: A stem is rougher than the plot's others beyond so many times their median residual and so many centimetres, where
#: there are enough of them. Source: chosen on simulated double walls.
ROUGHER, ROUGHER_CM, LEAST_STEMS = 1.7, 0.3, 5


#: Points, stems, and the noise of the ground below them, metres, of stems measured together.
_Together = tuple[list[Floats], list[Stem], list[float]]


def measure_stems(
    stand: Floats,
    search: StemSearch,
    ground: Ground,
    settings: TreeSettings,
    scale_rel_std: float,
    origin: Floats,
    *,
    errors: PointErrors | None = None,
    neighbours: Sequence[Stem] = (),
    progress: Progress = silent,
) -> list[tuple[Tree, Section]]:
    """Measure the stems of a search in points (N, 3) of x, y, height above ``ground``, metres about ``origin`` (3,).

    ``errors`` are those of the points, by which they are weighed. ``neighbours`` are stems that are not measured here,
    and have points of their own. The number of a tree is that of its stem in the search, from 0.
    """
    standing = (*search.stems, *neighbours)
    low, high = settings.stems.heights_m
    in_slab = (stand[:, 2] >= low - SLAB_MARGIN_M) & (stand[:, 2] <= high + SLAB_MARGIN_M)
    slab = rows(stand, in_slab)
    index = PlanIndex(slab if errors is None else errors.select(in_slab).beside(slab), INDEX_CELL_M)
    measured = []
    feet = np.array([stem.axis.center_at(0.0) for stem in standing]).reshape(-1, 2)
    radii = np.array([stem.axis.radius_m for stem in standing])
    unsure = level_std(ground, feet, radii)
    levels = [_own_level(stem, ground, settings) for stem in standing]
    placed = [(_on_level(stem, ground, level), level) for stem, level in zip(standing, levels, strict=True)]
    centers = np.array([stem.axis.center_at(settings.bh_m) for stem, _ in placed]).reshape(-1, 2)
    stand_at = np.array([stem.axis.center_at(settings.bh_m) for stem in standing]).reshape(-1, 2)

    highest = float(stand[:, 2].max(initial=0.0))
    slab_m = (low - SLAB_MARGIN_M, high + SLAB_MARGIN_M)
    ends: list[Ends] = []

    def own_points(number: int, beside_m: float) -> Floats:
        """Points of a stem within its radius and so much of its place at breast height, above its level."""
        stem, level = placed[number]
        near = index.near(centers[number], stem.axis.radius_m + beside_m)
        # Heights above the one level that counts for this stem, so that it stays straight on a slope.
        z = near[:, 2] + ground.height_at(near[:, :2]) - level
        near = np.column_stack([near[:, :2], z, near[:, 3:]])
        reach = radii + stem.axis.radius_m + NEIGHBOUR_M + LEANT_M
        beside = np.flatnonzero(np.hypot(*(stand_at - centers[number]).T) <= reach)
        return _without_neighbours(near, stem, [standing[other] for other in beside], ground, level, settings.bh_m)

    def together() -> Iterator[_Together]:
        for first in range(0, len(search.stems), TOGETHER):
            own, noise = [], []
            for number in range(first, min(first + TOGETHER, len(search.stems))):
                stem, _ = placed[number]
                near = own_points(number, BESIDE_M)
                own.append(near)
                # The ends of a stem that leans lie aside of its place at breast height.
                lean = float(np.hypot(*stem.axis.parameters[2:4]))
                aside = lean * max(slab_m[1] - settings.bh_m, settings.bh_m - slab_m[0]) + COLUMN_M
                column = near if aside <= BESIDE_M else own_points(number, aside)
                ends.append(ends_of(column, stem, cloud_top_m=highest, slab_m=slab_m, s=settings.stems))
                noise.append(float(np.hypot(ground.noise_m / GROUND_POINTS_STD, unsure[number])))
            yield own, [stem for stem, _ in placed[first : first + len(own)]], noise

    progress(0, len(search.stems), "measuring stems")
    number = 0
    for sections in shared_out(partial(_sections, settings, scale_rel_std), together()):
        for found in sections:
            section = with_ends(found, ends[number], settings.bh_m)
            if section.dbh_m is None:
                wanted = not is_no_giant(search.stems[number], section.coverage, settings.stems)
            else:
                wanted = 100.0 * section.dbh_m >= settings.min_dbh_cm
            if wanted:
                measured.append((number, *placed[number], section))
            number += 1
        progress(number, len(search.stems), "measuring stems")
    highest_of = {n: highest + _rise_within_reach(stem, level, ground, settings) for n, stem, level, _ in measured}
    tall = [
        (stem, highest_of[number])
        for number, stem, _, section in measured
        if top_may_be_seen(stem, section.dbh_m, highest_of[number], settings=settings.top)
    ]
    crowns = _crowns(stand, tall, settings)
    # A crown that hangs over a slope has its top above other ground than the stem's foot: heights of the cloud again.
    crowns[:, 2] += ground.height_at(crowns[:, :2])
    index = PlanIndex(crowns, TOP_CELL_M)
    pairs = []
    for number, stem, level, section in measured:
        height = tree_height(
            index,
            stem,
            centers,
            number,
            section.dbh_m,
            level_m=level,
            highest_m=highest_of[number],
            bh_m=settings.bh_m,
            settings=settings.top,
        )
        pairs.append((replace(tree_of(section, level, height, origin), tree_id=number), section))
    return pairs


def _sections(settings: TreeSettings, scale_rel_std: float, asked: _Together) -> list[Section]:
    """The sections of some stems on their own ground."""
    own, stems, ground_noise_m = asked
    return measure_together(
        own,
        stems,
        bh_m=settings.bh_m,
        ground_noise_m=ground_noise_m,
        scale_rel_std=scale_rel_std,
        settings=settings.dbh,
        seed=settings.seed,
    )


def _rise_within_reach(stem: Stem, level: float, ground: Ground, settings: TreeSettings) -> float:
    """By how much at most the ground below the stem's crown is higher than ``level``, where its heights count from."""
    reach = settings.top.reach_m + settings.top.crown_radius_m
    return max(_highest_round(stem.axis.center_at(settings.bh_m), reach, ground) - level, 0.0)


def _highest_round(middle: Floats, radius: float, ground: Ground) -> float:
    angle = np.linspace(0.0, 2.0 * np.pi, FOOT_DIRECTIONS, endpoint=False)
    return float(ground.height_at(middle + radius * np.column_stack([np.cos(angle), np.sin(angle)])).max())


def _crowns(stand: Floats, stems: Sequence[tuple[Stem, float]], settings: TreeSettings) -> Floats:
    """A copy of the points above 1 m that may belong to one of the stems, each with the highest that it may reach."""
    if not stems:
        return stand[:0].copy()
    paths = [
        axis_path(stem, highest, bh_m=settings.bh_m, lean_share=lean_share, settings=settings.top)
        for stem, highest in stems
        for lean_share in lean_shares(stem, highest, bh_m=settings.bh_m, settings=settings.top)
    ]
    starts = np.array([low for low, _ in paths]).reshape(-1, 2)
    ends = np.array([high for _, high in paths]).reshape(-1, 2)
    above = rows(stand, stand[:, 2] > FOOT_M)
    return rows(above, near_paths(above, starts, ends, settings.top.crown_radius_m))


def doubt_the_rough(pairs: list[tuple[Tree, Section]], beside: Sequence[Tree] = ()) -> list[tuple[Tree, Section]]:
    """Mark stems much rougher than the others of the plot: double walls too close together to be told apart.

    Those others are ``beside``, too, which were asked before.
    """
    all_trees = (*(tree for tree, _ in pairs), *beside)
    residuals = [tree.residual_cm for tree in all_trees if tree.dbh_cm is not None and tree.residual_cm is not None]
    if len(residuals) < LEAST_STEMS:
        return pairs
    limit = ROUGHER * float(np.median(residuals)) + ROUGHER_CM
    marked = []
    for tree, section in pairs:
        if tree.dbh_cm is not None and tree.residual_cm is not None and tree.residual_cm > limit:
            reasons = (*tree.reasons, notice(StemCode.rougher_than_others, residual_cm=tree.residual_cm))
            tree = replace(tree, status="doubtful", reasons=reasons)
            section = replace(section, status="doubtful", reasons=reasons)
        marked.append((tree, section))
    return marked


def _own_level(stem: Stem, ground: Ground, settings: TreeSettings) -> float:
    """The ground level, z of the cloud, that every height of a tree counts from."""
    foot = stem.axis.center_at(0.0)
    if settings.bh_rule == BhRule.uphill:
        return _highest_round(foot, stem.axis.radius_m, ground)
    return float(ground.height_at(foot[None])[0])


def _on_level(stem: Stem, ground: Ground, level: float) -> Stem:
    """A stem of heights above the ground with heights above ``level``, z of the cloud."""
    axis = stem.axis
    heights = np.array([axis.height_m, stem.bottom_m, stem.top_m])
    places = np.array([axis.center_at(height) for height in heights])
    middle, bottom, top = (heights + ground.height_at(places) - level).tolist()
    gradient = ground.gradient_at(axis.center_at(0.0)[None])[0]
    return replace(stem, axis=above_level(axis, middle, gradient), bottom_m=bottom, top_m=top)


def _without_neighbours(
    near: Floats, stem: Stem, beside: Sequence[Stem], ground: Ground, level: float, bh_m: float
) -> Floats:
    """Drop points that lie closer to the surface of another stem of those ``beside``.

    ``near`` and ``stem`` are above ``level``, the others above the ground.
    """
    keep = np.ones(len(near), dtype=bool)
    own = np.abs(_surface_distance(near, stem))
    center = stem.axis.center_at(bh_m)
    for other in beside:
        reach = other.axis.radius_m + stem.axis.radius_m + NEIGHBOUR_M
        other = _on_level(other, ground, level)
        if SAME_M < np.linalg.norm(other.axis.center_at(bh_m) - center) < reach:
            keep &= own <= np.abs(_surface_distance(near, other))
    return rows(near, keep)


def _surface_distance(points: Floats, stem: Stem) -> Floats:
    p = stem.axis.parameters
    center = p[:2] + p[2:4] * (points[:, 2:3] - stem.axis.height_m)
    return np.asarray(lengths(points[:, :2] - center) - p[4])


def tree_of(section: Section, z_ground: float, height: float | None, origin: Floats) -> Tree:
    """The row of ``trees.csv`` of a section about ``origin`` (3,), in metres; its number is still 0.

    ``z_ground`` is the level that the section's and the tree's height are counted from, z of the cloud.
    """
    blank = Tree(
        tree_id=0,
        x_m=float(section.center[0] + origin[0]),
        y_m=float(section.center[1] + origin[1]),
        z_ground_m=z_ground,
        bh_m=section.bh_m,
        arc_coverage=section.coverage,
        points=section.points,
        residual_cm=100.0 * section.residual_m if np.isfinite(section.residual_m) else None,
        lean_deg=section.lean_deg,
        height_m=height,
        dbh_cm=None,
        dbh_lo95_cm=None,
        dbh_hi95_cm=None,
        dbh_perimeter_cm=None,
        dbh_min_cm=None,
        dbh_max_cm=None,
        status=section.status,
        reasons=section.reasons,
    )
    return with_diameter(blank, section)


def with_diameter(tree: Tree, section: Section) -> Tree:
    """The tree with what ``section`` says of its diameter, how sure that is, and why there is none."""
    dbh = None if section.dbh_m is None else 100.0 * section.dbh_m
    half = 100.0 * section.half95_m
    outline = section.outline if dbh is not None else None
    return replace(
        tree,
        dbh_cm=dbh,
        dbh_lo95_cm=None if dbh is None else max(dbh - half, 0.0),
        dbh_hi95_cm=None if dbh is None else dbh + half,
        dbh_perimeter_cm=None if outline is None else 100.0 * outline.girth_diameter_m,
        dbh_min_cm=None if outline is None else 100.0 * outline.min_diameter_m,
        dbh_max_cm=None if outline is None else 100.0 * outline.max_diameter_m,
        status=section.status,
        reasons=section.reasons,
    )

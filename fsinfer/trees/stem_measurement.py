"""Each stem of a search measured on its own ground, without its neighbours' points: diameter, height, table row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.dbh import measure_together
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.ground.ground import Ground
from fsinfer.trees.height import TopSettings, axis_path, top_may_be_seen, tree_height
from fsinfer.trees.points.cells import PlanIndex, near_paths, rows
from fsinfer.trees.points.sums import lengths
from fsinfer.trees.search.find import StemSearch
from fsinfer.trees.search.stem import Stem
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
TOGETHER = 16  # stems whose points are held at once


def measure_stems(
    stand: Floats,
    search: StemSearch,
    ground: Ground,
    settings: TreeSettings,
    scale_rel_std: float,
    origin: Floats,
) -> list[tuple[Tree, Section]]:
    """Measure the stems of a search in points (N, 3) of x, y, height above ``ground``, metres about ``origin`` (3,)."""
    low, high = settings.stems.heights_m
    slab = rows(stand, (stand[:, 2] >= low - 0.5) & (stand[:, 2] <= high + 0.5))
    index = PlanIndex(slab, settings.stems.index_cell_m)
    centers = np.array([stem.axis.center_at(settings.bh_m) for stem in search.stems]).reshape(-1, 2)
    measured = []
    for first in range(0, len(search.stems), TOGETHER):
        numbers = range(first, min(first + TOGETHER, len(search.stems)))
        own, stems = [], []
        for number in numbers:
            stem = search.stems[number]
            near, stem = _on_own_ground(index.near(centers[number], stem.axis.radius_m + 0.35), stem, ground, settings)
            own.append(_without_neighbours(near, stem, search.stems))
            stems.append(stem)
        sections = measure_together(
            own,
            stems,
            bh_m=settings.bh_m,
            ground_noise_m=ground.noise_m / 3.0,
            scale_rel_std=scale_rel_std,
            settings=settings.dbh,
            seed=settings.seed,
        )
        for number, stem, section in zip(numbers, stems, sections, strict=True):
            if section.dbh_m is None or 100.0 * section.dbh_m >= settings.min_dbh_cm:
                measured.append((number, stem, section))
    highest = float(stand[:, 2].max(initial=0.0))
    tall = [(stem, s) for _, stem, s in measured if top_may_be_seen(stem, s.dbh_m, highest, settings=settings.top)]
    crowns = PlanIndex(_crowns(stand, [stem for stem, _ in tall], highest, settings.top), settings.top.index_cell_m)
    pairs = []
    for number, stem, section in measured:
        height = tree_height(crowns, stem, centers, number, section.dbh_m, highest_m=highest, settings=settings.top)
        z_ground = float(ground.height_at(section.center[None])[0])
        pairs.append((tree_of(section, z_ground, height, origin), section))
    return pairs


def _crowns(stand: Floats, stems: Sequence[Stem], highest: float, settings: TopSettings) -> Floats:
    """Points above 1 m that may belong to one of the stems."""
    if not stems:
        return stand[:0]
    paths = [axis_path(stem, highest, settings=settings) for stem in stems]
    starts = np.array([low for low, _ in paths]).reshape(-1, 2)
    ends = np.array([high for _, high in paths]).reshape(-1, 2)
    above = rows(stand, stand[:, 2] > 1.0)
    return rows(above, near_paths(above, starts, ends, settings.crown_radius_m))


def doubt_the_rough(pairs: list[tuple[Tree, Section]]) -> list[tuple[Tree, Section]]:
    """Mark stems much rougher than the others of the plot: double walls too close together to be told apart."""
    residuals = [tree.residual_cm for tree, _ in pairs if tree.dbh_cm is not None and tree.residual_cm is not None]
    if len(residuals) < 5:
        return pairs
    limit = 1.7 * float(np.median(residuals)) + 0.3
    marked = []
    for tree, section in pairs:
        if tree.dbh_cm is not None and tree.residual_cm is not None and tree.residual_cm > limit:
            doubt = f"residual {tree.residual_cm:.1f} cm, far above the plot's other stems: perhaps a double wall"
            reason = f"{tree.reason}; {doubt}" if tree.reason else doubt
            tree = replace(tree, status="doubtful", reason=reason)
            section = replace(section, status="doubtful", reason=reason)
        marked.append((tree, section))
    return marked


def _on_own_ground(near: Floats, stem: Stem, ground: Ground, settings: TreeSettings) -> tuple[Floats, Stem]:
    """Heights above the one ground level that counts for this stem, so that its axis stays straight on a slope."""
    foot = stem.axis.center_at(0.0)
    level = float(ground.height_at(foot[None])[0])
    reference = level
    if settings.bh_rule == "uphill":
        angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
        ring = foot + stem.axis.radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
        reference = float(ground.height_at(ring).max())
    z = near[:, 2] + ground.height_at(near[:, :2]) - reference
    shift = reference - level
    axis = replace(stem.axis, height_m=stem.axis.height_m - shift)
    moved = replace(stem, axis=axis, bottom_m=stem.bottom_m - shift, top_m=stem.top_m - shift)
    return np.column_stack([near[:, :2], z]), moved


def _without_neighbours(near: Floats, stem: Stem, stems: tuple[Stem, ...]) -> Floats:
    """Drop points that lie closer to the surface of another stem."""
    keep = np.ones(len(near), dtype=bool)
    own = np.abs(_surface_distance(near, stem))
    for other in stems:
        gap = np.linalg.norm(other.axis.center_at(1.3) - stem.axis.center_at(1.3))
        if 0.05 < gap < other.axis.radius_m + stem.axis.radius_m + 0.25:
            keep &= own <= np.abs(_surface_distance(near, other))
    return rows(near, keep)


def _surface_distance(points: Floats, stem: Stem) -> Floats:
    p = stem.axis.parameters
    center = p[:2] + p[2:4] * (points[:, 2:3] - stem.axis.height_m)
    return np.asarray(lengths(points[:, :2] - center) - p[4])


def tree_of(section: Section, z_ground: float, height: float | None, origin: Floats) -> Tree:
    """The row of ``trees.csv`` of a section about ``origin`` (3,), in metres; its number is still 0."""
    return Tree(
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
        **diameter_columns(section),
    )


def diameter_columns(section: Section) -> dict[str, Any]:
    """The fields of :class:`Tree` that say what the diameter is, how sure, and why there is none."""
    dbh = None if section.dbh_m is None else 100.0 * section.dbh_m
    half = 1.96 * 100.0 * section.sd_m
    outline = section.outline if dbh is not None else None
    return {
        "dbh_cm": dbh,
        "dbh_lo95_cm": None if dbh is None else max(dbh - half, 0.0),
        "dbh_hi95_cm": None if dbh is None else dbh + half,
        "dbh_perimeter_cm": None if outline is None else 100.0 * outline.girth_diameter_m,
        "dbh_min_cm": None if outline is None else 100.0 * outline.min_diameter_m,
        "dbh_max_cm": None if outline is None else 100.0 * outline.max_diameter_m,
        "status": section.status,
        "reason": section.reason,
    }

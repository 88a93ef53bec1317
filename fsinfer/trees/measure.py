"""From a cloud to the stand table: ground, stems, diameters, heights, and why there is none where there is none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fsinfer.conventions.breast_height import BREAST_HEIGHTS_M, BhRule
from fsinfer.errors import CloudError
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.progress import Progress, silent
from fsinfer.threads import one_blas_thread
from fsinfer.trees.common_lean import common_lean
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.ends import without_stumps
from fsinfer.trees.ground.at_stems import is_layer, shows_ground
from fsinfer.trees.ground.ground import Ground, find_ground
from fsinfer.trees.level_cut import without_cut_tops
from fsinfer.trees.one_entry import one_entry_a_stem
from fsinfer.trees.points.cells import BOX_MARGIN_M, BOX_PERCENTILES, rows
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.points.sums import median
from fsinfer.trees.sanity import (
    BOX_POINTS,
    MIDDLE_PERCENTILES,
    TURNED_POINTS,
    TURNS,
    TurnedCloudError,
    all_thick,
    as_numbers,
    check_unit,
    clean,
    finite_points,
    may_be_upside_down,
    thicker_upwards,
    thin_upwards,
    turned_message,
)
from fsinfer.trees.search.find import LEAST_POINTS, StemSearch, find_stems
from fsinfer.trees.search.stem import Stem
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.shape_doubts import allow_for_shape
from fsinfer.trees.stand import SeenCells, StandTable, near_ground, seen_cells, seen_share, stand_table
from fsinfer.trees.stem_measurement import doubt_the_rough, measure_stems
from fsinfer.trees.thickets import without_thickets
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
#: What is said of how high a cloud reaches: this percentile, for the sake of strays. Source: layout.
TOP_PERCENTILE = 99.9
#: What lies so far above or below the rest belongs to no plot, metres. Source: judgement; higher than any slope.
FAR_UP_M = 1e4


@dataclass(frozen=True, kw_only=True)
class FoundStem:
    """A stem of the search in the frame of the cloud, and the number of its tree; None where it is no tree's."""

    stem: Stem
    tree_id: int | None


@dataclass(frozen=True, kw_only=True)
class PlotResult:
    """Trees with their sections (same order), the ground, and what the forester should know.

    ``diagnosis`` says what was found, or why nothing was. ``extent_m`` is x_min, y_min, x_max, y_max.
    With ``units_per_m`` the scale is unknown: positions and ``extent_m`` are in model units, of which so many are
    guessed to make a metre, and the sections are in metres by that guess. ``joined`` are stems of other parts of the
    walk, which were measured there: they have no section here. ``seen_ground`` are the cells of which ``plot_area_m2``
    is the area; None where it is not known. ``stems`` are all that the search found, in metres like the ground, whether
    or not they are trees (any more). ``cut_level_m`` is the z at which the cloud was cut off level in the crowns, at
    which no tree has its top, in metres like the ground; None where it was not.
    """

    trees: tuple[Tree, ...]
    sections: tuple[Section, ...]
    ground: Ground | None
    diagnosis: Notice
    warnings: tuple[Notice, ...]
    extent_m: tuple[float, float, float, float]
    spacing_m: float
    plot_area_m2: float = 0.0
    units_per_m: float | None = None
    joined: tuple[Tree, ...] = ()
    seen_ground: SeenCells | None = None
    stems: tuple[FoundStem, ...] = ()
    cut_level_m: float | None = None

    @property
    def all_trees(self) -> tuple[Tree, ...]:
        """The trees, and those that other parts of the walk measured."""
        return (*self.trees, *self.joined)

    @property
    def stand(self) -> StandTable:
        """Stems and basal area a hectare on ``plot_area_m2``, the area where ground was seen; none outside the walk."""
        counted = [tree for tree in self.all_trees if not tree.outside]
        places = np.array([[tree.x_m, tree.y_m] for tree in counted]).reshape(-1, 2)
        on_area = None if self.seen_ground is None else self.seen_ground.at(places)
        return stand_table(counted, self.plot_area_m2, on_area=on_area)


@one_blas_thread()
def measure_trees(
    points: ArrayLike,
    *,
    settings: TreeSettings | None = None,
    scale_rel_std: float = 0.0,
    metric: bool = True,
    units_per_m_hint: float | None = None,
    errors: PointErrors | None = None,
    progress: Progress = silent,
) -> list[Tree]:
    """Measure the trees in points (N, 3), metres, z up; see :func:`analyse_plot`."""
    result = analyse_plot(
        points,
        settings=settings,
        scale_rel_std=scale_rel_std,
        metric=metric,
        units_per_m_hint=units_per_m_hint,
        errors=errors,
        progress=progress,
    )
    return list(result.trees)


@one_blas_thread()
def analyse_plot(
    points: ArrayLike,
    *,
    settings: TreeSettings | None = None,
    scale_rel_std: float = 0.0,
    metric: bool = True,
    units_per_m_hint: float | None = None,
    progress: Progress = silent,
    turned: bool = False,
    errors: PointErrors | None = None,
    vouched: bool = False,
) -> PlotResult:
    """Find the ground and the stems in points (N, 3), metres, z up, and measure each stem.

    ``scale_rel_std`` is the relative standard deviation of the cloud's scale; it widens the intervals. With
    ``metric=False`` the unit is unknown: stems are looked for with ``units_per_m_hint`` units to the metre (a rough
    guess by the caller, for instance from the height at which the camera was held; 1 without one), positions stay in
    model units and no DBH is given. No trees is a valid result: ``diagnosis`` says why. ``turned`` says that z is
    known to point up; without it a cloud with no measurable stem is looked at from its other sides. ``errors``
    (``PointErrors.of(cloud)``) are what a cloud of photographs tells of its points, by which those of a stem are
    weighed. ``vouched``: something else than the stems tells the metre, so that thick ones are what they are.

    Raises :class:`~fsinfer.errors.CloudError` for clouds that hold no plot (too few points, no ground, wrong unit) and
    for a breast height or an error of the scale that is none, and its subclass
    :class:`~fsinfer.trees.sanity.TurnedCloudError` for a cloud that would be a plot if it were turned.
    """
    settings = settings or TreeSettings()
    if settings.bh_rule not in tuple(BhRule):
        msg = f"bh_rule must be {' or '.join(repr(rule.value) for rule in BhRule)}, got {settings.bh_rule!r}"
        raise CloudError(msg)
    least_m, most_m = BREAST_HEIGHTS_M
    if not least_m <= settings.bh_m <= most_m:
        msg = f"bh_m is {settings.bh_m:g}; give breast height in metres, {least_m:g} to {most_m:g}"
        raise CloudError(msg)
    if not 0.0 <= scale_rel_std < math.inf:
        msg = f"scale_rel_std is {scale_rel_std}; give the relative standard deviation of the scale, 0 or more"
        raise CloudError(msg)
    if not metric:
        return _without_scale(points, settings, units_per_m_hint, progress, turned=turned)
    result = _analysed(points, settings, scale_rel_std, progress, turned=turned, all_sides=not turned, errors=errors)
    if vouched:
        return result
    sure_cm = [tree.dbh_cm for tree in result.trees if tree.status == "ok" and tree.dbh_cm is not None]
    return replace(result, warnings=(*result.warnings, *all_thick(sure_cm, settings.sanity)))


def _analysed(
    points: ArrayLike,
    settings: TreeSettings,
    scale_rel_std: float,
    progress: Progress,
    *,
    turned: bool,
    all_sides: bool,
    errors: PointErrors | None = None,
) -> PlotResult:
    """:func:`analyse_plot` in metres; ``all_sides``: a cloud with no measurable stem is looked at from its others."""
    xyz, warnings = clean(points, settings.sanity)
    if errors is not None and len(errors) != len(xyz):
        errors = errors.select(finite_points(as_numbers(points)))
    # Work about a local origin: map coordinates of 10^6 m would cost precision in the fits.
    few = np.ascontiguousarray(xyz[:: max(len(xyz) // BOX_POINTS, 1), :2].T)
    origin = np.floor([median(few[0]), median(few[1]), 0.0])
    # Column by column in memory, which is how it is looked at.
    columns = np.empty((3, len(xyz)))
    for axis in range(3):
        np.subtract(xyz[:, axis], origin[axis], out=columns[axis])
    box = np.percentile(few, BOX_PERCENTILES, axis=1) - origin[:2]
    check_unit(box, settings.sanity)
    near = near_plot(columns.T, box)
    if not near.all():
        warnings.append(notice(StemCode.far_outside, points=int((~near).sum())))
        columns = columns.compress(near, axis=1)
        errors = None if errors is None else errors.select(near)
    local = columns.T
    extent = box + origin[:2]
    middle = np.percentile(few, MIDDLE_PERCENTILES, axis=1) - origin[:2]
    progress(0, 1, "finding the ground")
    ground = find_ground(local, settings=settings.ground, seed=settings.seed)
    on_head = not turned and may_be_upside_down(local, ground, settings.ground, settings.sanity, seed=settings.seed)
    if ground.share < settings.sanity.min_ground:
        warnings.append(notice(StemCode.ground_in_part, percent=100.0 * ground.share))
    stand = np.stack([*columns[:2], columns[2] - ground.height_at(local[:, :2])]).T
    search = find_stems(
        stand,
        bh_m=settings.bh_m,
        settings=settings.stems,
        progress=progress,
        seed=settings.seed,
        gradient_at=ground.gradient_at,
    )
    low = near_ground(stand, 0.0)
    # Stems that are seen from above their feet would be their own ground.
    feet = np.array([stem.axis.center_at(0.0) for stem in search.stems]).reshape(-1, 2)
    radii = np.array([stem.axis.radius_m for stem in search.stems])
    low = rows(low, shows_ground(low, feet, radii))
    if not is_layer(stand, feet, radii):
        # What was taken for ground are the lowest branches: nobody knows how far below them it is.
        ground = replace(ground, cells=np.zeros((0, 3)))
        warnings.append(notice(StemCode.little_ground))
    elif seen_share(low, middle) < settings.sanity.little_ground:
        warnings.append(notice(StemCode.little_ground))
    if search.spacing_m > settings.sanity.far_apart_m:
        warnings.append(notice(StemCode.far_apart, spacing_cm=100.0 * search.spacing_m))
    measured = measure_stems(stand, search, ground, settings, scale_rel_std, origin, errors=errors, progress=progress)
    uncut = without_cut_tops(measured, local)
    warnings += uncut.told
    measured, stumps = without_stumps(uncut.pairs)
    measured, thickets = without_thickets(measured)
    pairs, same = one_entry_a_stem(measured)
    warnings += (*stumps, *thickets, *same)
    pairs = doubt_the_rough(allow_for_shape(pairs, settings=settings))
    warnings += common_lean([tree for tree, _ in pairs], [section for _, section in pairs], settings=settings.lean)
    # On the side of a cloud that lies, a surface may be followed and something on it be measured, but nothing soundly.
    in_part = ground.share < settings.sanity.min_ground
    sure = sum(tree.status == "ok" for tree, _ in pairs)
    sound = sure >= settings.sanity.turned_trees if in_part else any(tree.dbh_cm is not None for tree, _ in pairs)
    tapers = _tapers([section for _, section in pairs])
    if on_head:
        if not thin_upwards(tapers, settings.sanity):
            raise TurnedCloudError(*TURNS[-1])
        warnings.append(notice(StemCode.level_top))
    if not turned and thicker_upwards(tapers, settings.sanity):
        warnings.append(notice(StemCode.thicker_upwards, stems=len(tapers)))
    if all_sides and not sound:
        _check_turned(local, settings)
    centers = np.array([[tree.x_m, tree.y_m] for tree, _ in pairs]).reshape(-1, 2)
    seen = seen_cells(low)
    seen = replace(seen, corner=seen.corner + origin[:2])
    number_of = {tree.tree_id: number for number, (tree, _) in enumerate(pairs, start=1)}
    return PlotResult(
        trees=tuple(replace(tree, tree_id=number) for number, (tree, _) in enumerate(pairs, start=1)),
        sections=tuple(section for _, section in pairs),
        ground=ground.moved(origin[:2]),
        diagnosis=_diagnosis([tree for tree, _ in pairs], search, stand, settings),
        warnings=tuple(warnings),
        extent_m=(float(extent[0, 0]), float(extent[0, 1]), float(extent[1, 0]), float(extent[1, 1])),
        spacing_m=search.spacing_m,
        plot_area_m2=seen.area(centers),
        seen_ground=seen,
        stems=tuple(
            FoundStem(stem=stem.moved(origin[:2]), tree_id=number_of.get(n)) for n, stem in enumerate(search.stems)
        ),
        cut_level_m=uncut.level_m,
    )


def near_plot(points: Floats, box: Floats) -> NDArray[np.bool_]:
    """Which of points (N, 3) belong to a plot whose ``box`` (2, 2) are its least and its greatest x, y; metres.

    A single point a kilometre away must not blow up the rasters.
    """
    margin = 0.5 * float(np.max(box[1] - box[0])) + BOX_MARGIN_M
    near = np.ones(len(points), dtype=bool)
    for axis in range(2):
        near &= np.abs(points[:, axis] - box[:, axis].mean()) <= 0.5 * np.ptp(box[:, axis]) + margin
    middle = median(np.ascontiguousarray(points[:: max(len(points) // BOX_POINTS, 1), 2]))
    return near & (np.abs(points[:, 2] - middle) <= FAR_UP_M)


def _check_turned(points: Floats, settings: TreeSettings) -> None:
    """Raise where stems stand along another axis than z: clouds of computer graphics are y up."""
    sanity = settings.sanity
    few = points[:: max(len(points) // TURNED_POINTS, 1)]
    seen: list[tuple[float, str, Floats]] = []
    for how, turn in TURNS:
        try:
            result = analyse_plot(few @ turn.T, settings=settings, turned=True)
        except CloudError:
            continue
        if (
            result.ground is not None
            and may_be_upside_down(few @ turn.T, result.ground, settings.ground, sanity, seed=settings.seed)
            and not thin_upwards(_tapers(result.sections), sanity)
        ):
            continue
        sound = sum(t.status == "ok" and (t.dbh_cm or 0.0) <= sanity.max_turned_cm for t in result.trees)
        if sound >= sanity.turned_trees and result.ground is not None:
            seen.append((result.ground.share * result.ground.reach, how, turn))
    if not seen:
        return
    # Stems stand along their axis both ways; the ground lies at one end of them.
    seen.sort(key=lambda item: -item[0])
    (ground, how, turn), *others = seen
    if others and ground < sanity.turned_ground * others[0][0]:
        raise CloudError(turned_message(" or ".join(name for _, name, _ in seen)))
    raise TurnedCloudError(how, turn)


def _tapers(sections: Sequence[Section]) -> list[float]:
    return [section.taper for section in sections if section.dbh_m is not None]


def trees_found(trees: Sequence[Tree]) -> Notice:
    """How many there are inside the walk and how many of them have a DBH."""
    counted = [tree for tree in trees if not tree.outside]
    measured = sum(tree.dbh_cm is not None for tree in counted)
    return notice(StemCode.trees_found, trees=len(counted), measured=measured)


def _diagnosis(trees: list[Tree], search: StemSearch, stand: Floats, settings: TreeSettings) -> Notice:
    if trees:
        return trees_found(trees)
    low, high = settings.stems.heights_m
    slab = int(np.count_nonzero((stand[:, 2] >= low) & (stand[:, 2] <= high)))
    if slab < LEAST_POINTS:
        top = float(np.percentile(stand[:, 2], TOP_PERCENTILE))
        return notice(StemCode.none_at_stem_height, low_m=low, high_m=high, top_m=top)
    by_count = sorted(search.rejected.items(), key=lambda item: -item[1])
    if by_count:
        rejected = tuple(notice(why, count=count) for why, count in by_count)
        return notice(StemCode.none_holds, candidates=search.candidates, rejected=rejected)
    return notice(StemCode.none_round, points=slab)


def _without_scale(
    points: ArrayLike,
    settings: TreeSettings,
    units_per_m_hint: float | None,
    progress: Progress,
    *,
    turned: bool,
) -> PlotResult:
    xyz = as_numbers(points)
    units = 1.0 if units_per_m_hint is None else units_per_m_hint
    if not (np.isfinite(units) and units > 0):
        msg = f"units_per_m_hint must be a positive number, got {units_per_m_hint}"
        raise CloudError(msg)
    # By a size that was guessed nobody can tell stems of other sides; which way up those are that it finds, it can.
    result = _analysed(xyz / units, settings, 0.0, progress, turned=turned, all_sides=False)
    trees = [
        replace(
            tree,
            x_m=tree.x_m * units,
            y_m=tree.y_m * units,
            z_ground_m=tree.z_ground_m * units,
            dbh_cm=None,
            dbh_lo95_cm=None,
            dbh_hi95_cm=None,
            dbh_perimeter_cm=None,
            dbh_min_cm=None,
            dbh_max_cm=None,
            residual_cm=None,
            height_m=None,
            status="unmeasured",
            reasons=(notice(StemCode.no_scale),),
        )
        for tree in result.trees
    ]
    x_min, y_min, x_max, y_max = (units * value for value in result.extent_m)
    return replace(
        result,
        trees=tuple(trees),
        diagnosis=trees_found(trees) if trees else result.diagnosis,
        warnings=(*result.warnings, notice(StemCode.model_units)),
        extent_m=(x_min, y_min, x_max, y_max),
        plot_area_m2=0.0,
        seen_ground=None,
        units_per_m=units,
    )

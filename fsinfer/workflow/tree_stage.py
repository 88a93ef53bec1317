"""The tree stage: find the stems, drop the posts of markers, apply edits, look at the photographs, write everything."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.plots import PlotCode
from fsinfer.placement.settings import LevelSettings
from fsinfer.plot_border.place import place_border
from fsinfer.plot_border.plot import PlotFigures, Upright, plot_of, stem_circles
from fsinfer.plot_border.request import BorderRequest
from fsinfer.plot_border.rows import figure_rows
from fsinfer.plot_border.sight import Cameras, seen_share
from fsinfer.processes import MOST_WORKERS, worker_processes
from fsinfer.progress import Progress, silent
from fsinfer.scale.doubts import doubt_height
from fsinfer.scale.scale import CAMERA_HEIGHT_M
from fsinfer.silhouettes.join import StemPhotos, measure_silhouettes, write_sources
from fsinfer.silhouettes.join_settings import SilhouetteJoinSettings
from fsinfer.silhouettes.tops import TopViewSettings, heights_in_view
from fsinfer.silhouettes.walk import WalkSettings, apart_from_walk, camera_places
from fsinfer.threads import cores
from fsinfer.trees import PlotResult, TreeSettings, analyse_plot
from fsinfer.trees.edit_rows import TreeEdit
from fsinfer.trees.edited_trees import of_these_trees
from fsinfer.trees.edits import apply_edits
from fsinfer.trees.forks import forks
from fsinfer.trees.outputs.labels import label_points
from fsinfer.trees.outputs.maps import write_maps
from fsinfer.trees.outputs.reasons import write_reasons
from fsinfer.trees.outputs.table import write_trees
from fsinfer.trees.outputs.workbook import write_tables
from fsinfer.trees.pattern.match import PatternSettings
from fsinfer.trees.plot_doubt import all_doubtful
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.posts import without_posts
from fsinfer.trees.stand import sizes_unknown
from fsinfer.trees.stem_curve import CurvePoint, CurveSettings, stem_curves, write_curves
from fsinfer.workflow.given_edits import stood_before
from fsinfer.workflow.joined_parts import JoinedParts, cameras_of, copy_figures, join_measured
from fsinfer.workflow.own_files import clear_outputs
from fsinfer.workflow.trees_result import TreesResult, summarized

#: Points of a cloud from which on processes save more than the second they take to start. Source: numerics; of the
#: demo's 700,000 trees and report take 14 instead of 17 s.
_SHARED_FROM = 300_000
#: What the processes have to load, while the stems are being found.
_WORKED_WITH = ("fsinfer.silhouettes.join", "fsinfer.trees.outputs.figures", "matplotlib.backends.backend_agg")


@dataclass(frozen=True, kw_only=True)
class PlotCloudInput:
    """A cloud to be measured and what is known of it.

    Attributes
    ----------
    cloud: z up; metres, or model units with ``metric=False``: then the trees get positions and no DBH.
    metric: whether the unit is the metre.
    scale_rel_std: relative standard deviation of the scale; it widens every interval.
    camera_height: median height of the cameras above the ground, in units of the cloud; a person holds a camera at
        about 1.5 m, which tells roughly how large the trees are while the scale is unknown.
    marker_xyz: (M, 3) centres of the markers in the photographs: see :func:`fsinfer.trees.posts.without_posts`.
    marker_numbers: (M,) their numbers, for a border round one of them.
    epsg: code of the cloud's horizontal frame; None for local metres.
    frame_of: the LAS or LAZ file whose header names the cloud's frame; None where it is in none, or was moved.
    photos: those the cloud was made of; the stems' edges in them make the diameters sharper (metres only).
    edits: corrections by hand (:mod:`fsinfer.trees.edits`), applied to what was found.
    parts: folders of parts of the walk that were measured apart; their stems are put into this plot where their pattern
        tells how (metres only).
    doubt: why no stem of this cloud is sure, if there is a reason.
    write_labelled: writes ``trees.laz`` instead, for a cloud of which only a part is in memory.
    unit: of the cloud, that one of its scene or its file makes: trees are known again in a cloud of another scale.
    """

    cloud: PointCloud
    metric: bool = True
    scale_rel_std: float = 0.0
    camera_height: float | None = None
    marker_xyz: NDArray[np.float64] | None = None
    marker_numbers: tuple[int, ...] = ()
    epsg: int | None = None
    frame_of: Path | None = None
    photos: StemPhotos | None = None
    edits: Sequence[TreeEdit] = ()
    parts: Sequence[Path] = ()
    doubt: Notice | None = None
    write_labelled: Callable[[Path, PlotResult], None] | None = None
    unit: float = 1.0

    @property
    def errors(self) -> PointErrors | None:
        """What the cloud tells of its points, where it is one of photographs in metres."""
        return PointErrors.of(self.cloud) if self.metric else None


@dataclass(frozen=True, kw_only=True)
class TreeStageSettings:
    """Of the measurement in the cloud, the edges in the photographs, the stem curves, the borders of plot and walk."""

    trees: TreeSettings = field(default_factory=TreeSettings)
    silhouettes: SilhouetteJoinSettings = field(default_factory=SilhouetteJoinSettings)
    stem_curve: CurveSettings = field(default_factory=CurveSettings)
    border: BorderRequest = field(default_factory=BorderRequest)
    walk: WalkSettings = field(default_factory=WalkSettings)
    tops: TopViewSettings = field(default_factory=TopViewSettings)
    pattern: PatternSettings = field(default_factory=PatternSettings)


def measure_plot(
    given: PlotCloudInput, out: Path, *, settings: TreeStageSettings | None = None, progress: Progress = silent
) -> TreesResult:
    """Measure the trees of a cloud and write table, maps, labelled points and figures into ``out``.

    ``out`` receives ``trees.csv``, ``trees.json`` (the reasons as codes) and ``figures/*.png``, and in metres
    ``trees.gpkg`` (``trees.geojson`` too where the frame's place on earth is known) and ``trees.laz``, the cloud with a
    ``TreeID``, ``stem_curve.csv`` and ``trees.xlsx`` (all tables as sheets, that of the plot where it has a border),
    with photographs also ``dbh_sources.csv`` and ``figures/*_edges.png``; what an earlier measurement left is removed.
    The work is shared out over processes (:mod:`fsinfer.processes`).

    Raises
    ------
    CloudError
        The cloud holds no plot: too few points, no ground, or a size that cannot be in metres.
    """
    settings = settings or TreeStageSettings()
    if given.photos is not None and given.metric:
        # Two walls of a cloud of photographs are poses that do not agree: then the edges tell more than the points.
        trees = replace(settings.trees, dbh=replace(settings.trees.dbh, most_walls_m=0.0))
        settings = replace(settings, trees=trees)
    with tree_workers(len(given.cloud.xyz)):
        return _measure_plot(given, out, settings, progress)


def _measure_plot(given: PlotCloudInput, out: Path, settings: TreeStageSettings, progress: Progress) -> TreesResult:
    found, posts = _find(given, settings, progress)
    edited = _edit(found, given, settings, posts, out)
    clear_outputs(out)
    measured = _look_at_photos(edited, given, out, settings, found=found, progress=progress)
    if given.metric:
        measured = replace(measured, warnings=(*measured.warnings, *forks(measured.trees, measured.sections)))
    curves: dict[int, tuple[CurvePoint, ...]] = {}
    if given.metric:
        curves = stem_curves(
            given.cloud.xyz, measured, settings=settings.stem_curve, errors=given.errors, progress=progress
        )
    whole, added = join_measured(
        measured,
        given.parts if given.metric else (),
        settings=settings.pattern,
        ground=settings.trees.ground,
        walk=settings.walk,
        gone=sorted(set(found.trees) - set(edited.trees), key=lambda tree: tree.tree_id),
    )
    if given.doubt is not None:
        whole = all_doubtful(whole, given.doubt)
    bordered, plot = _draw_border(whole, given, settings, added, out)
    if given.metric:
        bordered = replace(bordered, warnings=(*bordered.warnings, *_sizes_unknown(bordered, plot)))
    _write(bordered, given, out, curves, plot, progress)
    copy_figures(out, bordered, added.numbers)
    return replace(summarized(bordered, plot), joined=added.parts)


def _sizes_unknown(result: PlotResult, plot: PlotFigures | None) -> tuple[Notice, ...]:
    """What is to be told of the trees that a basal area a hectare counts; nothing where there is no such figure."""
    if plot is not None:
        within = [tree for tree in result.all_trees if tree.in_plot]
        return sizes_unknown(within) if plot.basal_area_m2_per_ha is not None else ()
    stand = result.stand
    if stand.basal_area_m2_per_ha is None:
        return ()
    return sizes_unknown([tree for tree in result.all_trees if not tree.outside], stand.off_area)


def tree_workers(points: int, threads: int = 0) -> AbstractContextManager[None]:
    """Processes for what is done of the trees in a cloud of so many ``points``; none where they are few.

    There are no more than ``threads`` of them; 0 is as many as there are cores, up to four.
    """
    count = min(threads or cores(), cores(), MOST_WORKERS) if points >= _SHARED_FROM else 1
    return worker_processes(_WORKED_WITH, count=count)


def no_trees(out: Path, *, reason: Notice) -> TreesResult:
    """Write an empty ``trees.csv`` where measuring is impossible."""
    write_trees(out / "trees.csv", [])
    write_reasons(out / "trees.json", [])
    clear_outputs(out)
    return TreesResult(diagnosis=reason, warnings=(reason,))


def _find(given: PlotCloudInput, settings: TreeStageSettings, progress: Progress) -> tuple[PlotResult, frozenset[int]]:
    """The stems of the cloud, without the posts of markers, and the numbers that those had."""
    height = given.camera_height
    hint = None if height is None or height <= 0 else height / CAMERA_HEIGHT_M
    result = analyse_plot(
        given.cloud.xyz,
        settings=settings.trees,
        scale_rel_std=given.scale_rel_std,
        metric=given.metric,
        units_per_m_hint=None if given.metric else hint,
        turned=height is not None,
        errors=given.errors,
        progress=progress,
        vouched=height is not None and not doubt_height(height),  # a camera held as people hold them
    )
    if given.marker_xyz is None or not given.metric:
        return result, frozenset()
    kept = without_posts(result, given.marker_xyz)
    return kept, frozenset(tree.tree_id for tree in result.trees) - {tree.tree_id for tree in kept.trees}


def _edit(
    found: PlotResult, given: PlotCloudInput, settings: TreeStageSettings, posts: frozenset[int], out: Path
) -> PlotResult:
    """The stem map as corrected by hand."""
    # Who deleted a post by hand, before its board was known, has what was wanted.
    edits = [edit for edit in given.edits if edit.action != "delete" or edit.tree_id not in posts]
    stood = stood_before(out, edits, found.trees, given.unit)
    edits, told = of_these_trees(edits, found.trees, stood, unit=found.units_per_m or 1.0)
    found = replace(found, warnings=(*found.warnings, *told))
    if not edits:
        return found
    return apply_edits(
        found,
        given.cloud.xyz,
        edits,
        settings=settings.trees,
        scale_rel_std=given.scale_rel_std,
        metric=given.metric,
        errors=given.errors,
        parts=[folder.name for folder in given.parts],
    )


def _look_at_photos(
    result: PlotResult,
    given: PlotCloudInput,
    out: Path,
    settings: TreeStageSettings,
    *,
    found: PlotResult,
    progress: Progress,
) -> PlotResult:
    """Diameters joined with those of the stems' edges in the photographs, where there are any."""
    if given.photos is None or not given.metric:
        return result
    photos, by_cloud = given.photos, set(found.trees)
    by_hand = frozenset(tree.tree_id for tree in result.trees if tree not in by_cloud)  # a person knows better
    cameras = camera_places(photos.scene, photos.cloud_from_scene)

    def look(stems: PlotResult) -> PlotResult:
        return measure_silhouettes(
            stems,
            photos,
            scale_rel_std=given.scale_rel_std,
            dbh=settings.trees.dbh,
            settings=settings.silhouettes,
            figures=out / "figures",
            kept=by_hand,
            cloud_xyz=given.cloud.xyz,
            progress=progress,
        )

    def apart(stems: PlotResult) -> PlotResult:
        return apart_from_walk(stems, cameras, settings=settings.walk, kept=by_hand)

    if settings.walk.measure_far:
        joined = apart(look(result))
    else:
        near, beyond = _parted(apart(result))
        seen = look(near)
        joined = replace(seen, trees=(*seen.trees, *beyond.trees), sections=(*seen.sections, *beyond.sections))
    write_sources(out / "dbh_sources.csv", joined)
    return heights_in_view(joined, photos.scene, photos.cloud_from_scene, settings=settings.tops)


def _draw_border(
    result: PlotResult, given: PlotCloudInput, settings: TreeStageSettings, added: JoinedParts, out: Path
) -> tuple[PlotResult, PlotFigures | None]:
    """The trees sorted by the plot's border, and its figures; None where there is no border or it cannot be placed."""
    request = settings.border
    if not request.given or result.ground is None:
        return result, None
    if not given.metric:
        return _without_border(result, notice(PlotCode.no_metres)), None
    photos = given.photos
    own = () if photos is None else (Cameras(scene=photos.scene, cloud_from_scene=photos.cloud_from_scene),)
    cameras = (*own, *cameras_of(out, added.parts)) if own else ()
    centers = [] if given.marker_xyz is None else [(float(x), float(y)) for x, y, _ in given.marker_xyz]
    border = place_border(
        request,
        cameras_xy=np.concatenate([part.places[:, :2] for part in cameras]) if cameras else None,
        markers=list(zip(given.marker_numbers, centers, strict=True)),
    )
    if isinstance(border, Notice):
        return _without_border(result, border), None
    trees = result.all_trees
    ground_of_parts = np.column_stack([added.ground_xy, result.ground.height_at(added.ground_xy)])
    points = np.concatenate([given.cloud.xyz, ground_of_parts]) if len(added.ground_xy) else given.cloud.xyz
    seen = seen_share(border, points, result.ground, stem_circles(trees), cameras=cameras)
    # The z of a cloud without photographs is what its owner says.
    up_rad = 0.0 if photos is None else float(np.radians(LevelSettings().camera_floor_deg))
    upright = Upright(std_rad=up_rad, z_m=float(result.ground.height_at(np.array([border.middle]))[0]))
    plot = plot_of(
        trees,
        border,
        seen,
        slope_deg=result.ground.slope_deg,
        scale_rel_std=given.scale_rel_std,
        # What another part measured has its budget there.
        shared_m=np.array([*(section.shared_sd_m for section in result.sections), *([np.nan] * len(result.joined))]),
        upright=upright,
    )
    told = (*result.warnings, *plot.warnings)
    count = len(result.trees)
    return replace(result, trees=plot.trees[:count], joined=plot.trees[count:], warnings=told), plot.figures


def _without_border(result: PlotResult, why: Notice) -> PlotResult:
    return replace(result, warnings=(*result.warnings, notice(PlotCode.border_not_placed, why=why)))


def _parted(result: PlotResult) -> tuple[PlotResult, PlotResult]:
    """The stems of the walk, and those outside of it."""
    parts = []
    for outside in (False, True):
        pairs = [pair for pair in zip(result.trees, result.sections, strict=True) if pair[0].outside == outside]
        trees, sections = tuple(tree for tree, _ in pairs), tuple(section for _, section in pairs)
        parts.append(replace(result, trees=trees, sections=sections))
    return parts[0], parts[1]


def _write(
    result: PlotResult,
    given: PlotCloudInput,
    out: Path,
    curves: dict[int, tuple[CurvePoint, ...]],
    plot: PlotFigures | None,
    progress: Progress,
) -> None:
    """Tables, figures, maps and labelled points."""
    from fsinfer.trees.outputs.figures import write_figures  # loads matplotlib

    write_trees(out / "trees.csv", result.all_trees)
    write_reasons(out / "trees.json", result.all_trees)
    border = None if plot is None else plot.border.outline
    write_figures(out / "figures", result, curves=curves, border=border, progress=progress)
    progress(0, 1, "writing trees")
    if not given.metric:
        return
    write_curves(out / "stem_curve.csv", curves.values())
    write_tables(out / "trees.xlsx", result, curves, plot=() if plot is None else figure_rows(plot))
    write_maps(out, result.all_trees, epsg=given.epsg)
    if given.write_labelled is not None:
        given.write_labelled(out / "trees.laz", result)
        return
    labels = label_points(given.cloud.xyz, result)
    labelled = replace(given.cloud, extra=given.cloud.extra | {"TreeID": labels})
    write_cloud(out / "trees.laz", labelled, frame_of=given.frame_of)

"""``fsinfer trees``: the trees of a cloud file of any origin, and of any size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from fsinfer.depth.maps import maps_digest
from fsinfer.errors import InputError
from fsinfer.geometry.similarity import scale_of
from fsinfer.io.chunks import ChunkedCloud, open_chunks
from fsinfer.io.cloud import PointCloud, read_and_tell
from fsinfer.io.digest import file_digest
from fsinfer.io.files import make_folder
from fsinfer.io.las import LAS_SUFFIXES, is_in_degrees, read_epsg
from fsinfer.notices.capture import NO_SCALE, REMARKS, CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.output.json_values import as_json
from fsinfer.output.layout import OutputFolder
from fsinfer.output.plot_json import OF_FILE, of_file, package_versions, read_plot
from fsinfer.placement.place import density_per_m2, transform_cloud
from fsinfer.plot_border.request import BorderRequest
from fsinfer.progress import Progress, silent
from fsinfer.scale.doubts import doubt_about_all, doubt_ends, unknown_error
from fsinfer.scale.find import seen_boards
from fsinfer.scale.marker_search import are_known, look_for_markers
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import UNKNOWN, Scale, marker_centers
from fsinfer.scene import scene_digest
from fsinfer.silhouettes.join import StemPhotos
from fsinfer.threads import one_blas_thread
from fsinfer.trees import PlotResult
from fsinfer.trees.edit_rows import find_edits
from fsinfer.trees.outputs.labels import write_labelled
from fsinfer.trees.sanity import TurnedCloudError
from fsinfer.trees.thinning import ThinningSettings, thin_while_reading
from fsinfer.workflow.cloud_origin import (
    CloudOrigin,
    cloud_scale,
    is_of_run,
    known_path,
    links_of,
    origin_of_cloud,
    own_photos,
)
from fsinfer.workflow.cloud_units import CLOUD_KEYS, is_of_photos, plot_of_cloud, scale_of_trees
from fsinfer.workflow.given_edits import note_edits
from fsinfer.workflow.ledger import Ledger, Stage, StageRecord
from fsinfer.workflow.measurable import refuse_fused, refuse_no_file, refuse_other_units
from fsinfer.workflow.own_files import BESIDE_TREES, refuse_files_of_others, refuse_to_write_over
from fsinfer.workflow.settings import speedless
from fsinfer.workflow.summary import (
    MODEL_UNITS,
    PHOTO_KEYS,
    SCENE_UNITS,
    border_values,
    no_scale_once,
    of_other_stages,
    tree_values,
    update_plot,
    warning_values,
)
from fsinfer.workflow.tree_stage import PlotCloudInput, TreeStageSettings, measure_plot
from fsinfer.workflow.trees_result import TreesResult


@dataclass(frozen=True, kw_only=True)
class MeasuredCloud:
    """What was measured in a cloud file.

    Attributes
    ----------
    trees: of the tree stage; its warnings hold those of the scale and of reading, too.
    scale: metres per unit of the file; unknown where it was taken as it is.
    metric: whether the unit is the metre.
    points: of the file, before thinning.
    density_per_m2: None without a scale.
    """

    trees: TreesResult
    scale: Scale
    metric: bool
    points: int
    density_per_m2: float | None


@dataclass(frozen=True, kw_only=True)
class MeasureSettings:
    """Of the tree stage, and of thinning for files that are too large."""

    stage: TreeStageSettings = field(default_factory=TreeStageSettings)
    thinning: ThinningSettings = field(default_factory=ThinningSettings)


@dataclass(frozen=True, kw_only=True)
class _Opened:
    """The points to measure, in metres where the scale is known; ``points`` are those of the whole file."""

    cloud: PointCloud
    points: int
    labelled: Callable[[Path, PlotResult], None] | None = None
    warnings: tuple[Notice, ...] = ()


MEASURE = Stage(name="measure", version=41, result=MeasuredCloud, outputs=("trees.csv",), beside=BESIDE_TREES)


@one_blas_thread()
def measure_cloud_file(
    cloud_path: Path,
    out: Path,
    *,
    request: ScaleRequest,
    settings: MeasureSettings | None = None,
    edits: Path | None = None,
    progress: Progress = silent,
) -> StageRecord[MeasuredCloud]:
    """Measure the trees of a cloud file (z up) into ``out``, unless that was done before.

    Files of more than ``settings.thinning.max_points`` points are read in pieces and thinned, which the warnings say.

    ``edits`` are corrections of the stem map by hand; without it ``edits.csv`` in ``out``, where there is one.

    The cloud is taken to be in metres, unless ``plot.json`` beside it (or beside what it is a link to) says that it has
    no scale and none is given here: then trees get positions in model units and no DBH, and the warnings say why.

    Raises
    ------
    CloudError
        The file is no cloud, one that would be written over, or its header says that it is not in metres and no scale
        is given.
    ScaleError
        ArUco markers were asked for, and ``out`` has no scene that the cloud came from; or the end points of the
        length are farther apart than the cloud is large.
    InputError
        The plot's border lies round a marker or the middle of the walk, and the cloud has no photographs beside it;
        or ``out`` holds tables or figures of trees that fsinfer did not make; or a run that made the cloud was stopped
        where its unit cannot be told.
    """
    settings = settings or MeasureSettings()
    refuse_no_file(cloud_path)
    links = links_of(cloud_path)
    for path in links:
        refuse_fused(path)
    refuse_to_write_over(cloud_path, out)
    refuse_files_of_others(out)
    corrections = find_edits(out, edits)
    chunks = _large(cloud_path, settings.thinning)
    known_as = known_path(links)
    origin = origin_of_cloud(known_as.parent)
    found = cloud_scale(request, known_as, out, origin)
    if found.scale.m_per_unit is None:
        refuse_other_units(cloud_path)
    per_unit = found.scale.m_per_unit or 1.0
    photos = own_photos(known_as, origin, per_unit)
    told = _boards(found.scale, origin)
    _refuse_center_unknown(settings.stage.border, cloud_path, photos)
    make_folder(out)

    def work(_resume: bool) -> MeasuredCloud:
        # Nothing said and nothing known to the contrary: other people's clouds are in metres.
        metric = found.scale.m_per_unit is not None or origin.units != MODEL_UNITS
        boards = told
        if photos is not None and metric and not told.markers:
            boards = _boards_in(photos, request, settings.stage.border, progress)
        opened = _open(cloud_path, chunks, per_unit, settings.thinning, progress)
        doubts = doubt_ends(request, opened.cloud.xyz, per_unit)
        # A cloud that had to be scaled is not in the frame that its header may name.
        in_frame = cloud_path.suffix.lower() in LAS_SUFFIXES and per_unit == 1.0
        named = read_epsg(cloud_path) if in_frame else None
        # Nor is one that was taken as it is, in metres, in a frame of degrees.
        in_degrees = in_frame and is_in_degrees(cloud_path)
        # One without a code would be on no map anyway.
        degrees = (notice(StemCode.frame_in_degrees, epsg=named),) if in_degrees and named is not None else ()
        frame_of = cloud_path if in_frame and not in_degrees else None
        given = PlotCloudInput(
            cloud=opened.cloud,
            metric=metric,
            scale_rel_std=(found.scale.rel_std if found.scale.rel_std is not None else origin.scale_rel_std) or 0.0,
            camera_height=None if origin.camera_height is None else per_unit * origin.camera_height,
            marker_xyz=None if photos is None else marker_centers(boards, photos.cloud_from_scene),
            marker_numbers=() if photos is None else tuple(marker.id for marker in boards.markers),
            epsg=None if frame_of is None else named,
            frame_of=frame_of,
            photos=photos,
            edits=corrections,
            doubt=doubt_about_all(boards) if is_of_run(known_as, origin) else None,
            write_labelled=opened.labelled,
            unit=per_unit * (scale_of(origin.cloud_from_scene) if origin.cloud_from_scene is not None else 1.0),
        )
        trees, given, turned = _measure(given, out, settings.stage, progress)
        said = (*found.warnings, *doubts, *unknown_error(found.scale), *opened.warnings, *degrees, *turned)
        trees = replace(trees, warnings=(*said, *no_scale_once(said, trees.warnings)))
        density = density_per_m2(given.cloud.xyz) if metric else None
        # That of an earlier measurement would stand beside the tables of this one.
        OutputFolder(out).report.unlink(missing_ok=True)
        return MeasuredCloud(
            trees=trees,
            scale=found.scale,
            metric=metric,
            points=opened.points,
            # Thinning leaves something in every cell: the area is that of the whole cloud.
            density_per_m2=None if density is None else density * opened.points / len(given.cloud.xyz),
        )

    inputs = {
        "cloud": file_digest(cloud_path),
        "origin": origin,
        "scale": found,
        "settings": speedless(settings),
        "edits": corrections,
        "photos": None if photos is None else [scene_digest(photos.scene), *maps_digest(photos.depth_folder)],
    }
    record = Ledger(out).run(MEASURE, work, inputs=inputs)
    note_edits(out, edits)
    own_cloud = known_as.parent.resolve() == out.resolve()
    _tell(record, cloud_path, out, settings.stage, own_cloud=own_cloud)
    return record


def _boards(scale: Scale, origin: CloudOrigin) -> Scale:
    """The markers in the scene of the cloud: those that it gets its ``scale`` from now, or that it had its own from."""
    # Without the metres per unit, which are of the cloud here and of the scene there.
    return replace(UNKNOWN, details=scale.details) if scale.markers else origin.markers


def _boards_in(photos: StemPhotos, request: ScaleRequest, border: BorderRequest, progress: Progress) -> Scale:
    """The boards in the photographs of a cloud in metres whose scale is not theirs.

    Where nobody told where they are, a look at every photograph takes long: only if the border lies round one.
    """
    scene, dictionary = photos.scene, request.aruco_dictionary
    if border.marker is None and not are_known(scene, dictionary):
        return UNKNOWN
    seen = look_for_markers(scene, dictionary=dictionary, progress=progress)
    return seen_boards(scene, seen, m_per_unit=scale_of(photos.cloud_from_scene))


def _refuse_center_unknown(border: BorderRequest, cloud_path: Path, photos: StemPhotos | None) -> None:
    if photos is not None or not (border.needs_walk or border.marker is not None):
        return
    what = "the middle of the walk" if border.needs_walk else f"marker {border.marker}"
    msg = (
        f"--plot-radius-m: where {what} lies in {cloud_path.name} is not known, because it does not lie in the output "
        "folder of fsinfer run; give --plot-center as x,y in metres of the cloud"
    )
    raise InputError(msg)


def _large(cloud_path: Path, thinning: ThinningSettings) -> ChunkedCloud | None:
    """The file as pieces, where it is too large to be read as a whole."""
    chunked = open_chunks(cloud_path)
    return chunked if chunked is not None and chunked.points > thinning.max_points else None


def _open(
    cloud_path: Path, chunks: ChunkedCloud | None, factor: float, thinning: ThinningSettings, progress: Progress
) -> _Opened:
    """Read the cloud, thinned while reading where it is large; ``factor`` metres make a unit of the file."""
    if chunks is None:
        read = read_and_tell(cloud_path)
        cloud = read.cloud
        points = len(cloud.xyz)
        if factor != 1.0:
            cloud = transform_cloud(cloud, np.diag([factor, factor, factor, 1.0]))
        dropped = ((StemCode.not_finite, read.not_finite), (StemCode.flagged, read.flagged))
        told = tuple(notice(code, points=count) for code, count in dropped if count)
        return _Opened(cloud=cloud, points=points, warnings=told)
    large = replace(chunks, factor=factor)
    thinned = thin_while_reading(large, settings=thinning, progress=progress)
    return _Opened(
        cloud=PointCloud(xyz=thinned.xyz),
        points=thinned.total,
        labelled=partial(write_labelled, large),
        warnings=thinned.warnings,
    )


def _measure(
    given: PlotCloudInput, out: Path, settings: TreeStageSettings, progress: Progress
) -> tuple[TreesResult, PlotCloudInput, tuple[Notice, ...]]:
    """The trees; a cloud whose z is not up is turned once, which is told, and has left the frame of its header."""
    try:
        return measure_plot(given, out, settings=settings, progress=progress), given, ()
    except TurnedCloudError as error:
        if given.write_labelled is not None or given.photos is not None:
            raise
        turn = np.eye(4)
        turn[:3, :3] = error.turn
        turned = replace(given, cloud=transform_cloud(given.cloud, turn), epsg=None, frame_of=None)
        return measure_plot(turned, out, settings=settings, progress=progress), turned, (error.warning,)


def _tell(
    record: StageRecord[MeasuredCloud], cloud_path: Path, out: Path, settings: TreeStageSettings, *, own_cloud: bool
) -> None:
    """Put into ``plot.json`` what was found, instead of what an earlier measurement found.

    ``own_cloud``: it lies in ``out``, or a link there leads to it, and is in the frame that is told there.
    """
    found = record.result
    scale = found.scale
    values = tree_values(found.trees) | border_values(found.trees)
    values["trees_scale"] = {"m_per_unit": scale.m_per_unit, "source": scale.source, "rel_std": scale.rel_std}
    before = plot_of_cloud(out) if own_cloud else of_file(read_plot(out))
    kept = before.get(OF_FILE) or {}
    if "units" in kept and "warning_codes" not in kept:
        # What an earlier measurement at a scale of its own said of that scale is not of the cloud.
        before |= warning_values(item for item in of_other_stages(before) if item.code not in REMARKS)
    if own_cloud:
        values = {key: before[key] for key in (*CLOUD_KEYS, *PHOTO_KEYS) if key in before} | values
    # A cloud of unknown unit that was measured as it is was taken to be in metres.
    taken = before.get("units") == SCENE_UNITS and (scale.m_per_unit or 1.0) == 1.0
    other = not own_cloud or before.get("units") is None or taken
    if other:
        values |= {
            "units": "m" if found.metric else MODEL_UNITS,
            "points": found.points,
            "density_per_m2": found.density_per_m2,
            "versions": package_versions(),
        }
    values |= scale_of_trees(scale, before, out, own_cloud=own_cloud, density_per_m2=found.density_per_m2)
    if not own_cloud or not is_of_photos(before):
        values["source"] = cloud_path.name
    told = () if other else tuple(item for item in of_other_stages(before) if item not in found.trees.warnings)
    # What an earlier measurement said of its ends, and that there was no scale before this one.
    past = {CaptureCode.end_beside_cloud} | (NO_SCALE if scale.m_per_unit else frozenset())
    said = tuple(item for item in told if item.code not in past)
    values |= warning_values((*said, *no_scale_once(said, found.trees.warnings)))
    if own_cloud and before.get("parts"):
        # Their stems are in the tables of a run only.
        values["parts"] = [part | {"joined": None} for part in before["parts"]]
    values["settings"] = (before.get("settings") or {}) | as_json(settings)
    update_plot(out, source=cloud_path.name, stage="trees", seconds=record.seconds, values=values)

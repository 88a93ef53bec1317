"""Photos to advice: their poses, a quick look at the depth, the stems, and who saw them from where."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.check.advice import advice, marker_lines
from fsinfer.check.coarse_depth import Glance, GlanceSettings, read_glance, take_glance
from fsinfer.check.compass import find_compass, gnss_places
from fsinfer.check.coverage import StemCoverage, judge_stems, within_walk
from fsinfer.check.habits import habits
from fsinfer.check.open_sides import OpenSide, open_sides
from fsinfer.check.result import CheckResult
from fsinfer.check.settings import CoverageSettings
from fsinfer.check.survey import Survey, SurveySettings, survey_scene
from fsinfer.frames.select import frame_stems, list_captures
from fsinfer.frames.settings import FrameSettings
from fsinfer.geometry.similarity import scale_of
from fsinfer.io.files import make_folder, write_text
from fsinfer.io.walk_order import list_walk
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice
from fsinfer.notices.sentences import sentences
from fsinfer.output.layout import CHECK_WORK, OutputFolder
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.sparse import read_sparse
from fsinfer.progress import Progress, StageProgress, silent_stages
from fsinfer.scale.aruco import scale_from_aruco
from fsinfer.scale.doubts import boards_at_two_places, doubt_boards
from fsinfer.scale.find import find_scale, scale_from_printed_boards
from fsinfer.scale.marker_search import look_for_markers
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import (
    CAMERA_HEIGHT_M,
    UNKNOWN,
    NoUsableMarkersError,
    RejectedMarker,
    Scale,
    marker_centers,
)
from fsinfer.scene import Scene, read_scene, scene_digest
from fsinfer.threads import one_blas_thread
from fsinfer.workflow.cloud_stages import DEPTH
from fsinfer.workflow.kept_clicks import kept_clicks
from fsinfer.workflow.ledger import Ledger, Stage
from fsinfer.workflow.photo_stages import (
    POSES,
    choose_frames,
    is_registered,
    is_registered_so,
    register_photos,
    require_poses,
    source_files,
)

#: A board's middle lies so near to the wall of its post, which a few points put a little off. Source: judgement, on
#: rendered plots; renders only.
_POST_M = 0.35
#: What is told of a scale by clicks.
_OF_CLICKS = frozenset({CaptureCode.clicks_do_not_fit, CaptureCode.boards_contradict_scale})


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Settings of the check.

    Attributes
    ----------
    frames, poses: of the stages that a run shares; with a run's settings it does not repeat them.
    """

    frames: FrameSettings = field(default_factory=FrameSettings)
    poses: PoseSettings = field(default_factory=PoseSettings)
    glance: GlanceSettings = field(default_factory=GlanceSettings)
    survey: SurveySettings = field(default_factory=SurveySettings)
    coverage: CoverageSettings = field(default_factory=CoverageSettings)
    scale: ScaleRequest = field(default_factory=ScaleRequest)


@dataclass(frozen=True, kw_only=True)
class CoarseDepth:
    """Points of the surface that the quick look at the depth gave."""

    points: int


COARSE_DEPTH = Stage(name="check_depth", version=1, result=CoarseDepth, outputs=(CHECK_WORK,), keeps_partial=True)


@one_blas_thread()
def check_capture(
    source: Path, out: Path, *, settings: CheckSettings | None = None, progress: StageProgress = silent_stages
) -> CheckResult:
    """Say which trees to photograph again; writes ``out/check/check.png`` and ``check.json``.

    The photos are placed by the first two stages of a run, in ``out/frames`` and ``out/scene``: a run with the same
    settings goes on from there, and what a run has placed is not placed again, unless the source has changed.

    Raises
    ------
    ImageError, PosesError
        The photos cannot be read, or no two of them fit together.
    InputError
        The source does not exist, or ``out`` holds a scene of other origin.
    """
    settings = settings or CheckSettings()
    source, out = Path(source), Path(out)
    files = source_files(source, out)
    require_poses(out)
    settings = replace(settings, scale=_with_clicks(settings.scale, out))
    ledger = Ledger(make_folder(out))
    start = time.monotonic()
    seconds: dict[str, float] = {}
    notes = []
    if _belongs_to_run(files, ledger):
        if not is_registered_so(out, frames=settings.frames, poses=settings.poses):
            notes.append(
                f"{out} holds what a run made of these photos with other settings; its poses are used. For a check "
                "with the settings given here choose another output folder."
            )
    else:
        choose_frames(ledger, source, files, settings=settings.frames, progress=progress)
        seconds["frames"] = time.monotonic() - start
        images = OutputFolder(out).frame_images
        register_photos(ledger, images, settings=settings.poses, origin=source, progress=progress)
    seconds["poses"] = time.monotonic() - start - sum(seconds.values())
    photos = {stem: path for path, stem in frame_stems(list_captures(source)).items()}
    # Frames that were coded again lost their place; the photos themselves have it, under names of their own.
    originals = {path.stem: photos.get(path.stem, path) for path in list_walk(OutputFolder(out).frame_images)}
    given = list(originals)
    scene, sparse = read_scene(OutputFolder(out).scene), read_sparse(OutputFolder(out).sparse)
    report = progress("check")
    scale, visible, rejected, doubts = _scale(settings.scale, scene, report)
    notes += [f"{text[0].upper()}{text[1:]}." for text in sentences(doubts)]
    seconds["boards"] = time.monotonic() - start - sum(seconds.values())
    glance = _coarse_depth(ledger, scene, settings.glance, report)
    seconds["depth"] = time.monotonic() - start - sum(seconds.values())
    survey = survey_scene(scene, sparse, glance, m_per_unit=scale.m_per_unit, settings=settings.survey)
    result = judge_survey(survey, given, scale, visible, rejected=rejected, originals=originals, settings=settings)
    poses = ledger.recall(POSES)
    notes = habits(scene, () if poses is None else poses.result.warnings, given) + notes
    seconds["stems"] = time.monotonic() - start - sum(seconds.values())
    result = _write(replace(result, notes=(*result.notes, *notes)), OutputFolder(out), seconds)
    shutil.rmtree(OutputFolder(out).check_work, ignore_errors=True)
    return result


def _belongs_to_run(files: Sequence[Path], ledger: Ledger) -> bool:
    """Whether there are poses of these photos that the check must not make anew, whatever its settings.

    Those that only an earlier check has made may go: no depth hangs on them.
    """
    return ledger.has(DEPTH.name) and is_registered(files, ledger.out)


def _coarse_depth(ledger: Ledger, scene: Scene, settings: GlanceSettings, progress: Progress) -> Glance | None:
    """The quick look at the depth; one that was stopped goes on, and its maps go when the check is done."""

    def work(resume: bool) -> CoarseDepth:
        glance = take_glance(
            scene, OutputFolder(ledger.out).check_work, settings=settings, resume=resume, progress=progress
        )
        taken.append(glance)
        return CoarseDepth(points=0 if glance is None else len(glance.points))

    taken: list[Glance | None] = []
    inputs = {"scene": scene_digest(scene), "settings": settings}
    ledger.run(COARSE_DEPTH, work, inputs=inputs)
    # Done before, where the check was stopped after it.
    return (
        taken[0]
        if taken
        else read_glance(scene, OutputFolder(ledger.out).check_work, settings=settings, progress=progress)
    )


def judge_survey(
    survey: Survey,
    given: Sequence[str],
    scale: Scale,
    boards: Scale,
    *,
    rejected: Sequence[RejectedMarker] = (),
    originals: Mapping[str, Path] | None = None,
    settings: CheckSettings | None = None,
) -> CheckResult:
    """The check without its files: from the stems and who saw them to the result.

    Parameters
    ----------
    given: names of the photos that were to be placed, as their views are called, in the order of walking.
    scale: metres per unit, or unknown.
    boards: how the boards were seen, whatever their length; its ``details`` are empty where none was.
    rejected: the boards that were seen where none can be used.
    originals: the file that each of them comes from, by the view's name: what tells its place on the earth.
    """
    settings = settings or CheckSettings()
    names, cameras = survey.names, survey.cameras
    notes = [f"{len(names)} of {len(given)} photos placed."]
    left_out = sorted(set(given) - set(names))
    at_boards = marker_centers(boards, survey.plot_from_scene)[:, :2]
    # The post of a board is upright and round, too.
    kept = [
        row
        for row, stem in enumerate(survey.stems)
        if all(np.linalg.norm(stem.center - place) - stem.radius > _POST_M for place in at_boards)
    ]
    stems = [survey.stems[row] for row in kept]
    places = np.array([stem.center for stem in stems]).reshape(-1, 2)
    inside = within_walk(cameras, places, settings=settings.coverage)
    judged = judge_stems(stems, survey.seen[kept], cameras, inside, settings=settings.coverage)
    sides = open_sides(cameras)
    judged = [_beyond(entry, sides) for entry in judged]
    files = originals or {}
    compass = find_compass(cameras, gnss_places([files.get(name, Path(name)) for name in names]))
    twice = boards_at_two_places(boards, scale_of(survey.plot_from_scene))
    # Of a length that nobody gave there is nothing to contradict; that boards are few is said with the boards.
    doubts = [doubt for doubt in doubt_boards(scale) if doubt.code != CaptureCode.one_board]
    lines = [f"{text[0].upper()}{text[1:]}." for text in sentences((*twice, *doubts))]
    lines += advice(
        names=names,
        left_out=left_out,
        given=given,
        stems=judged,
        compass=compass,
        sides=sides,
        offsets_m=[cameras - entry.stem.center for entry in judged],
    )
    if scale.m_per_unit is None:
        notes.append(f"No scale: lengths are guessed from a phone held {CAMERA_HEIGHT_M:g} m high.")
    known = scale.m_per_unit is not None
    elsewhere = known and scale.source != "aruco"
    notes += marker_lines(boards, rejected, given=settings.scale.given or known, elsewhere=elsewhere)
    within = [entry for entry in judged if entry.inside]
    good = sum(entry.verdict in ("good", "far") for entry in within)
    if judged:
        stem, outside = "stem" if len(within) == 1 else "stems", len(judged) - len(within)
        notes.append(f"{len(within)} {stem} within your walk, {good} of them seen all round; {outside} outside.")
    else:
        notes.append(
            "No stem was found, so that trees cannot be judged: are the stems in the pictures from the ground up to "
            "2.5 m, the ground at their feet, and each photo's view for the most part in the next?"
        )
    return CheckResult(
        photos=len(given),
        registered=len(names),
        lines=tuple(lines),
        notes=tuple(notes),
        stems=tuple(judged),
        cameras=cameras,
        names=names,
        compass=compass,
        metric=scale.m_per_unit is not None,
        sides=tuple(sides),
        map_path=None,
        seconds={},
    )


def _beyond(entry: StemCoverage, sides: Sequence[OpenSide]) -> StemCoverage:
    """A stem outside the walk, on its open side and seen from the walk's side alone, is one to be named."""
    there = any(side.beyond(entry.stem.center)[0] for side in sides)
    return replace(entry, verdict="beyond") if there and not entry.inside and entry.one_sided else entry


def _with_clicks(request: ScaleRequest, out: Path) -> ScaleRequest:
    """The request with the ends that were clicked for this folder, as a run takes them."""
    return request if request.given or request.clicks is not None else replace(request, clicks=kept_clicks(out).used)


def _scale(
    request: ScaleRequest, scene: Scene, progress: Progress
) -> tuple[Scale, Scale, tuple[RejectedMarker, ...], tuple[Notice, ...]]:
    """The metric scale, how the boards are seen where it is not theirs, those seen where none can be used, and doubts.

    The doubts are those that a scale by clicks raises; what boards raise is found in them again.
    """
    seen = None
    doubts: tuple[Notice, ...] = ()
    if request.given or request.clicks is not None:
        found = find_scale(request, scene=scene, progress=progress)
        scale, doubts = found.scale, tuple(told for told in found.warnings if told.code in _OF_CLICKS)
    else:
        seen = look_for_markers(scene, progress=progress)
        scale = scale_from_printed_boards(scene, seen) or UNKNOWN
    if scale.source == "aruco":
        return scale, scale, (), doubts
    try:
        # The length does not matter for how well a board is seen.
        dictionary = request.aruco_dictionary
        return scale, scale_from_aruco(scene, 1.0, dictionary=dictionary, progress=progress, seen=seen), (), doubts
    except NoUsableMarkersError as error:
        return scale, UNKNOWN, error.rejected, doubts


def _write(result: CheckResult, folder: OutputFolder, seconds: dict[str, float]) -> CheckResult:
    from fsinfer.check.map import draw_map

    draw_map(result, folder.check_map)
    result = replace(
        result, map_path=folder.check_map, seconds={key: round(value, 1) for key, value in seconds.items()}
    )
    write_text(folder.check_json, json.dumps(_as_json(result), indent=1) + "\n")
    return result


def _as_json(result: CheckResult) -> dict[str, Any]:
    return {
        "photos": result.photos,
        "registered": result.registered,
        "again": list(result.lines),
        "notes": list(result.notes),
        "north_known": result.compass.known,
        "seconds": result.seconds,
        "stems": [
            {
                "tree": entry.number,
                "x_m": round(float(entry.stem.center[0]), 3),
                "y_m": round(float(entry.stem.center[1]), 3),
                "photos": [result.names[index] for index in entry.views],
                "widest_gap_deg": round(entry.gap_deg, 1),
                "nearest_m": round(float(entry.distances_m.min()), 2) if len(entry.views) else None,
                "verdict": entry.verdict,
            }
            for entry in result.stems
        ],
    }

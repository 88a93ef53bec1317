"""Photos to advice: their poses, a quick look at the depth, the stems, and who saw them from where."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.check.advice import advice, marker_lines
from fsinfer.check.coarse_depth import GlanceSettings, take_glance
from fsinfer.check.compass import find_compass, gnss_places
from fsinfer.check.coverage import CoverageSettings, StemCoverage, judge_stems
from fsinfer.check.open_sides import OpenSide, open_sides
from fsinfer.check.result import CheckResult
from fsinfer.check.survey import Survey, SurveySettings, survey_scene
from fsinfer.errors import ScaleError
from fsinfer.frames.select import FrameSettings
from fsinfer.geometry.hull import in_hull
from fsinfer.io.files import make_folder, write_text
from fsinfer.io.images import list_images
from fsinfer.poses.colmap import PoseSettings
from fsinfer.poses.sparse import read_sparse
from fsinfer.progress import Progress, StageProgress, silent_stages
from fsinfer.scale.aruco import scale_from_aruco
from fsinfer.scale.doubts import boards_at_two_places
from fsinfer.scale.find import find_scale, scale_from_printed_boards
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import Scale, marker_centers
from fsinfer.scene import Scene, read_scene
from fsinfer.workflow.ledger import RECORDS_FOLDER, StageBook
from fsinfer.workflow.photo_stages import choose_frames, is_placed, is_placed_so, place_photos, source_files

# A board's middle lies so near to the wall of its post, which a few points put a little off.
_POST_M = 0.35


@dataclass(frozen=True, kw_only=True)
class CheckSettings:
    """Settings of the check.

    Attributes
    ----------
    frames, poses: of the stages that a run shares; with a run's settings it does not repeat them.
    margin_m: stems are judged up to so far outside the walk; farther ones cannot be seen from all sides.
    """

    frames: FrameSettings = field(default_factory=FrameSettings)
    poses: PoseSettings = field(default_factory=PoseSettings)
    glance: GlanceSettings = field(default_factory=GlanceSettings)
    survey: SurveySettings = field(default_factory=SurveySettings)
    coverage: CoverageSettings = field(default_factory=CoverageSettings)
    scale: ScaleRequest = field(default_factory=ScaleRequest)
    margin_m: float = 0.5


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
    make_folder(out)
    start = time.monotonic()
    seconds: dict[str, float] = {}
    notes = []
    if _belongs_to_run(files, out):
        if not is_placed_so(out, frames=settings.frames, poses=settings.poses):
            notes.append(
                f"{out} holds what a run made of these photos with other settings; its poses are used. For a check "
                "with the settings given here choose another output folder."
            )
    else:
        book = StageBook(out)
        choose_frames(book, source, files, settings=settings.frames, progress=progress)
        seconds["frames"] = time.monotonic() - start
        place_photos(book, source, settings=settings.poses, progress=progress)
    seconds["poses"] = time.monotonic() - start - sum(seconds.values())
    folder = out / "scene"
    photos = {path.stem: path for path in (list_images(source) if source.is_dir() else [])}
    # Frames that were coded again lost their place; the photos themselves have it.
    originals = [photos.get(path.stem, path) for path in list_images(out / "frames" / "images")]
    scene, sparse = read_scene(folder), read_sparse(folder / "sparse")
    report = progress("check")
    scale, visible = _scale(settings.scale, scene, report)
    seconds["boards"] = time.monotonic() - start - sum(seconds.values())
    work = out / "check" / "work"
    glance = take_glance(scene, work, settings=settings.glance, progress=report)
    seconds["depth"] = time.monotonic() - start - sum(seconds.values())
    survey = survey_scene(scene, sparse, glance, m_per_unit=scale.m_per_unit, settings=settings.survey)
    result = judge_survey(survey, originals, scale, visible, settings=settings)
    seconds["stems"] = time.monotonic() - start - sum(seconds.values())
    result = _write(replace(result, notes=(*result.notes, *notes)), out / "check", seconds)
    shutil.rmtree(work, ignore_errors=True)
    return result


def _belongs_to_run(files: Sequence[Path], out: Path) -> bool:
    """Whether there are poses of these photos that the check must not make anew, whatever its settings.

    Those that only an earlier check has made may go: no depth hangs on them.
    """
    records = out / RECORDS_FOLDER
    made_by_check = (records / "poses.json").is_file() and not (records / "depth.json").is_file()
    return not made_by_check and is_placed(files, out)


def judge_survey(
    survey: Survey,
    given: Sequence[Path],
    scale: Scale,
    boards: Scale,
    *,
    settings: CheckSettings | None = None,
) -> CheckResult:
    """The check without its files: from the stems and who saw them to the result.

    Parameters
    ----------
    given: the photos that were to be placed, in the order of walking; a photo's stem is the name of its view.
    scale: metres per unit, or unknown.
    boards: how the boards were seen, whatever their length; its ``details`` are empty where none was.
    """
    settings = settings or CheckSettings()
    names, cameras = survey.names, survey.cameras
    notes = [f"{len(names)} of {len(given)} photos placed."]
    left_out = sorted({path.stem for path in given} - set(names))
    at_boards = marker_centers(asdict(boards), survey.plot_from_scene)[:, :2]
    # The post of a board is upright and round, too.
    kept = [
        row
        for row, stem in enumerate(survey.stems)
        if all(np.linalg.norm(stem.center - place) - stem.radius > _POST_M for place in at_boards)
    ]
    stems = [survey.stems[row] for row in kept]
    # A straight walk has no inside: everything beside it can be walked round as well.
    inside = in_hull(cameras, np.array([stem.center for stem in stems]).reshape(-1, 2), settings.margin_m)
    judged = judge_stems(stems, survey.seen[kept], cameras, inside, settings=settings.coverage)
    sides = open_sides(cameras)
    judged = [_beyond(entry, sides) for entry in judged]
    by_name = {path.stem: path for path in given}
    compass = find_compass(cameras, gnss_places([by_name.get(name, Path(name)) for name in names]))
    lines = boards_at_two_places(boards, float(np.cbrt(np.linalg.det(survey.plot_from_scene[:3, :3]))))
    lines += advice(
        names=names,
        left_out=left_out,
        given=[path.stem for path in given],
        stems=judged,
        compass=compass,
        sides=sides,
        offsets_m=[cameras - entry.stem.center for entry in judged],
    )
    if scale.m_per_unit is None:
        notes.append(f"No scale: lengths are guessed from a phone held {settings.survey.camera_height_m:g} m high.")
    notes += marker_lines(boards, given=settings.scale.given or scale.m_per_unit is not None)
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


def _scale(request: ScaleRequest, scene: Scene, progress: Progress) -> tuple[Scale, Scale]:
    """The metric scale, and how the boards are seen where their length is not known."""
    unknown = Scale(m_per_unit=None, source="none", rel_std=None)
    if request.given:
        scale, _ = find_scale(request, scene=scene, progress=progress)
    else:
        scale = scale_from_printed_boards(scene, progress) or unknown
    if scale.source == "aruco":
        return scale, scale
    try:
        # The length does not matter for how well a board is seen.
        return scale, scale_from_aruco(scene, 1.0, dictionary=request.aruco_dictionary, progress=progress)
    except ScaleError:
        return scale, unknown


def _write(result: CheckResult, folder: Path, seconds: dict[str, float]) -> CheckResult:
    from fsinfer.check.map import draw_map

    path = folder / "check.png"
    draw_map(result, path)
    result = replace(result, map_path=path, seconds={key: round(value, 1) for key, value in seconds.items()})
    write_text(folder / "check.json", json.dumps(_as_json(result), indent=1) + "\n")
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

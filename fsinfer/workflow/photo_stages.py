"""The first two stages, photos → frames → poses, which ``fsinfer run`` and ``fsinfer check`` share.

Whichever comes first does them, into ``OUT/frames`` and ``OUT/scene``; the other finds them done.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fsinfer.errors import InputError
from fsinfer.frames.select import FramesResult, list_captures, select_frames
from fsinfer.frames.settings import FrameSettings
from fsinfer.io.digest import file_digest
from fsinfer.io.images import can_be_read
from fsinfer.io.photo_folders import PHOTO_SUFFIXES
from fsinfer.io.walk_order import list_walk
from fsinfer.notices.capture import CaptureCode
from fsinfer.poses.colmap_calls import require_pycolmap
from fsinfer.poses.estimate import PosesResult
from fsinfer.poses.settings import PoseSettings
from fsinfer.progress import StageProgress, silent_stages
from fsinfer.workflow.kept_clicks import kept_clicks
from fsinfer.workflow.ledger import Ledger, Stage, StageRecord
from fsinfer.workflow.poses_apart import estimate_poses_apart
from fsinfer.workflow.settings import speedless

#: Folders that a run empties and fills.
STAGE_FOLDERS = ("frames", "scene", "depth", "confidence", "fused", "figures")
FRAMES = Stage(name="frames", version=3, result=FramesResult, outputs=("frames",))
POSES = Stage(name="poses", version=21, result=PosesResult, outputs=("scene",), keeps_partial=True)


def source_files(source: Path, out: Path) -> list[Path]:
    """The photographs and videos of ``source``.

    Raises
    ------
    InputError
        It does not exist, is ``out`` itself, or lies in a folder of ``out`` that the stages would empty.
    """
    if not source.exists():
        msg = f"{source} does not exist; give a folder of photos or a video file"
        raise InputError(msg)
    if source.resolve() == out.resolve():
        beside = f"{out.resolve().name}-plot"
        msg = f"the results would be written among the photos in {source}; give a folder of their own, like {beside}"
        raise InputError(msg)
    inside = [name for name in STAGE_FOLDERS if source.resolve().is_relative_to((out / name).resolve())]
    if inside:
        msg = f"{source} lies in {out / inside[0]}, which the run empties and fills; choose another output folder"
        raise InputError(msg)
    return list_captures(source)


def require_poses(out: Path) -> None:
    """Raise :class:`PosesError` where ``out`` has no finished poses and this computer cannot find any.

    Else it would show after all frames were looked at.
    """
    if Ledger(out).recall(POSES) is None:
        require_pycolmap()


def choose_frames(
    ledger: Ledger,
    source: Path,
    files: Sequence[Path],
    *,
    settings: FrameSettings,
    folder: Path | None = None,
    outputs: tuple[str, ...] = FRAMES.outputs,
    progress: StageProgress = silent_stages,
) -> StageRecord[FramesResult]:
    """Stage ``frames``: the photos worth using into ``folder`` (``OUT/frames``), unless that was done before."""
    target, stage = folder or ledger.out / "frames", replace(FRAMES, outputs=outputs)
    return ledger.run(
        stage,
        lambda _: select_frames(source, target, settings=settings, progress=progress("frames")),
        inputs=_frames_inputs(files, settings),
        again=_reads_more_frames(ledger.recall(stage), files),
    )


def register_photos(
    ledger: Ledger,
    images: Path,
    *,
    settings: PoseSettings,
    origin: Path | None = None,
    folder: Path | None = None,
    outputs: tuple[str, ...] = POSES.outputs,
    after: Sequence[StageRecord[Any]] = (),
    progress: StageProgress = silent_stages,
) -> StageRecord[PosesResult]:
    """Stage ``poses``: where each photo was taken into ``folder`` (``OUT/scene``), unless that was done before.

    ``origin`` is what messages call the photos in ``images``.
    """
    target = folder or ledger.out / "scene"
    kept_clicks(ledger.out)  # pixels in the pictures of the scene that is replaced
    stage, photos = replace(POSES, outputs=outputs), list_walk(images)
    return ledger.run(
        stage,
        lambda resume: estimate_poses_apart(
            images, target, settings=settings, origin=origin, resume=resume, progress=progress("poses")
        ),
        inputs=_poses_inputs(photos, settings),
        after=after,
        again=_reads_more_photos(ledger.recall(stage), photos),
    )


def is_registered(files: Sequence[Path], out: Path) -> bool:
    """Whether ``out`` holds finished poses of frames of just these source files, whatever the settings were."""
    ledger = Ledger(out)
    if ledger.recall(POSES) is None:
        return False  # its pictures are most of a run's bytes, and may have been deleted since
    frames, poses = ledger.inputs_of(FRAMES.name), ledger.inputs_of(POSES.name)
    if frames is None or poses is None or frames.get("source") != _digests(files):
        return False
    # Frames may have been chosen anew since.
    images = out / "frames" / "images"
    chosen = list_walk(images) if images.is_dir() and any(images.iterdir()) else []
    return bool(chosen) and poses.get("photos") == _digests(chosen)


def is_registered_so(out: Path, *, frames: FrameSettings, poses: PoseSettings) -> bool:
    """Whether the frames and the poses in ``out`` were made with these settings."""
    ledger = Ledger(out)
    made = [(ledger.inputs_of(name) or {}).get("settings") for name in (FRAMES.name, POSES.name)]
    return made == [speedless(frames), speedless(poses)]


def _reads_more_frames(before: StageRecord[FramesResult] | None, files: Sequence[Path]) -> bool:
    """Whether a photo that could not be read when the frames were chosen can be read now.

    Its digest need not tell: a photo that was damaged in its middle and copied once more has the ends that it had, and
    one whose reader was missing is the same.
    """
    rows = () if before is None else before.result.rows
    scored = {row.name for row in rows if row.sharpness is not None}
    unread = {row.source for row in rows if row.sharpness is None and row.name not in scored}
    # An unreadable video is one by what stands at its ends.
    return any(can_be_read(path) for path in files if path.name in unread and path.suffix.lower() in PHOTO_SUFFIXES)


def _reads_more_photos(before: StageRecord[PosesResult] | None, photos: Sequence[Path]) -> bool:
    """The same of the photos that were to be placed."""
    if before is None:
        return False
    unread = sum(told.code == CaptureCode.photo_unreadable for told in before.result.warnings)
    if not unread:
        return False
    # One of two of the same name may have been placed.
    named = Counter(path.stem for path in photos)
    asked = [path for path in photos if path.stem in before.result.left_out or named[path.stem] > 1]
    return sum(not can_be_read(path) for path in asked) < unread


def _frames_inputs(files: Sequence[Path], settings: FrameSettings) -> dict[str, Any]:
    return {"source": _digests(files), "settings": speedless(settings)}


def _poses_inputs(photos: Sequence[Path], settings: PoseSettings) -> dict[str, Any]:
    return {"photos": _digests(photos), "settings": speedless(settings)}


def _digests(files: Sequence[Path]) -> list[str]:
    return [file_digest(path) for path in files]

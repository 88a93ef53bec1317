"""The first two stages, photos → frames → poses, which ``fsinfer run`` and ``fsinfer check`` share.

Whichever comes first does them, into ``OUT/frames`` and ``OUT/scene``; the other finds them done.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fsinfer.errors import InputError
from fsinfer.frames.select import FrameSettings, list_captures, select_frames
from fsinfer.io.digest import file_digest
from fsinfer.io.images import list_images
from fsinfer.output.json_values import as_json
from fsinfer.poses.estimate import PoseSettings, estimate_poses
from fsinfer.progress import StageProgress, silent_stages
from fsinfer.scene import read_scene
from fsinfer.workflow.ledger import StageBook

#: Folders that a run empties and fills.
STAGE_FOLDERS = ("frames", "scene", "depth", "confidence", "fused", "figures")
# How the work is spread over the machine does not change what comes out. The precision asked for may, but the hash of
# the graphs that it led to on this machine says so better.
_SPEED_OPTIONS = frozenset({"threads", "memory_gb", "provider", "precision"})


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


def choose_frames(
    book: StageBook,
    source: Path,
    files: Sequence[Path],
    *,
    settings: FrameSettings,
    progress: StageProgress = silent_stages,
) -> None:
    """Stage ``frames``: the photos worth using into ``OUT/frames``, unless that was done before."""

    def work() -> Mapping[str, Any]:
        result = select_frames(source, book.out / "frames", settings=settings, progress=progress("frames"))
        rejected = [{"name": row.name, "reason": row.reason} for row in result.rows if not row.kept]
        return {
            "chosen": len(result.images),
            "given": len(result.rows),
            "rejected": rejected,
            "warnings": result.warnings,
        }

    digests = [file_digest(path) for path in files]
    book.run("frames", work, inputs={"source": digests, "settings": speedless(settings)}, outputs=["frames"])


def place_photos(
    book: StageBook, source: Path, *, settings: PoseSettings, progress: StageProgress = silent_stages
) -> None:
    """Stage ``poses``, after ``frames``: where each photo was taken into ``OUT/scene``, unless that was done before.

    ``source`` is what messages call the photos.
    """
    images, folder = book.out / "frames" / "images", book.out / "scene"

    def work() -> Mapping[str, Any]:
        result = estimate_poses(images, folder, settings=settings, origin=source, progress=progress("poses"))
        names = {path.stem for path in list_images(images)}
        left_out = sorted(names - {view.name for view in read_scene(folder).views})
        return {
            "photos": result.photos,
            "registered": result.registered,
            "left_out": left_out,
            "warnings": result.warnings,
        }

    book.run(
        "poses",
        work,
        inputs={"settings": speedless(settings)},
        after=["frames"],
        outputs=["scene"],
        keeps_partial=True,
    )


def is_placed(files: Sequence[Path], out: Path) -> bool:
    """Whether ``out`` holds finished poses of frames of just these source files, whatever the settings were."""
    frames, poses = _read_key(out / "frames" / "frames.json"), _read_key(out / "scene" / "poses.json")
    if frames.get("source") != {path.name: file_digest(path) for path in files}:
        return False
    # Frames may have been chosen anew since.
    images = out / "frames" / "images"
    chosen = list_images(images) if images.is_dir() and any(images.iterdir()) else []
    return bool(chosen) and poses.get("photos") == {path.name: file_digest(path) for path in chosen}


def is_placed_so(out: Path, *, frames: FrameSettings, poses: PoseSettings) -> bool:
    """Whether the frames and the poses in ``out`` were made with these settings."""
    pairs = (("frames/frames.json", frames), ("scene/poses.json", poses))
    found = [_read_key(out / name).get("settings") for name, _ in pairs]
    asked = [json.loads(json.dumps(asdict(settings))) for _, settings in pairs]
    return [speedless(entry) for entry in asked] == [speedless(entry or {}) for entry in found]


def speedless(settings: Any) -> dict[str, Any]:
    """Settings as JSON values, without those that say how the work is spread over the machine."""
    return {key: value for key, value in as_json(settings).items() if key not in _SPEED_OPTIONS}


def _read_key(path: Path) -> dict[str, Any]:
    """What the stage's own record says that its result was made from; empty where it was not finished."""
    try:
        key = json.loads(path.read_text(encoding="utf-8"))["key"]
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return key if isinstance(key, dict) else {}

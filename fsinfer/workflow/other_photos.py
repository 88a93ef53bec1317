"""Whether an output folder holds the results of other photographs, as of last year's walk or of another plot.

Photos may be added, removed, renamed and converted, and everything is done again. Where none of them is among those of
the results, another walk was meant for another folder, and what that one gave would be gone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.frames.select import FramesResult
from fsinfer.io.digest import file_digest
from fsinfer.io.exif import taken_at
from fsinfer.io.photo_folders import PHOTO_SUFFIXES
from fsinfer.output.layout import OutputFolder
from fsinfer.workflow.ledger import Ledger
from fsinfer.workflow.photo_stages import FRAMES, source_files


def refuse_other_photos(source: Path, out: Path) -> None:
    """Raise :class:`InputError` where ``out`` holds measured trees of photos of which none is in ``source``.

    The same photo is one by its content and name. Else the moments that the photos noted tell, which stay when they
    are renamed or converted, and where these are not known the names.
    """
    if not OutputFolder(out).trees_csv.is_file():
        return
    ledger = Ledger(out)
    before, frames = ledger.inputs_of(FRAMES.name), ledger.recall(FRAMES)
    if before is None or frames is None:
        return
    files, known = source_files(source, out), set(before.get("source", ()))
    if any(file_digest(path) in known for path in files) or not _differ(files, frames.result, out):
        return
    names = list(dict.fromkeys(row.source for row in frames.result.rows))
    those = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
    msg = (
        f"{out} holds the results of other photos ({those}), none of which is in {source}; give another output folder, "
        f"or delete {out} where they are no longer wanted"
    )
    raise InputError(msg)


def _differ(files: Sequence[Path], frames: FramesResult, out: Path) -> bool:
    there, here = _moments(OutputFolder(out).frame_images.iterdir()), _moments(files)
    if there and here:
        return there.isdisjoint(here)
    # A converted photo has another suffix.
    return {Path(row.source).stem.casefold() for row in frames.rows}.isdisjoint(path.stem.casefold() for path in files)


def _moments(paths: Iterable[Path]) -> set[str]:
    """When the photos were taken, to the second: not every program keeps the decimals."""
    photos = (path for path in paths if path.suffix.lower() in PHOTO_SUFFIXES)
    return {taken[1].split(".")[0] for path in photos if (taken := taken_at(path)) is not None}

"""The photos in the report: how many were taken, which were left out, and why."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from fsinfer.errors import FsinferError
from fsinfer.io.images import read_image
from fsinfer.report.contents import Contents
from fsinfer.report.page import Part, missing_part
from fsinfer.report.picture import Picture, picture_of, shrink

#: Width of the contact sheet, and reasons that are listed at most. Source: layout.
CONTACT_SHEET_PX, MOST_REASONS = 1000, 12
# Columns under which a table of frames may say whether a frame was taken.
_CHOSEN_COLUMNS = ("chosen", "kept", "selected", "used")
_ANCHOR, _TITLE = "photos", "Photos"


@dataclass(frozen=True, kw_only=True)
class PhotosView:
    """Names and counts; the contact sheet of what was left out, or why it cannot be shown, or neither."""

    facts: tuple[tuple[str, str], ...]
    left_out: Picture | None
    missing: str


def photos_part(contents: Contents) -> Part:
    """What became of the photos or video frames."""
    frames = contents.frames
    if frames is None:
        return missing_part(_ANCHOR, _TITLE, f"{contents.why_missing('frames.csv')}.")
    rows = [("Photos or video frames looked at", str(len(frames)))]
    column = next((name for name in _CHOSEN_COLUMNS if frames and name in frames[0]), None)
    rejected = frames
    if column is not None:
        taken = [row for row in frames if row[column].strip().lower() in ("1", "true", "yes")]
        rows.append(("Taken", str(len(taken))))
        rejected = [row for row in frames if row not in taken]
    reasons = Counter(row.get("reason", "").strip() for row in rejected)
    rows += [(f"Reason: {reason}", str(count)) for reason, count in reasons.most_common(MOST_REASONS) if reason]
    left_out, missing = _contact_sheet(contents)
    return Part(anchor=_ANCHOR, title=_TITLE, view=PhotosView(facts=tuple(rows), left_out=left_out, missing=missing))


def _contact_sheet(contents: Contents) -> tuple[Picture | None, str]:
    """What was dropped and why, as the frames stage drew it; nothing where it drew nothing."""
    path = contents.out / "frames" / "frames_contact.jpg"
    if not path.is_file():
        return None, ""
    try:
        sheet = read_image(path)
    except FsinferError as error:
        return None, f"{path.name} could not be read ({error})."
    return picture_of(shrink(sheet, CONTACT_SHEET_PX), "Left out, with the reason"), ""

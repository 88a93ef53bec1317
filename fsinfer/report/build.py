"""Putting the report together."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

from fsinfer.errors import FsinferError, InputError
from fsinfer.io.files import write_text
from fsinfer.io.images import read_image
from fsinfer.report.cloud_data import MAX_POINTS
from fsinfer.report.cloud_part import cloud_section
from fsinfer.report.contents import Contents, number, read_contents
from fsinfer.report.depth_part import depth_section
from fsinfer.report.html import embedded_image, escape, facts, paragraph, section, shrink
from fsinfer.report.page import render_page
from fsinfer.report.summary import plot_section, tiles
from fsinfer.report.trees_part import stems_section, table_section
from fsinfer.report.warnings_part import warnings_section

REPORT_FILE = "report.html"
# Small enough for most mailboxes.
MAX_MB = 14.0
LEAST_POINTS = 200_000
PLAIN_NAMES = ("photos", "images", "frames", "video.mp4")
# Columns under which a table of frames may say whether a frame was taken.
_CHOSEN_COLUMNS = ("chosen", "kept", "selected", "used")


def make_report(out: Path | str) -> Path:
    """Write ``OUT/report.html`` from what ``OUT`` holds: one file, without any reference to the network.

    Parts that are missing or damaged are said in the page. The cloud is thinned so that the page stays below
    ``MAX_MB`` with the pictures of an ordinary plot.

    Returns
    -------
    The path of the report.

    Raises
    ------
    InputError
        ``out`` is not a folder.
    OutputError
        The report cannot be written.
    """
    out = Path(out)
    if not out.is_dir():
        msg = f"{out} is not a folder; give the output folder of fsinfer run (or of fsinfer trees)"
        raise InputError(msg)
    contents = read_contents(out)
    source = contents.plot.get("source")
    # Many a folder of photos is called "photos"; the output folder says more then.
    plain = not source or str(source).lower() in PLAIN_NAMES
    title = f"Forest plot {out.resolve().name if plain else source}"
    versions = contents.plot.get("versions")
    version = versions.get("fsinfer") if isinstance(versions, dict) else None
    subtitle = "Trees measured from photographs with fsinfer" + (f" {version}" if version else "")
    stems, depth = stems_section(contents), depth_section(contents)
    # Eleven bytes a point, four characters for three bytes.
    room = int((MAX_MB * 1e6 - len(stems) - len(depth)) * 3 / 4 / 11)
    page = render_page(
        title,
        subtitle,
        [
            warnings_section(contents),
            tiles(contents),
            plot_section(contents),
            stems,
            table_section(contents),
            cloud_section(contents, max_points=min(max(room, LEAST_POINTS), MAX_POINTS)),
            depth,
            _frames_section(contents),
            _provenance_section(contents),
        ],
    )
    path = out / REPORT_FILE
    write_text(path, page)
    return path


def _frames_section(contents: Contents) -> str:
    frames = contents.frames
    if frames is None:
        return section("Photos", paragraph("frames.csv is not in this folder.", "missing"), anchor="photos")
    rows = [("Photos or video frames looked at", str(len(frames)))]
    column = next((name for name in _CHOSEN_COLUMNS if frames and name in frames[0]), None)
    if column is not None:
        taken = [row for row in frames if row[column].strip().lower() in ("1", "true", "yes")]
        rows.append(("Taken", str(len(taken))))
        rejected = [row for row in frames if row not in taken]
    else:
        rejected = frames
    reasons = Counter(row.get("reason", "").strip() for row in rejected)
    rows += [(f"Reason: {reason}", str(count)) for reason, count in reasons.most_common(12) if reason]
    return section("Photos", facts(rows), _contact_sheet(contents), anchor="photos")


def _contact_sheet(contents: Contents) -> str:
    """What was dropped and why, as the frames stage drew it; nothing where it drew nothing."""
    path = contents.out / "frames" / "frames_contact.jpg"
    if not path.is_file():
        return ""
    try:
        sheet = read_image(path)
    except FsinferError as error:
        return paragraph(f"{path.name} could not be read ({error}).", "missing")
    return (
        "<details><summary>Photos that were left out</summary>"
        f"{embedded_image(shrink(sheet, 1000), 'Left out, with the reason', suffix='.webp')}</details>"
    )


def _provenance_section(contents: Contents) -> str:
    plot = contents.plot
    if not plot:
        return section("How it was made", paragraph("plot.json is not in this folder.", "missing"), anchor="made")
    rows = [("Depth model", str(plot.get("model") or "not known"))]
    rows.append(("SHA-256 of the model", str(plot.get("model_sha256") or "not known")))
    if plot.get("model_precision"):
        rows.append(("Numbers of the regularizer", str(plot["model_precision"])))
    peak = number(plot.get("peak_rss_mb"))
    if peak is not None:
        rows.append(("Largest memory", f"{peak:,.0f} MB"))
    seconds = plot.get("seconds")
    if isinstance(seconds, dict):
        rows += [
            ("Total time" if name == "total" else f"Time for {name}", _duration(value))
            for name, text in seconds.items()
            if (value := number(text)) is not None
        ]
    versions = plot.get("versions")
    if isinstance(versions, dict):
        rows.append(("Versions", ", ".join(f"{name} {text}" for name, text in versions.items() if text)))
    parts = [facts(rows)]
    if plot.get("settings"):
        shown = json.dumps(plot["settings"], indent=1, ensure_ascii=False)
        parts.append(f"<details><summary>All settings</summary><pre>{escape(shown)}</pre></details>")
    return section("How it was made", *parts, anchor="made")


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.1f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"

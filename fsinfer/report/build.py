"""Putting the report together."""

from __future__ import annotations

from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.io.files import write_text
from fsinfer.output.layout import (
    CHECK_FOLDER,
    CLOUD_LAZ,
    CLOUD_PLY,
    DEPTH_FOLDER,
    FIGURES_FOLDER,
    FRAMES_FOLDER,
    FUSED_FOLDER,
    PLOT_FILE,
    RECORDS_FOLDER,
    SCENE_FOLDER,
    TREES_CSV,
)
from fsinfer.report.cloud.data import MAX_POINTS
from fsinfer.report.cloud.depth_part import depth_part
from fsinfer.report.cloud.part import cloud_part, draw_cloud
from fsinfer.report.contents import read_contents
from fsinfer.report.made_part import made_part
from fsinfer.report.page import render_page, render_part
from fsinfer.report.photos_part import photos_part
from fsinfer.report.stems.part import stems_part
from fsinfer.report.summary import plot_part, tiles_part
from fsinfer.report.table_part import table_part
from fsinfer.report.warnings_part import warnings_part
from fsinfer.threads import beside

REPORT_FILE = "report.html"
#: One of these is in a folder that fsinfer wrote into.
_OF_A_RUN = (
    PLOT_FILE, TREES_CSV, CLOUD_PLY, CLOUD_LAZ, FUSED_FOLDER, DEPTH_FOLDER, SCENE_FOLDER, FRAMES_FOLDER, FIGURES_FOLDER,
    CHECK_FOLDER, RECORDS_FOLDER,
)  # fmt: skip
#: The report stays below so many megabytes. Source: layout; most mailboxes take 20.
MAX_MB = 14.0
#: Points of the cloud that it shows at least. Source: layout; stems are still seen.
LEAST_POINTS = 200_000
PLAIN_NAMES = ("photos", "images", "frames", "video.mp4")


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
        ``out`` is not a folder, or none of a run.
    OutputError
        The report cannot be written.
    """
    out = Path(out)
    if not out.is_dir():
        msg = f"{out} is not a folder; give the output folder of fsinfer run (or of fsinfer trees)"
        raise InputError(msg)
    if not any((out / name).exists() for name in _OF_A_RUN):
        msg = f"{out} is no output folder of fsinfer; give the folder that was given to fsinfer run (or fsinfer trees)"
        raise InputError(msg)
    contents = read_contents(out)
    source = contents.plot.get("source")
    # Many a folder of photos is called "photos"; the output folder says more then.
    plain = not source or str(source).lower() in PLAIN_NAMES
    title = f"Forest plot {out.resolve().name if plain else source}"
    versions = contents.plot.get("versions")
    version = versions.get("fsinfer") if isinstance(versions, dict) else None
    source_of_trees = "from photographs" if contents.photographed else "in a point cloud"
    subtitle = f"Trees measured {source_of_trees} with fsinfer" + (f" {version}" if version else "")
    # The stems are looked at by other processes, if by any; meanwhile this one draws the cloud.
    with beside(lambda _: draw_cloud(contents)) as drawn:
        stems, depth = stems_part(contents), render_part(depth_part(contents))
        cloud = drawn()
    rendered_stems = [] if stems is None else [render_part(stems)]
    # Eleven bytes a point, four characters for three bytes.
    room = int((MAX_MB * 1e6 - sum(len(part.html) for part in (*rendered_stems, depth))) * 3 / 4 / 11)
    parts = [
        render_part(warnings_part(contents)),
        render_part(tiles_part(contents)),
        render_part(plot_part(contents)),
        *rendered_stems,
        render_part(table_part(contents)),
        render_part(cloud_part(contents, cloud, max_points=min(max(room, LEAST_POINTS), MAX_POINTS))),
        depth,
        render_part(photos_part(contents)),
        render_part(made_part(contents)),
    ]
    path = out / REPORT_FILE
    write_text(path, render_page(title, subtitle, parts))
    return path

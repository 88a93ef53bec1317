"""``fsinfer scale OUT --click``: the scale by two ends clicked in photographs, and what hangs on it done again.

The clicks are kept in ``OUT/scale_clicks.json``. From then on every run into the folder takes its scale from them,
unless an option names another source; deleting the file undoes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from fsinfer.errors import InputError
from fsinfer.io.files import make_folder
from fsinfer.output.json_values import of_json
from fsinfer.output.plot_json import of_file, read_plot
from fsinfer.progress import StageProgress, silent_stages
from fsinfer.scale.clicks.file import write_clicks
from fsinfer.scale.clicks.server import Clicked, ClickServer
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import check_length
from fsinfer.scene import read_scene
from fsinfer.trees.edit_rows import find_edits
from fsinfer.workflow.given_edits import last_edits
from fsinfer.workflow.kept_clicks import kept_clicks
from fsinfer.workflow.ledger import Ledger
from fsinfer.workflow.photo_stages import FRAMES, POSES
from fsinfer.workflow.pipeline import RunResult, run_from_scene
from fsinfer.workflow.settings import RunSettings


@dataclass(frozen=True, kw_only=True)
class ClickedScale:
    """The scale that was clicked; ``run`` is None where the folder's run had not come to its end before."""

    clicked: Clicked
    run: RunResult | None


def click_scale(
    out: Path, length_m: float, *, show: Callable[[str], None], progress: StageProgress = silent_stages
) -> ClickedScale:
    """Wait for the clicks on a page of this computer, keep them, and do again what hangs on the scale.

    Parameters
    ----------
    out: output folder with a registered scene.
    length_m: real distance of the two ends, metres.
    show: is given the address of the page; opens it.

    Raises
    ------
    SceneError, InputError, ScaleError
        There is no scene, or no length, or corrections of the last run are gone; nothing was written then.
    OutputError
        Nothing can be written into ``out``.
    """
    check_length(length_m, "--length-m")
    if not out.is_dir():
        msg = f"{out} is not a folder; give the output folder of fsinfer run"
        raise InputError(msg)
    scene = read_scene(out / "scene")
    if len(scene.views) < 2:
        msg = f"{out / 'scene'} has {len(scene.views)} photograph; two from different places are needed"
        raise InputError(msg)
    edits = last_edits(out)
    find_edits(out, edits)  # what cannot be read, or written, must not show after the clicks
    make_folder(out)
    with ClickServer(scene, length_m, kept_clicks(out), lambda saved: write_clicks(out, saved)) as server:
        show(server.url)
        clicked = server.wait()
    return ClickedScale(clicked=clicked, run=_run_again(out, clicked, edits, progress))


def _run_again(out: Path, clicked: Clicked, edits: Path | None, progress: StageProgress) -> RunResult | None:
    """The stages from the scene on, with the settings and corrections of the last run; None where it has no end."""
    ledger = Ledger(out)
    frames, poses = ledger.recall(FRAMES), ledger.recall(POSES)
    plot = of_file(read_plot(out))
    if frames is None or poses is None or not plot.get("settings"):
        return None
    try:
        settings = of_json(RunSettings, plot["settings"])
    except (TypeError, ValueError, KeyError, OverflowError):
        return None  # of another version of fsinfer: what its settings mean now is for its user to say
    # Another source gives way; which boards are looked for, round which the border may lie, stays.
    dictionary, printed = settings.scale.aruco_dictionary, settings.scale.printed_boards
    by_clicks = ScaleRequest(clicks=clicked.clicks, aruco_dictionary=dictionary, printed_boards=printed)
    settings = replace(settings, scale=by_clicks)
    source = str(plot.get("source") or out.name)
    return run_from_scene(ledger, frames, poses, settings=settings, source=source, edits=edits, progress=progress)

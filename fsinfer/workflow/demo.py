"""``fsinfer demo``: the whole job on a small plot that comes with the package, compared with the truth.

The plot is rendered (``training/synthesize``), so the truth is exact; its photographs go through every stage as
those of a user would.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from fsinfer.depth.settings import DepthSettings
from fsinfer.errors import InputError
from fsinfer.evaluation.measured import MeasuredTree, read_measured
from fsinfer.evaluation.metrics import Evaluation, evaluate
from fsinfer.io.files import atomic_path, make_folder
from fsinfer.io.photo_folders import PHOTO_SUFFIXES
from fsinfer.progress import StageProgress, silent_stages
from fsinfer.scale.request import ScaleRequest
from fsinfer.trees import Tree
from fsinfer.trees.outputs.table import read_trees
from fsinfer.workflow.pipeline import RunResult, run
from fsinfer.workflow.settings import RunSettings

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

#: Side of the black square of the markers that stand in the rendered plot, metres. Source: format; how it was rendered.
ARUCO_LENGTH_M = 0.25


@dataclass(frozen=True, kw_only=True)
class DemoResult:
    """What the demo left in ``run.out``, and how its trees compare with those of ``truth.csv`` there."""

    run: RunResult
    trees: tuple[Tree, ...]
    truth: tuple[MeasuredTree, ...]
    evaluation: Evaluation


def run_demo(
    out: Path,
    *,
    model: str = DepthSettings.model,
    max_size_px: int = 960,
    threads: int = 0,
    progress: StageProgress = silent_stages,
) -> DemoResult:
    """Copy the demo photographs into ``out/photos``, run the pipeline, compare with the truth.

    Parameters
    ----------
    out: output folder; what an earlier demo finished there is kept.
    model: name of a shipped depth model, or path of a manifest.
    max_size_px: longer side of the images for depth; the photographs have 960 pixels.
    threads: 0 uses every core.
    progress: gives the progress callback for a stage's name.

    Raises
    ------
    InputError
        The package came without its demo plot.
    FsinferError
        Any stage's error.
    """
    data = resources.files("fsinfer") / "demo_data"
    if not (data / "truth.csv").is_file():
        msg = "this installation of fsinfer has no demo plot; install fsinfer again"
        raise InputError(msg)
    out = Path(out)
    if out.is_dir() and any(path.suffix.lower() in PHOTO_SUFFIXES for path in out.iterdir()):
        msg = f"{out} holds photos; give the demo a folder of its own, like {out.resolve().name}-demo"
        raise InputError(msg)
    photos = make_folder(out / "photos")
    for photo in (data / "photos").iterdir():
        _copy(photo, photos / photo.name)
    truth = out / "truth.csv"
    _copy(data / "truth.csv", truth)
    settings = RunSettings(
        depth=DepthSettings(model=model, max_size_px=max_size_px, threads=threads),
        scale=ScaleRequest(aruco_length_m=ARUCO_LENGTH_M),
    )
    result = run(photos, out, settings=settings, progress=progress)
    # The plot's frame starts somewhere in the photographs: positions are compared after moving and turning.
    measured, trees = read_measured(truth), read_trees(out / "trees.csv")
    # The photographs also show trees beyond the plot, of which the truth says nothing.
    evaluation = evaluate(measured, trees, align="auto", area_margin_m=1.0)
    return DemoResult(run=result, trees=tuple(trees), truth=tuple(measured), evaluation=evaluation)


def _copy(source: Traversable, target: Path) -> None:
    data = source.read_bytes()
    if target.is_file() and target.read_bytes() == data:
        return
    with atomic_path(target) as temporary:
        temporary.write_bytes(data)

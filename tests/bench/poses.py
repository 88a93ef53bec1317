"""Structure from motion on a rendered plot: seconds of each step and error of the cameras, for any settings.

python -m tests.bench.poses PLOT --set max_features=4000 pairs.overlap=6 --photos 80
python -m tests.bench.poses PLOT --photos 80 --step 3 --set thorough.min_share=0    torn, and not looked at again
python -m tests.bench.poses PLOT --photos 40 --equalize clahe      evened out first, as ``fsinfer frames`` does

``PLOT`` is a scene of ``training.synthesize --kind plot`` (or any scene in MVSNet format whose cameras are true).
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fsinfer.frames.quality import EQUALIZERS, equalize
from fsinfer.io.images import read_image, write_image
from fsinfer.poses.estimate import estimate_poses
from fsinfer.poses.pairs import PairSettings
from fsinfer.poses.settings import PoseSettings, ThoroughSettings
from fsinfer.scene import Scene, read_scene
from tests.bench.plot import plot_settings, similarity
from tests.bench.results import add_result_options, check_result_options, save_result

Settings = TypeVar("Settings", PoseSettings, PairSettings, ThoroughSettings)
#: Of the cameras, see :func:`camera_errors`.
ERRORS = ("center_rms_mm", "center_max_mm", "angle_median_deg", "angle_max_deg")


class Stopwatch:
    """A progress callback that adds up the seconds of each step by its name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._step, self._since = "start", time.monotonic()

    def __call__(self, _done: int, _total: int, step: str) -> None:
        """Note the time when the step changes."""
        now = time.monotonic()
        self.seconds[self._step] = self.seconds.get(self._step, 0.0) + now - self._since
        self._step, self._since = step, now


def camera_errors(found: Scene, truth: Scene) -> dict[str, float]:
    """Errors of the camera centres (mm, if the truth is in metres) and of the directions (degrees)."""
    true = {view.name: view.camera.cam_from_world for view in truth.views}
    pairs = [(view.camera.cam_from_world, true[view.name]) for view in found.views if view.name in true]
    ours, theirs = (np.stack(poses) for poses in zip(*pairs, strict=True))
    centers = [-np.einsum("nji,nj->ni", p[:, :3, :3], p[:, :3, 3]) for p in (ours, theirs)]
    scale, rotation, shift = similarity(*centers)
    distance = np.linalg.norm(scale * centers[0] @ rotation.T + shift - centers[1], axis=1)
    turn = np.einsum("nij,jk,nlk->nil", ours[:, :3, :3], rotation.T, theirs[:, :3, :3])
    angle = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    return {
        "center_rms_mm": 1000 * float(np.sqrt((distance**2).mean())),
        "center_max_mm": 1000 * float(distance.max()),
        "angle_median_deg": float(np.median(angle)),
        "angle_max_deg": float(angle.max()),
    }


def parse_settings(pairs: list[str]) -> PoseSettings:
    """``name=value`` pairs to :class:`PoseSettings`."""
    settings = PoseSettings()
    for pair in pairs:
        name, _, value = pair.partition("=")
        if name.startswith("pairs."):
            settings = replace(settings, pairs=changed(settings.pairs, name.removeprefix("pairs."), value))
        elif name.startswith("thorough."):
            settings = replace(settings, thorough=changed(settings.thorough, name.removeprefix("thorough."), value))
        else:
            settings = changed(settings, name, value)
    return settings


def changed(settings: Settings, name: str, value: str) -> Settings:
    """A copy of a dataclass with one field read from a string."""
    return replace(settings, **{name: type(getattr(settings, name))(value)})


def main(argv: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.poses", description=__doc__)
    parser.add_argument("plot", type=Path)
    parser.add_argument("--photos", type=int, default=0, help="only the first so many; 0 = all")
    parser.add_argument("--step", type=int, default=1, help="of those every so many-th: a walk with longer steps")
    parser.add_argument(
        "--set",
        action="extend",
        nargs="*",
        default=[],
        metavar="NAME=VALUE",
        help="fields of PoseSettings; pairs.NAME and thorough.NAME of its PairSettings and ThoroughSettings",
    )
    parser.add_argument("--equalize", choices=EQUALIZERS, default="none", help="of fsinfer frames")
    parser.add_argument("--out", type=Path, help="keep the scene here")
    add_result_options(parser)
    arguments = parser.parse_args(argv)
    check_result_options(parser, arguments)
    truth = read_scene(arguments.plot)
    views = truth.views[: arguments.photos or None : arguments.step]
    with tempfile.TemporaryDirectory() as temporary:
        photos = Path(temporary) / "photos"
        photos.mkdir()
        for view in views:
            if arguments.equalize == "none":
                shutil.copy(view.image_path, photos)
            else:
                image = equalize(read_image(view.image_path), arguments.equalize)
                write_image(photos / f"{view.name}.jpg", image, quality=97)
        out = arguments.out or Path(temporary) / "scene"
        watch = Stopwatch()
        started = time.monotonic()
        result = estimate_poses(photos, out, settings=parse_settings(arguments.set), progress=watch)
        seconds = time.monotonic() - started
        record = json.loads((out / "poses.json").read_text(encoding="utf-8"))
        row: dict[str, Any] = {
            "settings": arguments.set,
            "equalize": arguments.equalize,
            "photos": result.photos,
            "registered": result.registered,
            "seconds": round(seconds, 1),
            "steps": {name: round(spent, 1) for name, spent in watch.seconds.items() if spent >= 0.1},
            "points": record["points"],
            "reprojection_px": round(record["mean_reprojection_error_px"], 3),
            **{name: round(value, 4) for name, value in camera_errors(read_scene(out), truth).items()},
        }
    print(json.dumps(row))
    numbers = ("photos", "registered", "seconds", "points", "reprojection_px", *ERRORS)
    figures = {name: row[name] for name in numbers}
    figures |= {f"{name.replace(' ', '_').replace('-', '_')}_s": spent for name, spent in row["steps"].items()}
    settings = {"set": arguments.set, "plot": plot_settings(arguments.plot)}
    save_result(arguments, figures, module="tests.bench.poses", arguments=argv, settings=settings)


if __name__ == "__main__":
    main()

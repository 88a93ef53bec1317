"""Which of a phone's effects tears a walk: each alone and doubled, ours beside COLMAP's default settings.

python -m tests.bench.effects OUT --textures PHOTOS [--photos 60] [--width 960 --height 540] [--only wind] [--colmap]

Each effect is rendered on the same walk through the same plot (``training.synthesize --effect``), its photographs go
through ``fsinfer run`` (``ours``: poses, and diameters against the truth), are mapped by the same poses without a
second look (``cheap``), and with ``--colmap`` by COLMAP's default settings: photographs doubled, 8,192 features, each
matched with its next 12. A photograph is placed rightly within 5 cm of its true place, after the similarity that most
photographs agree with. What is done is kept in OUT and not repeated.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import FsinferError, PosesError
from fsinfer.poses.colmap import colmap_errors
from fsinfer.poses.estimate import estimate_poses
from fsinfer.poses.settings import PoseSettings
from fsinfer.progress import Progress
from fsinfer.scale.request import ScaleRequest
from fsinfer.scene import read_scene
from fsinfer.workflow.pipeline import run
from fsinfer.workflow.settings import RunSettings
from tests.bench.plot import placed_trees, similarity
from tests.bench.results import add_result_options, check_result_options, save_result
from training.synthesize.__main__ import main as synthesize
from training.synthesize.cameras.phone import PHONE

RIGHT_M = 0.05
#: What the poses stage calls its second look.
SECOND_LOOK = "looking again where the walk tore"
#: Side of the rendered boards' squares.
BOARD_M = 0.25
#: Fields of ``PhoneEffects`` that belong together.
EFFECTS: Mapping[str, tuple[str, ...]] = {
    "rolling": ("readout_s", "walk_m_s", "turn_rad_s"),
    "blur": ("exposure_s", "walk_m_s", "turn_rad_s"),
    "breathing": ("breathing",),
    "principal": ("principal_px",),
    "distortion": ("distortion",),
    "exposure": ("exposure_spread", "clouds"),
    "tone": ("tone", "noise", "sharpening", "glare"),
    "wind": ("wind_m",),
    "bark": ("own_bark",),
}
#: Of those that belong together, what doubling doubles; speeds stay those of a walk.
DOUBLED = {"rolling": ("readout_s",), "blur": ("exposure_s",)}


def cases(only: Sequence[str]) -> dict[str, list[str]]:
    """Name of each case to the options of ``training.synthesize`` that make it."""
    found: dict[str, list[str]] = {"none": ["--effect", "own_bark=0"]}
    for name, fields in EFFECTS.items():
        for times in (1, 2):
            if name == "bark" and times == 2:
                continue
            pairs = []
            for field in fields:
                value = getattr(PHONE, field)
                if field == "noise":
                    value = 1 + times * (value - 1)
                elif field == "clouds":
                    value = min(1.0, times * value)
                elif field in DOUBLED.get(name, fields):
                    value = times * value
                pairs.append(f"{field}={value}")
            found[name if times == 1 else f"{name}2"] = ["--effect", *pairs]
    found |= {"phone": ["--phone"], "video": ["--phone-video"]}
    return {name: options for name, options in found.items() if not only or name in only}


def rightly_placed(
    found: Mapping[str, NDArray[np.float64]], truth: Mapping[str, NDArray[np.float64]]
) -> tuple[int, float]:
    """How many camera centres lie within ``RIGHT_M`` of the truth, and their root mean square error in millimetres.

    The similarity is that of a random handful of photographs with which most agree, then that of all these.
    """
    names = sorted(found)
    if len(names) < 4:
        return 0, float("nan")
    ours, true = np.array([found[n] for n in names]), np.array([truth[n] for n in names])
    rng = np.random.default_rng(0)
    best = np.zeros(len(names), bool)
    for _ in range(300):
        chosen = rng.choice(len(names), 4, replace=False)
        scale, rotation, shift = similarity(ours[chosen], true[chosen])
        # A handful gives a rough similarity only: three times the gate, until all that agree are taken.
        near = np.linalg.norm(scale * ours @ rotation.T + shift - true, axis=1) < 3 * RIGHT_M
        if near.sum() > best.sum():
            best = near
    for _ in range(5):
        if best.sum() < 3:
            return 0, float("nan")
        scale, rotation, shift = similarity(ours[best], true[best])
        error = np.linalg.norm(scale * ours @ rotation.T + shift - true, axis=1)
        best = error < RIGHT_M
    return int(best.sum()), 1000 * float(np.sqrt((error[best] ** 2).mean())) if best.any() else float("nan")


def centers_of(scene: Path) -> dict[str, NDArray[np.float64]]:
    """Camera centres of a scene by name."""
    return {view.name: view.camera.center for view in read_scene(scene).views}


def by_run(photos: Path, plot: Path, out: Path) -> tuple[dict[str, NDArray[np.float64]], dict[str, Any]]:
    """Centres that ``fsinfer run`` finds, its trees against the truth, and whether it looked at photographs again.

    Nothing of these where it gives up.
    """
    steps: set[str] = set()

    def watch(_stage: str) -> Progress:
        return lambda _done, _total, step: steps.add(step)

    try:
        run(photos, out, settings=RunSettings(scale=ScaleRequest(aruco_length_m=BOARD_M)), progress=watch)
    except FsinferError as error:
        print(f"  {error}")
        return {}, {"again": True}
    found = placed_trees(plot, out).evaluation
    figures = {"trees": found.n, "matched": found.matched, "false": found.false, "again": SECOND_LOOK in steps}
    diameters = {"rmse_cm": found.rmse_cm, "bias_cm": found.bias_cm}
    return centers_of(out / "scene"), figures | {k: round(v, 3) for k, v in diameters.items() if v is not None}


def by_us(photos: Path, work: Path, settings: PoseSettings) -> dict[str, NDArray[np.float64]]:
    """Centres that ``estimate_poses`` finds; none where it gives up."""
    try:
        return centers_of(estimate_poses(photos, work / "cheap", settings=settings).scene)
    except PosesError as error:
        print(f"  {error}")
        return {}


def by_colmap(photos: Path, work: Path) -> dict[str, NDArray[np.float64]]:
    """Centres of the largest model that COLMAP's default settings find."""
    import pycolmap

    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    database = work / "database.db"
    names = sorted(path.name for path in photos.iterdir())
    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    extraction.use_gpu = matching.use_gpu = False
    listed = work / "pairs.txt"
    count = len(names)
    pairs = [(i, j) for i in range(count) for j in range(i + 1, min(i + 13, count))]
    listed.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in pairs), encoding="utf-8")
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    with colmap_errors("mapping", work):
        pycolmap.extract_features(
            database,
            photos,
            camera_mode=pycolmap.CameraMode.SINGLE,
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )
        pycolmap.match_image_pairs(
            database, matching_options=matching, pairing_options=pairing, device=pycolmap.Device.cpu
        )
        models = pycolmap.incremental_mapping(database, photos, work)
    if not models:
        return {}
    largest = max(models.values(), key=lambda model: model.num_reg_images())
    images = (largest.images[i] for i in largest.reg_image_ids())
    return {Path(image.name).stem: image.projection_center() for image in images}


def measured(name: str, plot: Path, out: Path, args: argparse.Namespace) -> dict[str, Any]:
    """One row of the table."""
    photos = out / name / "photos"
    shutil.rmtree(photos, ignore_errors=True)
    photos.mkdir(parents=True)
    chosen = sorted((plot / "images").iterdir())[:: args.step]
    for path in chosen:
        shutil.copy(path, photos)
    truth = centers_of(plot)
    thorough = PoseSettings()
    cheap = replace(thorough, thorough=replace(thorough.thorough, min_share=0.0))
    row: dict[str, Any] = {"case": name, "photos": len(chosen)}
    for way in ("ours", "cheap", "colmap") if args.colmap else ("ours", "cheap"):
        kept = out / name / f"{way}.json"
        if way == "cheap" and not kept.is_file() and not row.get("ours_again", True):
            # What was not looked at again is what the first look found.
            kept.write_text(json.dumps({k: row[f"ours_{k}"] for k in ("placed", "right", "rms_mm")}) + "\n", "utf-8")
        if not kept.is_file():
            started = time.monotonic()
            found: dict[str, Any] = {}
            if way == "ours":
                centers, found = by_run(photos, plot, out / name / way)
            else:
                centers = by_colmap(photos, out / name / way) if way == "colmap" else by_us(photos, out / name, cheap)
            right, rms_mm = rightly_placed(centers, truth)
            found |= {"placed": len(centers), "right": right, "rms_mm": round(rms_mm, 1)}
            found["s"] = round(time.monotonic() - started, 1)
            kept.write_text(json.dumps(found) + "\n", encoding="utf-8")
        row |= {f"{way}_{key}": value for key, value in json.loads(kept.read_text(encoding="utf-8")).items()}
    return row


def main(argv: list[str] | None = None) -> int:
    """Render, map, print."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.effects", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--textures", type=Path)
    parser.add_argument("--texture-names")
    parser.add_argument("--seed", type=int, default=881000)
    parser.add_argument("--photos", type=int, default=60)
    parser.add_argument("--radius-m", type=float, default=5.0, help="of the plot; the walk is as long as it is wide")
    parser.add_argument("--trees", type=int, default=16)
    parser.add_argument("--width", type=int, default=1280, help="what is told in pixels is not made smaller with it")
    parser.add_argument("--height", type=int, default=720)
    parser.add_argument("--step", type=int, default=1, help="of the rendered photographs every so many-th is used")
    parser.add_argument("--only", action="extend", nargs="*", default=[], choices=[*cases([])], metavar="CASE")
    parser.add_argument("--colmap", action="store_true", help="COLMAP's default settings beside; minutes a case")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    rows = []
    for name, options in cases(args.only).items():
        plot, done = args.out / name / "plot", args.out / name / "row.json"
        if not done.is_file():
            textures = ["--textures", str(args.textures)] if args.textures else []
            textures += ["--texture-names", args.texture_names] if args.texture_names else []
            walk = ["--kind", "plot", "--seed", str(args.seed), "--photos", str(args.photos)]
            walk += ["--trees", str(args.trees), "--radius-m", str(args.radius_m)]
            size = ["--width", str(args.width), "--height", str(args.height)]
            if len(list((plot / "images").glob("*"))) < args.photos:
                synthesize([str(plot), *walk, *size, *textures, *options])
            done.write_text(json.dumps(measured(name, plot, args.out, args)) + "\n", encoding="utf-8")
        row = json.loads(done.read_text(encoding="utf-8"))
        rows.append(row)
        print(json.dumps(row), flush=True)
    figures = {
        f"{row['case']}_{key}": value for row in rows for key, value in row.items() if isinstance(value, int | float)
    }
    settings = {"seed": args.seed, "photos": args.photos, "step": args.step, "size": [args.width, args.height]}
    settings |= {"trees": args.trees, "radius_m": args.radius_m}
    save_result(args, figures, module="tests.bench.effects", arguments=argv, settings=settings)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

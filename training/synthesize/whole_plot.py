"""All photographs of a plot, for the pipeline; by several processes at a time where asked."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from pathlib import Path

import cv2
import numpy as np

from fsinfer.io.files import write_text
from training.synthesize.asked import phone_effects
from training.synthesize.cameras.phone import PhoneEffects
from training.synthesize.cameras.photo import expose
from training.synthesize.cameras.plot import plot_cameras
from training.synthesize.forest.world import World, WorldSettings, build_world
from training.synthesize.photographs import Photographs, with_effects
from training.synthesize.render import Caster
from training.synthesize.scene_writer import (
    finish_scene,
    finished,
    read_record,
    read_view_depth,
    view_written,
    with_depth_range,
    write_record,
    write_truth,
    write_truth_curves,
    write_view,
)

#: What a plot that is not finished was begun with: views of two worlds in one folder would have the truth of one.
BEGUN = "begun.json"
#: How many plots a command renders, which is nothing of each of them.
SET_OF_PLOTS = {"scenes"}


def plot_settings(args: argparse.Namespace, photos: tuple[Path, ...], effects: PhoneEffects | None) -> WorldSettings:
    """The world that the options ask for."""
    settings = WorldSettings(
        radius_m=args.radius_m,
        outer_m=args.radius_m + 22,
        trees=args.trees,
        outer_trees=round(args.trees * 2.5),
        slope_deg=args.slope_deg,
        roughness=0.5,
        undergrowth=args.undergrowth,
        season=args.season,
        clutter=False,
        detail_radius_m=args.radius_m + 3,
        ground_step_m=0.06,
        outer_gap_m=2.3,
        outer_sides=64,
        outer_step_m=0.05,
        targets=args.boards,
        texture_px=args.texture_px,
        photos=photos,
        photo_share=1.0 if args.texture_names else args.photo_share,
        min_dbh_m=args.min_dbh_cm / 100,
        max_dbh_m=args.max_dbh_cm / 100,
        double_faced=args.double_faced,
    )
    return with_effects(settings, effects)


class _Plot:
    """The plot of a seed, ready to be photographed: the same in every process."""

    def __init__(self, args: argparse.Namespace, seed: int, photos: tuple[Path, ...]) -> None:
        self._args, self._seed = args, seed
        width, height = args.width or 1280, args.height or 720
        self.effects = phone_effects(args)
        self.settings = plot_settings(args, photos, self.effects)
        self.world: World = build_world(np.random.default_rng([seed, 1]), self.settings)
        caster = Caster.of(self.world)
        rng = np.random.default_rng([seed, 2])
        cameras = plot_cameras(
            rng,
            self.world.terrain,
            self.world.obstacles,
            radius_m=args.radius_m,
            photos=args.photos,
            width=width,
            height=height,
            hfov_deg=args.hfov_deg,
            zigzag=args.zigzag,
            both_ways=args.both_ways,
        )
        self.taken = Photographs(caster, self.world, cameras, self.effects, (seed,), (width, height), args.supersample)
        self.sensor = self.taken.sensor(rng, caster.picture(cameras[0], width, height, 1))

    def write(self, folder: Path, i: int) -> None:
        """Photograph ``i``, unless it is there."""
        if view_written(folder, i):
            return
        depth, picture = self.taken.depth_and_picture(i, self._args.distortion)
        photo = expose(np.random.default_rng([self._seed, 3, i]), self.sensor, picture)
        camera = with_depth_range(self.taken.cameras[i], depth, 25.0)
        write_view(folder, i, photo, depth, camera, self.sensor.quality)


def write_share(args: argparse.Namespace, seed: int, photos: tuple[Path, ...], folder: Path, share: int) -> None:
    """What worker ``share`` does: every ``args.workers``-th photograph from there, of a plot that it builds itself."""
    cv2.setNumThreads(1)
    plot = _Plot(args, seed, photos)
    for i in range(share, len(plot.taken.cameras), args.workers):
        plot.write(folder, i)


def _refuse_another_plot(folder: Path, seed: int, options: dict[str, str]) -> None:
    """End with a message where ``folder`` holds a plot, whole or in part, that was rendered with other options."""
    for record in (read_record(folder), read_record(folder, BEGUN)):
        before = record.get("options", {}) | {"seed": str(record.get("seed", seed))}
        asked = options | {"seed": str(seed)}
        for name in sorted(asked.keys() & before.keys() - SET_OF_PLOTS):
            if asked[name] != before[name]:
                option = "--" + name.replace("_", "-")
                raise SystemExit(
                    f"{folder} holds views of a plot with {option} {before[name]}, and {option} {asked[name]} is asked "
                    "for; give another OUT, or delete it"
                )


def synthesize_plot(args: argparse.Namespace, seed: int, photos: tuple[Path, ...], folder: Path) -> None:
    """Render one plot into ``folder``; views that are there already are kept, and those of another plot refused."""
    options = {k: str(v) for k, v in vars(args).items() if k not in ("out", "textures", "workers")}
    _refuse_another_plot(folder, seed, options)
    if finished(folder):
        return
    start = time.perf_counter()
    write_record(folder, {"seed": seed, "options": options}, BEGUN)
    apart = multiprocessing.get_context("spawn")
    helpers = [
        apart.Process(target=write_share, args=(args, seed, photos, folder, share)) for share in range(1, args.workers)
    ]
    for helper in helpers:
        helper.start()
    plot = _Plot(args, seed, photos)
    cameras, world = plot.taken.cameras, plot.world
    if plot.taken.shots is not None:
        write_text(folder / "shots.json", json.dumps([shot.record() for shot in plot.taken.shots], indent=1) + "\n")
    inside = world.in_plot
    write_truth(folder / "truth.csv", world.stems[:inside], world.sections[:inside])
    write_truth_curves(folder / "truth_curve.csv", world.curves)
    write_truth(folder / "truth_outside.csv", world.stems[inside:], world.sections[inside:])
    write_text(folder / "markers.json", json.dumps(world.markers, indent=1) + "\n")
    print(
        f"plot {seed}: {inside} trees, {len(cameras)} photos, built in {time.perf_counter() - start:.1f} s", flush=True
    )
    for number, i in enumerate(range(0, len(cameras), args.workers), start=1):
        plot.write(folder, i)
        if number % 10 == 0:
            print(f"  view {i + 1}/{len(cameras)}, {time.perf_counter() - start:.0f} s", flush=True)
    for helper in helpers:
        helper.join()
        if helper.exitcode:
            raise SystemExit(f"a worker ended with exit code {helper.exitcode}; run it again, what is there is kept")
    finish_scene(folder, cameras, [read_view_depth(folder, i) for i in range(len(cameras))])
    drawn = vars(plot.settings) | {"photos": [p.name for p in photos]}
    if plot.effects is not None:
        drawn |= {"effects": vars(plot.effects)}
    record = {"seed": seed, "kind": "plot", "options": options, "settings": drawn, "sensor": vars(plot.sensor)}
    write_record(folder, record)
    (folder / BEGUN).unlink()

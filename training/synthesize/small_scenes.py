"""Scenes of a few views: clusters for training, bursts for calibration, walks for validation and test."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.scene import Camera
from training.synthesize.asked import phone_effects
from training.synthesize.cameras.burst import burst_cameras
from training.synthesize.cameras.cluster import cluster_cameras
from training.synthesize.cameras.photo import Sensor, expose
from training.synthesize.cameras.plot import plot_cameras
from training.synthesize.forest.world import World, WorldSettings, build_world
from training.synthesize.photographs import Photographs, for_training, with_effects
from training.synthesize.render import Caster
from training.synthesize.scene_writer import (
    finish_scene,
    finished,
    with_depth_range,
    write_record,
    write_truth,
    write_view,
)


def cluster_settings(rng: np.random.Generator, photos: tuple[Path, ...], args: argparse.Namespace) -> WorldSettings:
    """Draw what kind of small world a training scene shows."""
    clutter = bool(rng.random() < args.clutter)
    alone = clutter and rng.random() < 0.5
    return WorldSettings(
        radius_m=7.0,
        outer_m=28.0,
        trees=0 if alone else int(rng.integers(4, 16)),
        outer_trees=int(rng.integers(0, 12)) if alone else int(rng.integers(15, 100)),
        slope_deg=float(rng.uniform(0, 20)) if rng.random() < 0.6 else float(rng.uniform(0, 4)),
        roughness=float(rng.uniform(0.2, 1.0)),
        undergrowth=float(rng.uniform(0, 1)) ** 1.5,
        season=str(rng.choice(["summer", "summer", "winter"])),
        clutter=clutter,
        detail_radius_m=9.0,
        ground_step_m=0.06,
        texture_px=args.texture_px,
        panorama_px=512,
        photos=photos,
        photo_share=args.photo_share,
    )


def synthesize_clusters(args: argparse.Namespace, seed: int, photos: tuple[Path, ...]) -> None:
    """Render the clusters of one seed."""
    folders = [args.out / f"s{seed:05d}_{c}" for c in range(args.clusters_per_scene)]
    if all(finished(f) for f in folders):
        return
    width, height = args.width or 384, args.height or 288
    start = time.perf_counter()
    rng = np.random.default_rng([seed, 1])
    effects = for_training(phone_effects(args), np.random.default_rng([seed, 6]))
    settings = with_effects(cluster_settings(rng, photos, args), effects)
    world = build_world(rng, settings)
    caster = Caster.of(world)
    built = time.perf_counter() - start
    for number, folder in enumerate(folders):
        if finished(folder):
            continue
        rng = np.random.default_rng([seed, 2, number])
        wide = bool(args.wide_share) and bool(rng.random() < args.wide_share)
        cameras = cluster_cameras(rng, world, caster, views=args.views, width=width, height=height, wide=wide)
        taken = Photographs(caster, world, cameras, effects, (seed, 2, number), (width, height), args.supersample)
        depths, pictures, sensor = taken.all(rng)
        cap = float(rng.uniform(20, 30))
        write_views(folder, rng, sensor, taken.cameras, depths, pictures, cap_m=cap)
        write_truth(folder / "truth.csv", world.stems[: world.in_plot], world.sections[: world.in_plot])
        write_record(
            folder,
            {
                "seed": seed,
                "kind": "cluster",
                "cluster": number,
                "wide": wide,
                "settings": vars(settings) | {"photos": [p.name for p in photos]},
                "sensor": vars(sensor),
                "effects": None if effects is None else vars(effects),
                "views": args.views,
                "width": width,
                "height": height,
            },
        )
    print(f"s{seed:05d}: built in {built:.1f} s, all in {time.perf_counter() - start:.1f} s", flush=True)


def synthesize_burst(args: argparse.Namespace, seed: int, photos: tuple[Path, ...]) -> None:
    """Render ``args.views`` photographs from beside each other in the small world of one seed."""
    folder = args.out / f"n{seed:05d}"
    if finished(folder):
        return
    width, height = args.width or 1280, args.height or 720
    start = time.perf_counter()
    rng = np.random.default_rng([seed, 1])
    settings = cluster_settings(rng, photos, args)
    world = build_world(rng, settings)
    caster = Caster.of(world)
    rng = np.random.default_rng([seed, 2])
    camera = cluster_cameras(rng, world, caster, views=1, width=width, height=height)[0]
    there = caster.depth(camera, width, height)
    cameras = burst_cameras(rng, camera, float(np.median(there[there > 0])), args.views)
    taken = Photographs(caster, world, cameras, None, (seed,), (width, height), args.supersample)
    depths, pictures, sensor = taken.all(rng)
    write_views(folder, rng, sensor, cameras, depths, pictures, cap_m=30.0)
    drawn = vars(settings) | {"photos": [p.name for p in photos]}
    write_record(folder, {"seed": seed, "kind": "burst", "settings": drawn, "sensor": vars(sensor)})
    print(f"n{seed:05d}: {len(cameras)} views in {time.perf_counter() - start:.0f} s", flush=True)


def walk_settings(rng: np.random.Generator, photos: tuple[Path, ...], args: argparse.Namespace) -> WorldSettings:
    """Draw a plot: open or dense, level or steep, bare or overgrown."""
    radius = float(rng.uniform(4, 8))
    trees = max(3, round(np.pi * radius**2 * float(rng.uniform(0.06, 0.2))))
    return WorldSettings(
        radius_m=radius,
        outer_m=radius + 22,
        trees=trees,
        outer_trees=round(trees * float(rng.uniform(1, 3))),
        slope_deg=float(rng.uniform(0, 22)),
        roughness=float(rng.uniform(0.2, 1.0)),
        undergrowth=float(rng.uniform(0, 1)),
        season=str(rng.choice(["summer", "summer", "winter"])),
        clutter=False,
        detail_radius_m=radius + 3,
        ground_step_m=0.06,
        outer_gap_m=2.3,
        outer_sides=64,
        outer_step_m=0.05,
        targets=int(rng.integers(0, 4)),
        texture_px=args.texture_px,
        photos=photos,
        photo_share=args.photo_share,
        max_dbh_m=float(rng.uniform(0.3, 0.7)),
    )


def walk_cameras(
    rng: np.random.Generator, world: World, radius_m: float, *, photos: int, size: tuple[int, int]
) -> list[Camera]:
    """The cameras of a walk through a plot, with a lens drawn at random; ``size`` is that of its photographs."""
    return plot_cameras(
        rng,
        world.terrain,
        world.obstacles,
        radius_m=radius_m,
        photos=photos,
        width=size[0],
        height=size[1],
        hfov_deg=float(rng.uniform(52, 76)),
    )


def synthesize_walk(args: argparse.Namespace, seed: int, photos: tuple[Path, ...]) -> None:
    """Render ``args.views`` photographs in a row of a walk through the plot of one seed."""
    folder = args.out / f"w{seed:05d}"
    if finished(folder):
        return
    width, height = args.width or 1280, args.height or 720
    start = time.perf_counter()
    rng = np.random.default_rng([seed, 1])
    effects = for_training(phone_effects(args), np.random.default_rng([seed, 6]))
    settings = with_effects(walk_settings(rng, photos, args), effects)
    world = build_world(rng, settings)
    caster = Caster.of(world)
    rng = np.random.default_rng([seed, 2])
    photos_of_walk = int(settings.radius_m * rng.uniform(15, 32))  # 0.25 to 0.6 m from one to the next
    cameras = walk_cameras(rng, world, settings.radius_m, photos=photos_of_walk, size=(width, height))
    first = int(rng.integers(len(cameras) - args.views))
    cameras = cameras[first : first + args.views]
    taken = Photographs(caster, world, cameras, effects, (seed,), (width, height), args.supersample)
    depths, pictures, sensor = taken.all(rng)
    write_views(folder, rng, sensor, taken.cameras, depths, pictures, cap_m=25.0)
    drawn = vars(settings) | {"photos": [p.name for p in photos]}
    record = {"seed": seed, "kind": "walk", "first": first, "settings": drawn, "sensor": vars(sensor)}
    write_record(folder, record | {"effects": None if effects is None else vars(effects)})
    print(f"w{seed:05d}: {len(cameras)} views in {time.perf_counter() - start:.0f} s", flush=True)


def write_views(
    folder: Path,
    rng: np.random.Generator,
    sensor: Sensor,
    cameras: Sequence[Camera],
    depths: Sequence[NDArray[np.float32]],
    pictures: Sequence[NDArray[np.float32]],
    *,
    cap_m: float,
) -> None:
    """Expose and write all views of a scene, and ``pair.txt``; depth ranges end at ``cap_m``."""
    cameras = [with_depth_range(camera, depth, cap_m) for camera, depth in zip(cameras, depths, strict=True)]
    for i, (camera, depth, picture) in enumerate(zip(cameras, depths, pictures, strict=True)):
        write_view(folder, i, expose(rng, sensor, picture), depth, camera, sensor.quality)
    finish_scene(folder, cameras, depths)

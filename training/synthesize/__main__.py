"""Command line: ``python -m training.synthesize OUT --seed S --scenes N --kind cluster|burst|walk|plot``.

``cluster``: a few small views of one stem or object, for training. ``burst``: some photographs at full size from beside
each other, a few per cent of the depth apart, for calibration. ``walk``: some photographs in a row of a walk
through a plot drawn at random, for validation and test at full size. ``plot``: all photographs of a plot, for the
pipeline.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np

from fsinfer.io.files import write_text
from training.synthesize.cameras.burst import burst_cameras
from training.synthesize.cameras.cluster import cluster_cameras
from training.synthesize.cameras.phone import PHONE, PHONE_VIDEO, PhoneEffects, with_overrides
from training.synthesize.cameras.photo import expose, random_sensor
from training.synthesize.cameras.plot import plot_cameras
from training.synthesize.forest.world import WorldSettings, build_world
from training.synthesize.photographs import Photographs, for_training, with_effects
from training.synthesize.render import Caster
from training.synthesize.scene_writer import (
    finish_scene,
    finished,
    read_view_depth,
    with_depth_range,
    write_record,
    write_truth,
    write_view,
)


def parse(argv: list[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m training.synthesize", description=__doc__)
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=1, help="seeds S .. S+N-1, one world each")
    parser.add_argument("--kind", choices=("cluster", "burst", "walk", "plot"), default="cluster")
    parser.add_argument("--clusters-per-scene", type=int, default=2)
    parser.add_argument("--views", type=int, default=5, help="views of a cluster, burst or walk")
    parser.add_argument("--wide-share", type=float, default=0.0, help="share of clusters with views all round")
    parser.add_argument("--width", type=int)
    parser.add_argument("--height", type=int)
    parser.add_argument("--supersample", type=int, default=2)
    parser.add_argument("--textures", type=Path, help="folder with bark_*.jpg, ground_*.jpg, rock.jpg, leafcard_*.png")
    parser.add_argument("--texture-names", help="comma-separated names (without suffix) to use of --textures")
    parser.add_argument("--photo-share", type=float, default=0.5, help="share of textures taken from photographs")
    parser.add_argument("--clutter", type=float, default=0.25, help="share of scenes with objects instead of trees")
    parser.add_argument("--texture-px", type=int, default=1024, help="size of the texture tiles")
    plot = parser.add_argument_group("--kind plot")
    plot.add_argument("--trees", type=int, default=20)
    plot.add_argument("--radius-m", type=float, default=6.0)
    plot.add_argument("--photos", type=int, default=160)
    plot.add_argument("--slope-deg", type=float, default=6.0)
    plot.add_argument("--undergrowth", type=float, default=0.3, help="0..1")
    plot.add_argument("--season", choices=("summer", "winter"), default="summer")
    plot.add_argument("--hfov-deg", type=float, default=65.0)
    plot.add_argument("--boards", type=int, default=3, help="posts with two ArUco boards each, 0.25 m squares")
    plot.add_argument("--zigzag", type=float, default=0.0, help="share of the photographs taken on transects")
    plot.add_argument("--both-ways", action="store_true", help="walk the inner loop twice, looking in, then out")
    plot.add_argument("--distortion", type=float, default=0.0, help="radial k1 of the images; cams stay pinhole")
    plot.add_argument("--double-faced", action="store_true", help="both sheets of a board show the same number")
    plot.add_argument("--min-dbh-cm", type=float, default=8.0)
    plot.add_argument("--max-dbh-cm", type=float, default=70.0)
    phone = parser.add_argument_group(
        "a phone in a wood", "clusters and walks draw each effect at 0 to 1.5 times its strength"
    )
    preset = phone.add_mutually_exclusive_group()
    preset.add_argument("--phone", action="store_true", help="what a hand-held phone in a breeze does to photographs")
    preset.add_argument("--phone-video", action="store_true", help="the same of frames of a video, walked at 1 m/s")
    phone.add_argument(
        "--effect",
        nargs="*",
        default=[],
        metavar="NAME=VALUE",
        help="strengths of single effects (fields of training.synthesize.cameras.phone.PhoneEffects)",
    )
    return parser.parse_args(argv)


def texture_photos(args: argparse.Namespace) -> tuple[Path, ...]:
    """The photographs that ``--textures`` and ``--texture-names`` allow."""
    if args.textures is None:
        return ()
    found = sorted(p for p in args.textures.iterdir() if p.suffix in (".jpg", ".png"))
    if args.texture_names:
        wanted = set(args.texture_names.split(","))
        found = [p for p in found if p.stem in wanted]
        if len(found) != len(wanted):
            raise SystemExit(f"--texture-names: {sorted(wanted - {p.stem for p in found})} are not in {args.textures}")
    return tuple(found)


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
        cameras = taken.cameras
        depths, pictures = zip(*(taken.depth_and_picture(i) for i in range(len(cameras))), strict=True)
        sensor = taken.sensor(rng, pictures[len(pictures) // 2])
        cap = float(rng.uniform(20, 30))
        cameras = [with_depth_range(c, d, cap) for c, d in zip(cameras, depths, strict=True)]
        for i, (camera, depth, picture) in enumerate(zip(cameras, depths, pictures, strict=True)):
            write_view(folder, i, expose(rng, sensor, picture), depth, camera, sensor.quality)
        finish_scene(folder, cameras, depths)
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
    depths = [caster.depth(one, width, height) for one in cameras]
    pictures = [caster.picture(one, width, height, args.supersample) for one in cameras]
    sensor = random_sensor(rng, pictures[len(pictures) // 2])
    cameras = [with_depth_range(one, depth, 30.0) for one, depth in zip(cameras, depths, strict=True)]
    for i, (one, depth, picture) in enumerate(zip(cameras, depths, pictures, strict=True)):
        write_view(folder, i, expose(rng, sensor, picture), depth, one, sensor.quality)
    finish_scene(folder, cameras, depths)
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
    cameras = plot_cameras(
        rng,
        world.terrain,
        world.obstacles,
        radius_m=settings.radius_m,
        photos=int(settings.radius_m * rng.uniform(15, 32)),  # 0.25 to 0.6 m from one to the next
        width=width,
        height=height,
        hfov_deg=float(rng.uniform(52, 76)),
    )
    first = int(rng.integers(len(cameras) - args.views))
    cameras = cameras[first : first + args.views]
    taken = Photographs(caster, world, cameras, effects, (seed,), (width, height), args.supersample)
    cameras = taken.cameras
    depths, pictures = zip(*(taken.depth_and_picture(i) for i in range(len(cameras))), strict=True)
    sensor = taken.sensor(rng, pictures[len(pictures) // 2])
    for i, (camera, depth, picture) in enumerate(zip(cameras, depths, pictures, strict=True)):
        write_view(
            folder, i, expose(rng, sensor, picture), depth, with_depth_range(camera, depth, 25.0), sensor.quality
        )
    finish_scene(folder, cameras, depths)
    drawn = vars(settings) | {"photos": [p.name for p in photos]}
    record = {"seed": seed, "kind": "walk", "first": first, "settings": drawn, "sensor": vars(sensor)}
    write_record(folder, record | {"effects": None if effects is None else vars(effects)})
    print(f"w{seed:05d}: {len(cameras)} views in {time.perf_counter() - start:.0f} s", flush=True)


def phone_effects(args: argparse.Namespace) -> PhoneEffects | None:
    """What ``--phone``, ``--phone-video`` and ``--effect`` ask for; None where nothing is asked."""
    if not (args.phone or args.phone_video or args.effect):
        return None
    preset = PHONE if args.phone else PHONE_VIDEO if args.phone_video else PhoneEffects(distortion=args.distortion)
    return with_overrides(preset, args.effect)


def synthesize_plot(args: argparse.Namespace, seed: int, photos: tuple[Path, ...], folder: Path) -> None:
    """Render one plot into ``folder``; views that are there already are kept."""
    if finished(folder):
        return
    width, height = args.width or 1280, args.height or 720
    start = time.perf_counter()
    effects = phone_effects(args)
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
    settings = with_effects(settings, effects)
    world = build_world(np.random.default_rng([seed, 1]), settings)
    caster = Caster.of(world)
    rng = np.random.default_rng([seed, 2])
    cameras = plot_cameras(
        rng,
        world.terrain,
        world.obstacles,
        radius_m=args.radius_m,
        photos=args.photos,
        width=width,
        height=height,
        hfov_deg=args.hfov_deg,
        zigzag=args.zigzag,
        both_ways=args.both_ways,
    )
    taken = Photographs(caster, world, cameras, effects, (seed,), (width, height), args.supersample)
    sensor = taken.sensor(rng, caster.picture(cameras[0], width, height, 1))
    cameras = taken.cameras
    if taken.shots is not None:
        write_text(folder / "shots.json", json.dumps([shot.record() for shot in taken.shots], indent=1) + "\n")
    inside = world.in_plot
    write_truth(folder / "truth.csv", world.stems[:inside], world.sections[:inside])
    write_truth(folder / "truth_outside.csv", world.stems[inside:], world.sections[inside:])
    write_text(folder / "markers.json", json.dumps(world.markers, indent=1) + "\n")
    print(
        f"plot {seed}: {inside} trees, {len(cameras)} photos, built in {time.perf_counter() - start:.1f} s", flush=True
    )
    depths = []
    for i, camera in enumerate(cameras):
        depth = read_view_depth(folder, i)
        if depth is None:
            depth, picture = taken.depth_and_picture(i, args.distortion)
            photo = expose(np.random.default_rng([seed, 3, i]), sensor, picture)
            write_view(folder, i, photo, depth, with_depth_range(camera, depth, 25.0), sensor.quality)
        depths.append(depth)
        if (i + 1) % 10 == 0:
            print(f"  view {i + 1}/{len(cameras)}, {time.perf_counter() - start:.0f} s", flush=True)
    finish_scene(folder, cameras, depths)
    options = {k: str(v) for k, v in vars(args).items() if k not in ("out", "textures")}
    drawn = vars(settings) | {"photos": [p.name for p in photos]}
    if effects is not None:
        drawn |= {"effects": vars(effects)}
    record = {"seed": seed, "kind": "plot", "options": options, "settings": drawn, "sensor": vars(sensor)}
    write_record(folder, record)


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    args = parse(argv)
    cv2.setNumThreads(1)
    photos = texture_photos(args)
    for seed in range(args.seed, args.seed + args.scenes):
        if args.kind == "cluster":
            synthesize_clusters(args, seed, photos)
        elif args.kind == "burst":
            synthesize_burst(args, seed, photos)
        elif args.kind == "walk":
            synthesize_walk(args, seed, photos)
        else:
            synthesize_plot(args, seed, photos, args.out if args.scenes == 1 else args.out / f"p{seed:05d}")


if __name__ == "__main__":
    main()

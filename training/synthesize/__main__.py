"""Command line: ``python -m training.synthesize OUT --seed S --scenes N --kind cluster|burst|walk|plot``.

``cluster``: a few small views of one stem or object, for training. ``burst``: some photographs at full size from beside
each other, a few per cent of the depth apart, for calibration. ``walk``: some photographs in a row of a walk
through a plot drawn at random, for validation and test at full size. ``plot``: all photographs of a plot, for the
pipeline.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2

from training.synthesize.asked import texture_photos
from training.synthesize.small_scenes import synthesize_burst, synthesize_clusters, synthesize_walk
from training.synthesize.whole_plot import synthesize_plot


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
    plot.add_argument("--workers", type=int, default=1, help="processes at a time; each builds the plot for itself")
    phone = parser.add_argument_group(
        "a phone in a wood", "clusters and walks draw each effect at 0 to 1.5 times its strength"
    )
    preset = phone.add_mutually_exclusive_group()
    preset.add_argument("--phone", action="store_true", help="what a hand-held phone in a breeze does to photographs")
    preset.add_argument("--phone-video", action="store_true", help="the same of frames of a video, walked at 1 m/s")
    phone.add_argument(
        "--effect",
        action="extend",
        nargs="*",
        default=[],
        metavar="NAME=VALUE",
        help="strengths of single effects (fields of training.synthesize.cameras.phone.PhoneEffects)",
    )
    return parser.parse_args(argv)


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

"""Turn a rendered plot into the photographs of ``fsinfer demo``.

    python -m training.synthesize PLOT --kind plot --seed 7 …
    python -m training.synthesize.demo_plot PLOT fsinfer/demo_data

PLOT is what ``training.synthesize`` writes: ``images/`` and ``truth.csv``.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import cv2
import numpy as np

from fsinfer.io.images import read_image, write_image
from fsinfer.io.photo_folders import list_images

#: The wheel carries the demo: more than this and its download grows noticeably. Source: judgement.
MAX_BYTES = 4_000_000


def make_demo(plot: Path, out: Path, *, photos: int, width_px: int, quality: int) -> int:
    """Write ``out/photos/*.jpg`` and ``out/truth.csv``; return their size in bytes.

    Photographs are taken evenly over the walk, at most ``photos`` of them, reduced to ``width_px``.
    """
    images = list_images(plot / "images")
    chosen = np.unique(np.linspace(0, len(images) - 1, min(photos, len(images))).round().astype(int))
    shutil.rmtree(out / "photos", ignore_errors=True)
    (out / "photos").mkdir(parents=True)
    for number, index in enumerate(chosen, start=1):
        image = read_image(images[index])
        height, width = image.shape[:2]
        if width > width_px:
            size = (width_px, round(height * width_px / width))
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
        write_image(out / "photos" / f"photo_{number:03d}.jpg", image, quality=quality)
    shutil.copyfile(plot / "truth.csv", out / "truth.csv")
    return sum(path.stat().st_size for path in out.rglob("*") if path.is_file())


def main(argv: list[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m training.synthesize.demo_plot", description=__doc__)
    parser.add_argument("plot", type=Path, metavar="PLOT")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument("--photos", type=int, default=30)
    parser.add_argument("--width", type=int, default=960)
    parser.add_argument("--quality", type=int, default=85)
    args = parser.parse_args(argv)
    size = make_demo(args.plot, args.out, photos=args.photos, width_px=args.width, quality=args.quality)
    print(f"{args.out}: {size / 1e6:.1f} MB")
    if size > MAX_BYTES:
        raise SystemExit(f"more than {MAX_BYTES / 1e6:.0f} MB: give fewer --photos, a smaller --width or --quality")


if __name__ == "__main__":
    main()

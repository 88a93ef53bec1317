"""Clouds of the two halves of real photographs against each other: ``python -m tests.bench.halves PHOTOS OUT``.

Where nobody knows the truth, two measurements that share no photograph tell how far one can be trusted: every other
photograph goes through ``fsinfer run`` by itself, the others likewise, each with cameras of its own. The clouds are put
on each other by a similarity (the cameras of all photographs to begin with, then the surfaces, point to plane, Chen and
Medioni 1992), and the distance of a point of one from the surface of the other, the plane of its nearest points, is
told in per cent of the distance to the nearest camera. What is common to both, such as a lens that neither knows, is
not seen so. Judged are the points nearest to the cameras (:data:`NEAREST`).
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from fsinfer.geometry.similarity import apply, fit_similarity
from fsinfer.io.cloud import read_cloud
from fsinfer.io.photo_folders import list_images
from fsinfer.scene import read_scene
from tests.bench.demo import user_environment
from tests.bench.results import add_result_options, check_result_options, save_result

Floats = NDArray[np.float64]
HALVES = ("odd", "even")
#: Points of a cloud that are asked for, at most, and of the surface about each that make its plane.
MOST, PLANE_POINTS = 40_000, 20
#: Share of a cloud's points that is judged, by the distance to the cameras: beyond, few photographs of a half look.
NEAREST = 0.7
#: A point has a partner where the other cloud comes so near, share of the distance to the camera.
PARTNER = 0.01
#: Rounds of the registration; distances count up to so many times their spread.
ROUNDS, ROBUST = 30, 2.5


def surface_at(points: Floats, tree: cKDTree, cloud: Floats) -> tuple[Floats, Floats]:
    """(n, 3) middle and (n, 3) normal of the nearest points of a cloud (N, 3) and its tree to each of (n, 3)."""
    near = cloud[tree.query(points, k=PLANE_POINTS)[1]]
    middle = near.mean(axis=1)
    offsets = near - middle[:, None]
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    return middle, vectors[:, :, 0]


def registered(points: Floats, cloud: Floats) -> Floats:
    """(n, 3) points, near their places already, moved onto the surface of a cloud (N, 3) by a similarity."""
    tree = cKDTree(cloud)
    for _ in range(ROUNDS):
        middle, normal = surface_at(points, tree, cloud)
        off = ((middle - points) * normal).sum(axis=1)
        near = np.abs(off) <= ROBUST * 1.4826 * np.median(np.abs(off))
        center = points.mean(axis=0)
        arms = points - center
        jacobian = np.column_stack([np.cross(arms, normal), normal, (arms * normal).sum(axis=1)])
        step = np.linalg.lstsq(jacobian[near], off[near], rcond=None)[0]
        points = (1.0 + step[6]) * Rotation.from_rotvec(step[:3]).apply(arms) + center + step[3:6]
    return points


def differences(points: Floats, cloud: Floats, centers: Floats) -> tuple[Floats, Floats]:
    """Distances (n,) of points (n, 3) from the surface of a cloud, and from its nearest point, both over the distance
    to the nearest of the cameras' centres (C, 3).
    """
    tree = cKDTree(cloud)
    middle, normal = surface_at(points, tree, cloud)
    away = cKDTree(centers).query(points)[0]
    return np.abs(((middle - points) * normal).sum(axis=1)) / away, tree.query(points)[0] / away


def _centers(scene: Path) -> dict[str, Floats]:
    return {view.name: view.camera.center for view in read_scene(scene).views}


def cloud_of(out: Path, half: str, all_centers: dict[str, Floats]) -> Floats:
    """Points (N, 3) of a half, in the frame of the cameras of all photographs."""
    own = _centers(out / half / "scene")
    shared = [name for name in own if name in all_centers]
    places = [np.stack([one[name] for name in shared]) for one in (own, all_centers)] if shared else []
    move = fit_similarity(*places) if places else None
    if move is None:
        msg = f"too few of the cameras of {out / half} are among those of all photographs"
        raise SystemExit(msg)
    return apply(move, read_cloud(out / half / "fused" / "cloud.ply").xyz.astype(np.float64))


def compute(photos: Path, out: Path) -> None:
    """Cameras of all photographs, and a run of each half, by the installed command."""
    fsinfer = [sys.executable, "-m", "fsinfer"]
    for number, photo in enumerate(list_images(photos)):
        folder = out / f"{HALVES[number % 2]}_photos"
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(photo, folder / photo.name)
    subprocess.run([*fsinfer, "poses", str(photos), str(out / "all")], env=user_environment(), check=True)
    for half in HALVES:
        command = [*fsinfer, "run", str(out / f"{half}_photos"), str(out / half)]
        subprocess.run(command, env=user_environment(), check=True)


def main(argv: list[str] | None = None) -> int:
    """Run, compare, print, write."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.halves", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photos", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--judge", action="store_true", help="read what OUT holds, and run nothing")
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    if not args.judge:
        compute(args.photos, args.out)
    centers = _centers(args.out / "all")
    cameras = np.stack(list(centers.values()))
    clouds = {half: cloud_of(args.out, half, centers) for half in HALVES}
    rng = np.random.default_rng(0)
    off, apart = [], []
    for half, other in (HALVES, HALVES[::-1]):
        points = clouds[half]
        points = points[rng.choice(len(points), min(MOST, len(points)), replace=False)]
        away = cKDTree(cameras).query(points)[0]
        points = registered(points[away <= np.quantile(away, NEAREST)], clouds[other])
        distances = differences(points, clouds[other], cameras)
        off.append(distances[0])
        apart.append(distances[1])
    both, far = np.concatenate(off), np.concatenate(apart)
    figures = {
        "photos": len(centers),
        **{f"{half}_placed": len(_centers(args.out / half / "scene")) for half in HALVES},
        "median_percent": 100 * float(np.median(both)),
        "p68_percent": 100 * float(np.quantile(both, 0.68)),
        "p95_percent": 100 * float(np.quantile(both, 0.95)),
        "with_partner_percent": 100 * float((far <= PARTNER).mean()),
    }
    for name, value in figures.items():
        print(f"{name:24s} {value:.4g}")
    save_result(args, figures, module="tests.bench.halves", arguments=argv)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

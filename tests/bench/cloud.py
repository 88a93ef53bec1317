"""The dense cloud of a rendered plot against the true surfaces: ``python -m tests.bench.cloud PLOT OUT``.

PLOT is what ``training.synthesize --kind plot`` writes, OUT what ``tests.bench.plot`` or ``fsinfer run`` made of its
photographs; the two are aligned by the cameras alone. Precision is the share of the cloud's points within a distance of
a true surface, recall the share of the true surface that has a point within it (Knapitsch and others, Tanks and
Temples, ACM Transactions on Graphics 36, 2017), of all that was seen and of the stems about breast height.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fsinfer.io.cloud import read_cloud
from fsinfer.io.pfm import read_pfm
from fsinfer.scene import Scene, read_scene
from tests.bench.plot import align_cameras
from tests.bench.results import add_result_options, check_result_options, save_result

Floats = NDArray[np.float64]
#: Distances asked for, metres.
WITHIN_M = (0.01, 0.02, 0.03)
#: True surfaces count so far from the camera that sees them; the cloud's points are asked for nearer than that.
TRUTH_REACH_M, CLOUD_REACH_M = 10.0, 6.0
#: Side of the cells of which the true surface has one point, metres; every so-many-th pixel is taken.
CELL_M, PIXEL_STEP = 0.01, 3
#: A stem is what lies so near to its bark, metres, between these heights above its foot.
NEAR_BARK_M, HEIGHTS_M = 0.15, (0.8, 2.0)
#: Points asked for at most, of the cloud and of the truth.
MOST = 300_000


def true_surface(scene: Scene) -> Floats:
    """Points (N, 3) on what the views of a rendered scene see within :data:`TRUTH_REACH_M`, one a cell."""
    parts = []
    for view in scene.views:
        depth = read_pfm(scene.folder / "depths" / f"{view.name}.pfm")
        rows, columns = (np.arange(0, size, PIXEL_STEP) for size in depth.shape)
        z = depth[np.ix_(rows, columns)]
        v, u = np.nonzero((z > 0) & (z < TRUTH_REACH_M))
        pixels = np.stack([columns[u], rows[v], np.ones(len(u))])
        rays = np.linalg.inv(view.camera.intrinsic) @ pixels * z[v, u]
        pose = view.camera.cam_from_world
        parts.append((rays.T - pose[:3, 3]) @ pose[:3, :3])
    points = np.concatenate(parts)
    _, first = np.unique(np.floor(points / CELL_M).astype(np.int32), axis=0, return_index=True)
    return np.asarray(points[first])


def on_stems(points: Floats, stems: Sequence[dict[str, float]]) -> NDArray[np.bool_]:
    """Which of the points (N, 3) lie about the bark of a stem, rows of ``truth.csv``."""
    found = np.zeros(len(points), bool)
    for stem in stems:
        away = np.hypot(points[:, 0] - stem["x_m"], points[:, 1] - stem["y_m"])
        height = points[:, 2] - stem["z_ground_m"]
        found |= (away < stem["dbh_cm"] / 200 + NEAR_BARK_M) & (height > HEIGHTS_M[0]) & (height < HEIGHTS_M[1])
    return found


def cloud_figures(
    cloud: Floats, truth: Floats, cameras: Floats, stems: Sequence[dict[str, float]], *, seed: int = 0
) -> dict[str, float]:
    """Precision and recall, per cent, at each of :data:`WITHIN_M`, of everything and of the stems.

    ``cloud`` (N, 3) and ``truth`` (M, 3) are metres in one frame, ``cameras`` (K, 3) where the photographs were taken.
    """
    rng = np.random.default_rng(seed)
    asked = truth[rng.permutation(len(truth))[:MOST]]
    missing = cKDTree(cloud).query(asked, workers=-1)[0]
    points = cloud[rng.permutation(len(cloud))[:MOST]]
    points = points[cKDTree(cameras).query(points)[0] < CLOUD_REACH_M]
    off = cKDTree(truth).query(points, workers=-1)[0]
    of_stems, stems_asked = on_stems(points, stems), on_stems(asked, stems)
    figures: dict[str, float] = {"points": float(len(cloud))}
    for within in WITHIN_M:
        name = f"{1000 * within:.0f}mm_percent"
        figures |= {
            f"precision_{name}": _percent(off < within),
            f"recall_{name}": _percent(missing < within),
            f"stems_precision_{name}": _percent(off[of_stems] < within),
            f"stems_recall_{name}": _percent(missing[stems_asked] < within),
        }
    return figures


def _percent(found: NDArray[np.bool_]) -> float:
    return 100 * float(found.mean()) if len(found) else float("nan")


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.cloud", description=__doc__)
    parser.add_argument("plot", type=Path)
    parser.add_argument("out", type=Path)
    add_result_options(parser)
    args = parser.parse_args(argv)
    check_result_options(parser, args)
    summary = json.loads((args.out / "plot.json").read_text(encoding="utf-8"))
    from_scene = np.array(summary["cloud_from_scene"])
    aligned = align_cameras(args.plot, args.out, from_scene)
    cloud = aligned.placed(read_cloud(args.out / "cloud.ply").xyz.astype(np.float64))
    scene = read_scene(args.plot)
    with (args.plot / "truth.csv").open(encoding="utf-8", newline="") as file:
        stems = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    cameras = np.array([view.camera.center for view in scene.views])
    figures = cloud_figures(cloud, true_surface(scene), cameras, stems)
    print(f"{figures['points']:.0f} points; precision and recall, per cent; of the stems about breast height")
    for within in WITHIN_M:
        name = f"{1000 * within:.0f}mm_percent"
        four = (figures[f"{part}_{name}"] for part in ("precision", "recall", "stems_precision", "stems_recall"))
        print(f"within {1000 * within:.0f} mm: " + "{:.1f}, {:.1f}; {:.1f}, {:.1f}".format(*four))
    save_result(args, figures, module="tests.bench.cloud", arguments=argv)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

"""The point cloud evaluation of the DTU benchmark: accuracy, completeness and overall in mm.

python -m training.benchmark.dtu_evaluation CLOUDS --ground-truth "SampleSet/MVS Data" --scans 1 4 9

CLOUDS holds one cloud a scan in the benchmark's frame (mm): ``scan1/cloud.ply`` as ``fsinfer fuse`` writes it,
``scan1.ply`` or ``mvsnet001_l3.ply``. The ground truth folder holds ``Points/stl/stl001_total.ply`` and
``ObsMask/ObsMask1_10.mat``, ``ObsMask/Plane1.mat``.

The protocol is that of Jensen et al., Large Scale Multi-view Stereopsis Evaluation (CVPR 2014), section 4, with what
its MATLAB programs (BaseEvalMain, PointCompareMain, ComputeStat) fix beyond the text:

1. the reconstruction is thinned in random order to a least distance of 0.2 mm;
2. accuracy: the distance of each of its points that lies in the observation mask to the nearest structured light
   point; completeness: the distance of each structured light point above the ground plane to the nearest
   reconstructed point (of all that are left after 1, in the mask or not);
3. distances of 20 mm and more are left out of the mean, the median and the variance, not capped;
4. points outside of the bounding box, rounded up to whole cells of 60 mm, do not count;
5. the figures of a method are the means over the scans; overall is the mean of accuracy and completeness.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatReadError
from scipy.spatial import cKDTree

from fsinfer.errors import CloudError, FsinferError, InputError
from fsinfer.io.cloud import read_cloud
from training.benchmark.thinning import spatial_order, thin
from training.data.dtu import TEST_SCANS

Float64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
#: Points asked for at a time: 16 MB of answers. Source: numerics.
QUERY_CHUNK = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """Constants of the benchmark's programs.

    Attributes
    ----------
    least_distance_mm: of two points of the reconstruction (``dst``).
    max_distance_mm: distances from here on are outliers and left out (``MaxDist`` of ComputeStat).
    cell_mm: the bounding box is searched in cells of this size (``MaxDist`` of PointCompareMain); only points in
        cells that touch the box are given a distance.
    margin: of the observation masks to read, in their file names.
    seed: of the random order of thinning; MATLAB's order is not defined either.
    """

    least_distance_mm: float = 0.2
    max_distance_mm: float = 20.0
    cell_mm: float = 60.0
    margin: int = 10
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class ScanTruth:
    """Ground truth of one scan; coordinates in mm in the benchmark's frame.

    Attributes
    ----------
    stl: (N, 3) structured light points, thinned to 0.2 mm by the benchmark.
    observed: (X, Y, Z) voxels in which a point of a reconstruction counts.
    box: (2, 3) bounding box, its low corner is the centre of voxel (0, 0, 0).
    resolution: side of a voxel in mm.
    plane: (4,), a point p is above the ground where ``plane @ (p, 1) > 0``.
    """

    stl: Float64
    observed: Mask
    box: Float64
    resolution: float
    plane: Float64


@dataclass(frozen=True, kw_only=True)
class CloudErrors:
    """Figures of one scan in mm, and how many points stand behind them (outliers not counted)."""

    accuracy_mm: float
    completeness_mm: float
    overall_mm: float
    accuracy_median_mm: float
    completeness_median_mm: float
    accuracy_variance_mm2: float
    completeness_variance_mm2: float
    accuracy_points: int
    completeness_points: int
    thinned_points: int


def read_scan_truth(folder: Path, scan: int, protocol: Protocol | None = None) -> ScanTruth:
    """Read the ground truth of a scan from the benchmark's ``MVS Data`` folder.

    Raises
    ------
    InputError
        A file is missing, cannot be read or lacks a variable. CloudError for the structured light points.
    """
    protocol = protocol or Protocol()
    mask_path = folder / "ObsMask" / f"ObsMask{scan}_{protocol.margin}.mat"
    plane_path = folder / "ObsMask" / f"Plane{scan}.mat"
    mask, plane = _variables(mask_path, ("ObsMask", "BB", "Res")), _variables(plane_path, ("P",))
    observed, box = mask["ObsMask"] != 0, mask["BB"].astype(np.float64)
    if observed.ndim != 3 or box.shape != (2, 3) or mask["Res"].size != 1 or plane["P"].size != 4:
        msg = f"{mask_path} or {plane_path.name} is not of the benchmark's form; unpack SampleSet.zip again"
        raise InputError(msg)
    return ScanTruth(
        stl=read_cloud(folder / "Points" / "stl" / f"stl{scan:03d}_total.ply").xyz,
        observed=observed,
        box=box,
        resolution=float(mask["Res"].item()),
        plane=plane["P"].astype(np.float64).ravel(),
    )


def in_mask(points: Float64, truth: ScanTruth) -> Mask:
    """Whether each point (N, 3) lies in an observed voxel: voxel index = round((p - low corner) / resolution)."""
    index = np.floor((points - truth.box[0]) / truth.resolution + 0.5)
    inside = ((index >= 0) & (index < truth.observed.shape)).all(axis=1)
    result = np.zeros(len(points), dtype=bool)
    x, y, z = index[inside].astype(np.intp).T
    result[inside] = truth.observed[x, y, z]
    return result


def above_plane(points: Float64, plane: Float64) -> Mask:
    """Whether each point (N, 3) lies above the ground plane."""
    return np.asarray(points @ plane[:3] + plane[3] > 0)


def in_cells(points: Float64, box: Float64, cell_mm: float) -> Mask:
    """Whether each point (N, 3) lies in one of the cells, from the low corner of ``box`` on, that touch it."""
    high = box[0] + (np.floor((box[1] - box[0]) / cell_mm) + 1) * cell_mm
    return np.asarray(((points >= box[0]) & (points < high)).all(axis=1))


def nearest_below(tree: cKDTree, points: Float64, limit: float) -> Float64:
    """Distances of (N, 3) points to the nearest of the tree, without those of ``limit`` and more."""
    points = points[spatial_order(points, limit / 20)]
    parts = [np.empty(0)]
    for first in range(0, len(points), QUERY_CHUNK):
        distances, _ = tree.query(points[first : first + QUERY_CHUNK], distance_upper_bound=limit, workers=-1)
        parts.append(distances[distances < limit])
    return np.concatenate(parts)


def evaluate_cloud(points: Float64, truth: ScanTruth, protocol: Protocol | None = None) -> CloudErrors:
    """Evaluate a reconstruction, (N, 3) in mm, by the module's protocol.

    Raises
    ------
    CloudError
        No point counts for accuracy or none for completeness.
    """
    protocol = protocol or Protocol()
    limit = protocol.max_distance_mm
    points = points[thin(points, protocol.least_distance_mm, np.random.default_rng(protocol.seed))]
    counted = points[in_mask(points, truth) & in_cells(points, truth.box, protocol.cell_mm)]
    wanted = truth.stl[above_plane(truth.stl, truth.plane) & in_cells(truth.stl, truth.box, protocol.cell_mm)]
    # Compact nodes make these queries six times slower (measured on surfaces with noise and outliers).
    accuracy = nearest_below(cKDTree(truth.stl, compact_nodes=False), counted, limit)
    completeness = nearest_below(cKDTree(points, compact_nodes=False), wanted, limit)
    if not len(accuracy) or not len(completeness):
        msg = (
            f"of {len(points)} points {len(counted)} lie in the observed space and {len(accuracy)} within {limit:g} mm "
            "of the truth; is the cloud in mm, in the frame of the benchmark's cameras, and of this scan?"
        )
        raise CloudError(msg)
    means = float(accuracy.mean()), float(completeness.mean())
    return CloudErrors(
        accuracy_mm=means[0],
        completeness_mm=means[1],
        overall_mm=sum(means) / 2,
        accuracy_median_mm=float(np.median(accuracy)),
        completeness_median_mm=float(np.median(completeness)),
        accuracy_variance_mm2=float(accuracy.var(ddof=1)) if len(accuracy) > 1 else 0.0,
        completeness_variance_mm2=float(completeness.var(ddof=1)) if len(completeness) > 1 else 0.0,
        accuracy_points=len(accuracy),
        completeness_points=len(completeness),
        thinned_points=len(points),
    )


def find_cloud(folder: Path, scan: int) -> Path:
    """The cloud of a scan under one of the usual names; CloudError where there is none."""
    names = (f"scan{scan}/cloud.ply", f"scan{scan}.ply", f"scan{scan:03d}.ply", f"mvsnet{scan:03d}_l3.ply")
    for name in names:
        if (folder / name).is_file():
            return folder / name
    msg = f"{folder} holds no cloud of scan {scan} ({', '.join(names)}); fuse it first, or leave it out with --scans"
    raise CloudError(msg)


def mean_errors(rows: Sequence[CloudErrors]) -> dict[str, float]:
    """Unweighted means over the scans, as the benchmark's tables give them."""
    return {key: float(np.mean([asdict(row)[key] for row in rows])) for key in asdict(rows[0])}


def _variables(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[np.generic]]:
    if not path.is_file():
        msg = f"there is no file {path}; give the benchmark's folder 'MVS Data' (of SampleSet.zip)"
        raise InputError(msg)
    try:
        content = loadmat(path, variable_names=names)
        return {name: np.asarray(content[name]) for name in names}
    except (OSError, ValueError, TypeError, LookupError, NotImplementedError, MatReadError) as error:
        msg = f"cannot read {', '.join(names)} from {path} ({error}); give the benchmark's folder 'MVS Data'"
        raise InputError(msg) from error


def main(arguments: list[str] | None = None) -> int:
    """Command line; a user's error is one message and exit code 2."""
    default = Protocol()
    parser = argparse.ArgumentParser(
        prog="python -m training.benchmark.dtu_evaluation", description="DTU accuracy, completeness and overall in mm."
    )
    parser.add_argument("clouds", type=Path, help="folder with scan1/cloud.ply, scan1.ply or mvsnet001_l3.ply, …")
    parser.add_argument("--ground-truth", type=Path, required=True, help="the benchmark's folder 'MVS Data'")
    parser.add_argument("--scans", type=int, nargs="+", default=list(TEST_SCANS), help="default: the 22 test scans")
    parser.add_argument("--seed", type=int, default=default.seed, help="of the random thinning")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    args = parser.parse_args(arguments)
    protocol = Protocol(seed=args.seed)
    rows: dict[int, CloudErrors] = {}
    try:
        paths = {scan: find_cloud(args.clouds, scan) for scan in args.scans}
        for scan, path in paths.items():
            start = time.monotonic()
            truth = read_scan_truth(args.ground_truth, scan, protocol)
            rows[scan] = evaluate_cloud(read_cloud(path).xyz, truth, protocol)
            if not args.json:
                print(f"{_line(f'scan {scan}', asdict(rows[scan]))}  {time.monotonic() - start:.0f} s", flush=True)
    except FsinferError as error:
        print(f"Error: {error}")
        return 2
    mean = mean_errors(list(rows.values()))
    if args.json:
        print(json.dumps({"mean": mean, "scans": {scan: asdict(row) for scan, row in rows.items()}}, indent=1))
    else:
        print(_line(f"mean of {len(rows)}", mean))
    return 0


def _line(name: str, e: dict[str, float]) -> str:
    return (
        f"{name:12s} accuracy {e['accuracy_mm']:.4f} mm  completeness {e['completeness_mm']:.4f} mm  "
        f"overall {e['overall_mm']:.4f} mm  medians {e['accuracy_median_mm']:.4f} {e['completeness_median_mm']:.4f}  "
        f"points {e['thinned_points']:.0f}"
    )


if __name__ == "__main__":
    raise SystemExit(main())

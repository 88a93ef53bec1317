"""The DTU point cloud evaluation on planes whose figures can be worked out by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import savemat

from fsinfer.errors import CloudError, InputError
from fsinfer.io.cloud import PointCloud, write_cloud
from training.benchmark.dtu_evaluation import (
    ScanTruth,
    above_plane,
    evaluate_cloud,
    in_cells,
    in_mask,
    main,
    read_scan_truth,
)


def grid(x: range, z: float) -> NDArray[np.float64]:
    """One point a millimetre for the given x and y = 0 … 40."""
    xs, ys = np.meshgrid(np.arange(x.start, x.stop), np.arange(41.0))
    return np.column_stack([xs.ravel(), ys.ravel(), np.full(xs.size, z)])


@pytest.fixture
def truth() -> ScanTruth:
    """The plane z = 0, x and y from 0 to 40 mm; observed where x rounds to 20 or less; ground below x = 9.5."""
    observed = np.zeros((61, 61, 61), dtype=bool)
    observed[:31] = True
    return ScanTruth(
        stl=grid(range(41), 0.0),
        observed=observed,
        box=np.array([[-10.0, -10, -10], [50, 50, 50]]),
        resolution=1.0,
        plane=np.array([1.0, 0, 0, -9.5]),
    )


def reconstruction() -> NDArray[np.float64]:
    """0.5 mm above the truth for x = 10 … 20 (observed), 3 mm above it for x = 21 … 40 (not observed)."""
    return np.concatenate([grid(range(10, 21), 0.5), grid(range(21, 41), 3.0)])


def completeness_by_hand() -> float:
    """Mean over the columns x = 10 … 40: the nearest point of x = 21 and 22 is that of x = 20, not the one above."""
    return float(11 * 0.5 + np.hypot(1, 0.5) + np.hypot(2, 0.5) + 18 * 3.0) / 31


def test_accuracy_and_completeness_by_hand(truth: ScanTruth) -> None:
    errors = evaluate_cloud(reconstruction(), truth)
    assert errors.accuracy_mm == pytest.approx(0.5)
    assert errors.completeness_mm == pytest.approx(completeness_by_hand())
    assert errors.overall_mm == pytest.approx((0.5 + completeness_by_hand()) / 2)
    assert (errors.accuracy_median_mm, errors.completeness_median_mm) == (0.5, 3.0)
    assert errors.accuracy_variance_mm2 == pytest.approx(0)
    assert (errors.accuracy_points, errors.completeness_points) == (11 * 41, 31 * 41)


def test_equal_points_count_once(truth: ScanTruth) -> None:
    heap = np.tile([15.0, 15, 4], (1000, 1))
    errors = evaluate_cloud(np.concatenate([reconstruction(), heap]), truth)
    assert errors.accuracy_mm == pytest.approx((11 * 41 * 0.5 + 4) / (11 * 41 + 1))


def test_points_nearer_than_the_least_distance_are_thinned(truth: ScanTruth) -> None:
    once = reconstruction()
    twice = evaluate_cloud(np.concatenate([once, once + np.array([0, 0, 0.19])]), truth)
    assert twice.thinned_points == len(once)
    assert 0.5 < twice.accuracy_mm < 0.69
    apart = evaluate_cloud(np.concatenate([once, once + np.array([0, 0, 0.21])]), truth)
    assert apart.thinned_points == 2 * len(once)
    assert apart.accuracy_mm == pytest.approx(0.605)


def test_outliers_are_left_out_and_not_capped(truth: ScanTruth) -> None:
    high = np.array([[12.0, 12, 19.9], [12, 12, 20.1]])  # in the mask; the second is 20.1 mm from the truth
    alone = np.array([[45.0, 45, 40]])  # a true point with nothing reconstructed within 20 mm
    errors = evaluate_cloud(
        np.concatenate([reconstruction(), high]), replace(truth, stl=np.concatenate([truth.stl, alone]))
    )
    assert errors.accuracy_mm == pytest.approx((11 * 41 * 0.5 + 19.9) / (11 * 41 + 1))
    assert errors.completeness_points == 31 * 41


def test_a_point_outside_the_mask_still_completes(truth: ScanTruth) -> None:
    seen = evaluate_cloud(reconstruction()[: 11 * 41], truth)  # only what is observed
    assert seen.accuracy_mm == pytest.approx(0.5)
    assert seen.completeness_mm > completeness_by_hand()


def test_voxels_are_centred_on_the_low_corner(truth: ScanTruth) -> None:
    x = np.array([-10.6, -10.4, 20.4, 20.6, 51])
    assert in_mask(np.c_[x, x * 0, x * 0], truth).tolist() == [False, True, True, False, False]
    coarse = replace(truth, resolution=2.0)  # voxel 30 is centred on x = 50
    assert in_mask(np.array([[49.0, 0, 0], [51.1, 0, 0]]), coarse).tolist() == [True, False]


def test_cells_of_60_mm_reach_beyond_the_box(truth: ScanTruth) -> None:
    x = np.array([-10.1, -10, 109.9, 110])
    assert in_cells(np.c_[x, x * 0, x * 0], truth.box, 60.0).tolist() == [False, True, True, False]
    far = np.array([[100.0, 0, 0], [111, 0, 0]])  # both above the plane, both with a point 1 mm away
    errors = evaluate_cloud(
        np.concatenate([reconstruction(), far + np.array([0, 0, 1])]),
        replace(truth, stl=np.concatenate([truth.stl, far])),
    )
    assert errors.completeness_points == 31 * 41 + 1


def test_the_plane_itself_is_not_above() -> None:
    points = np.array([[0.0, 0, 1], [0, 0, 1.1], [0, 0, 0.9]])
    assert above_plane(points, np.array([0.0, 0, 2, -2])).tolist() == [False, True, False]


def test_a_cloud_in_metres_is_an_error_that_says_so(truth: ScanTruth) -> None:
    with pytest.raises(CloudError, match="is the cloud in mm"):
        evaluate_cloud(reconstruction() / 1000 + 500, truth)


def write_truth(folder: Path, truth: ScanTruth, scan: int) -> None:
    """The benchmark's files: a PLY, and MATLAB files of version 5 with ObsMask, BB, Res and P."""
    (folder / "ObsMask").mkdir(parents=True, exist_ok=True)
    write_cloud(folder / "Points" / "stl" / f"stl{scan:03d}_total.ply", PointCloud(xyz=truth.stl))
    content = {"ObsMask": truth.observed.astype(np.uint8), "BB": truth.box, "Res": truth.resolution, "Margin": 10}
    savemat(folder / "ObsMask" / f"ObsMask{scan}_10.mat", content, do_compression=True)
    savemat(folder / "ObsMask" / f"Plane{scan}.mat", {"P": truth.plane[:, None]})


def test_the_command_reads_the_benchmarks_files(
    truth: ScanTruth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for scan in (1, 114):
        write_truth(tmp_path / "MVS Data", truth, scan)
    read = read_scan_truth(tmp_path / "MVS Data", 114)
    np.testing.assert_array_equal(read.observed, truth.observed)
    np.testing.assert_array_equal(read.plane, truth.plane)
    assert read.resolution == truth.resolution
    write_cloud(tmp_path / "out" / "scan1" / "cloud.ply", PointCloud(xyz=reconstruction()))
    write_cloud(tmp_path / "out" / "mvsnet114_l3.ply", PointCloud(xyz=reconstruction() + np.array([0, 0, 1])))
    arguments = [str(tmp_path / "out"), "--ground-truth", str(tmp_path / "MVS Data"), "--scans", "1", "114"]
    assert main([*arguments, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["scans"]["1"]["accuracy_mm"] == pytest.approx(0.5)
    assert result["scans"]["114"]["accuracy_mm"] == pytest.approx(1.5)
    assert result["mean"]["accuracy_mm"] == pytest.approx(1.0)
    assert main(arguments) == 0
    assert "mean of 2    accuracy 1.0000 mm" in capsys.readouterr().out


def test_what_is_missing_is_said(truth: ScanTruth, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path), "--ground-truth", str(tmp_path)]) == 2
    assert "no cloud of scan 1" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"no file .*ObsMask1_10\.mat"):
        read_scan_truth(tmp_path, 1)
    write_truth(tmp_path, truth, 1)
    (tmp_path / "ObsMask" / "Plane1.mat").write_bytes(b"cut short")
    with pytest.raises(InputError, match=r"cannot read P from .*Plane1\.mat"):
        read_scan_truth(tmp_path, 1)
    savemat(tmp_path / "ObsMask" / "Plane1.mat", {"Q": truth.plane})
    with pytest.raises(InputError, match=r"cannot read P from .*Plane1\.mat"):
        read_scan_truth(tmp_path, 1)
    savemat(tmp_path / "ObsMask" / "Plane1.mat", {"P": truth.plane[:3]})
    with pytest.raises(InputError, match="not of the benchmark's form"):
        read_scan_truth(tmp_path, 1)

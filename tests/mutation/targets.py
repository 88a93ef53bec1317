"""The modules whose breakages are looked for, and the tests that belong to each, the quick ones first."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Target:
    """``files`` are broken one place at a time; each breakage has to be seen by one of ``tests``."""

    files: tuple[str, ...]
    tests: tuple[str, ...]


_FUSION = (
    "tests/fsinfer/fusion/test_consistency.py",
    "tests/fsinfer/fusion/test_voxels.py",
    "tests/fsinfer/fusion/test_fuse.py",
)
_INTERVAL = ("tests/fsinfer/trees/diameter/test_interval.py",)

TARGETS: dict[str, Target] = {
    "consistency": Target(files=("fsinfer/fusion/consistency.py",), tests=_FUSION),
    "fusion": Target(
        files=("fsinfer/fusion/fuse.py", "fsinfer/fusion/voxels.py", "fsinfer/fusion/surfaces.py"), tests=_FUSION
    ),
    "scale": Target(
        files=(
            "fsinfer/scale/aruco.py",
            "fsinfer/scale/square_fit.py",
            "fsinfer/scale/corners.py",
            "fsinfer/scale/scale.py",
        ),
        tests=("tests/fsinfer/scale",),
    ),
    "slice": Target(
        files=("fsinfer/trees/diameter/slice.py",),
        tests=("tests/fsinfer/trees/diameter/test_slice.py", *_INTERVAL, "tests/fsinfer/trees/diameter/test_dbh.py"),
    ),
    "circle": Target(
        files=("fsinfer/trees/diameter/circle.py",),
        tests=("tests/fsinfer/trees/diameter/test_circle.py", "tests/fsinfer/trees/diameter/test_slice.py"),
    ),
    "dbh": Target(
        files=("fsinfer/trees/diameter/dbh.py",),
        tests=(
            *_INTERVAL,
            "tests/fsinfer/trees/diameter/test_tapered_fit.py",
            "tests/fsinfer/trees/diameter/test_dbh.py",
        ),
    ),
    "spread": Target(
        files=("fsinfer/trees/diameter/spread.py",),
        tests=("tests/fsinfer/trees/diameter/test_sides_and_spread.py", *_INTERVAL),
    ),
    "silhouettes": Target(
        files=(
            "fsinfer/silhouettes/join.py",
            "fsinfer/silhouettes/edges.py",
            "fsinfer/trees/diameter/silhouette.py",
        ),
        tests=("tests/fsinfer/silhouettes",),
    ),
    "warping": Target(
        files=("fsinfer/depth/warping.py", "fsinfer/depth/cost_volume.py"),
        tests=("tests/fsinfer/depth/test_warping.py",),
    ),
    "training-volume": Target(
        files=("training/model/warping.py", "training/model/volume.py"),
        tests=("tests/training/test_model.py",),
    ),
    "losses": Target(
        files=("training/losses.py",),
        tests=("tests/training/test_losses.py", "tests/training/test_model.py"),
    ),
    "attention": Target(files=("training/model/attention.py",), tests=("tests/training/test_model.py",)),
    "parity": Target(files=("export/parity.py", "export/__main__.py"), tests=("tests/export/test_command_line.py",)),
}

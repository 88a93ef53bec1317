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

_DIAMETER = "tests/fsinfer/trees/diameter/"
_SILHOUETTES = "tests/fsinfer/silhouettes/"
_SCALE = "tests/fsinfer/scale/"


def _of_model(*tests: str) -> tuple[str, ...]:
    """Those of the network that are quick; others train it."""
    return tuple(f"tests/training/test_model.py::{test}" for test in tests)


TARGETS: dict[str, Target] = {
    "consistency": Target(files=("fsinfer/fusion/consistency.py",), tests=_FUSION),
    "fusion": Target(
        files=("fsinfer/fusion/fuse.py", "fsinfer/fusion/voxels.py", "fsinfer/fusion/surfaces.py"),
        tests=(*_FUSION[:2], "tests/fsinfer/fusion/test_surfaces.py", _FUSION[2]),
    ),
    "scale": Target(
        files=(
            "fsinfer/scale/aruco.py",
            "fsinfer/scale/square_fit.py",
            "fsinfer/scale/corners.py",
            "fsinfer/scale/scale.py",
            "fsinfer/scale/two_ends.py",
        ),
        tests=(
            f"{_SCALE}test_scale.py",
            f"{_SCALE}test_two_ends.py",
            f"{_SCALE}test_corners.py",
            f"{_SCALE}test_scale_interval.py",
            f"{_SCALE}test_aruco.py",
        ),
    ),
    "slice": Target(
        files=("fsinfer/trees/diameter/slice.py",),
        tests=(f"{_DIAMETER}test_slice.py", *_INTERVAL, f"{_DIAMETER}test_dbh.py"),
    ),
    "circle": Target(
        files=("fsinfer/trees/diameter/circle.py",),
        tests=(f"{_DIAMETER}test_circle.py", f"{_DIAMETER}test_slice.py"),
    ),
    "dbh": Target(
        files=("fsinfer/trees/diameter/dbh.py",),
        tests=(
            f"{_DIAMETER}test_measure_together.py",
            *_INTERVAL,
            f"{_DIAMETER}test_tapered_fit.py",
            f"{_DIAMETER}test_dbh.py",
        ),
    ),
    "spread": Target(
        files=("fsinfer/trees/diameter/spread.py",),
        tests=(f"{_DIAMETER}test_sides_and_spread.py", *_INTERVAL),
    ),
    "roundness": Target(
        files=(
            "fsinfer/trees/diameter/roundness.py",
            "fsinfer/trees/common_shape.py",
            "fsinfer/trees/shape_doubts.py",
        ),
        tests=(
            f"{_DIAMETER}test_roundness.py",
            "tests/fsinfer/trees/test_common_shape.py",
            "tests/fsinfer/trees/test_shape_doubts.py",
        ),
    ),
    "silhouette-fit": Target(
        files=("fsinfer/trees/diameter/silhouette.py", "fsinfer/trees/diameter/edge_problem.py"),
        tests=(f"{_DIAMETER}test_silhouette.py", f"{_SILHOUETTES}test_join.py"),
    ),
    "silhouette-edges": Target(
        files=("fsinfer/silhouettes/edges.py",),
        tests=(f"{_SILHOUETTES}test_edges.py", f"{_SILHOUETTES}test_join.py"),
    ),
    "silhouette-join": Target(
        files=(
            "fsinfer/silhouettes/join.py",
            "fsinfer/silhouettes/joined_section.py",
            "fsinfer/silhouettes/combine.py",
        ),
        tests=(f"{_SILHOUETTES}test_join.py",),
    ),
    "silhouette-looks": Target(
        files=(
            "fsinfer/silhouettes/looks.py",
            "fsinfer/silhouettes/one_look.py",
            "fsinfer/silhouettes/wide_look.py",
            "fsinfer/trees/diameter/second_pair.py",
        ),
        tests=(
            f"{_SILHOUETTES}test_looks.py",
            f"{_SILHOUETTES}test_wide_look.py",
            f"{_DIAMETER}test_second_pair.py",
            f"{_SILHOUETTES}test_join.py",
        ),
    ),
    "silhouette-support": Target(
        files=("fsinfer/silhouettes/support.py",),
        tests=(f"{_SILHOUETTES}test_support.py", f"{_SILHOUETTES}test_join.py"),
    ),
    "pose-errors": Target(
        files=("fsinfer/silhouettes/pose_errors.py",),
        tests=(f"{_SILHOUETTES}test_pose_errors.py",),
    ),
    "stems": Target(
        files=("fsinfer/trees/one_entry.py", "fsinfer/trees/forks.py"),
        tests=("tests/fsinfer/trees/test_one_entry.py", "tests/fsinfer/trees/test_forks.py"),
    ),
    "level": Target(
        files=(
            "fsinfer/placement/up.py",
            "fsinfer/placement/level.py",
        ),
        tests=("tests/fsinfer/placement/test_level.py",),
    ),
    "warping": Target(
        files=("fsinfer/depth/warping.py", "fsinfer/depth/cost_volume.py", "fsinfer/depth/plane_volume.py"),
        tests=("tests/fsinfer/depth/test_warping.py", "tests/fsinfer/depth/test_plane_volume.py"),
    ),
    "training-volume": Target(
        files=("training/model/warping.py", "training/model/volume.py"),
        tests=_of_model(
            "test_planes_go_from_one_end_of_the_depths_to_the_other_in_equal_steps",
            "test_volumes_equal_the_deployed_numpy_volumes",
            "test_a_window_is_a_cut_of_the_whole_volume",
            "test_chunked_correlation_equals_the_plain_one_with_its_gradients",
            "test_chunked_variance_equals_its_definition_with_its_gradients",
        ),
    ),
    "losses": Target(
        files=("training/losses.py",),
        tests=(
            "tests/training/test_losses.py",
            *_of_model(
                "test_the_hybrid_loss_is_that_of_the_paper",
                "test_cross_entropy_is_least_at_the_split_label",
                "test_attention_is_between_0_on_walls_and_1_at_edges",
                "test_attention_does_not_look_at_unknown_depth",
                "test_target_index_of_a_plane_is_its_number",
            ),
        ),
    ),
    "attention": Target(
        files=("training/model/attention.py",),
        tests=_of_model(
            "test_squeeze_excitation_over_slabs_is_one_volume",
            "test_squeeze_excitation_hears_channels_below_zero_and_hides_what_the_hidden_layer_has_below_zero",
            "test_squeeze_excitation_reduces_by_16_down_to_its_floor",
            "test_the_papers_squeeze_excitation_weighs_the_channels_of_the_cost_volume",
        ),
    ),
    "parity": Target(files=("export/parity.py", "export/__main__.py"), tests=("tests/export/test_command_line.py",)),
}

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
_ADJUSTMENT = "tests/fsinfer/poses/adjustment/"
_TREES = "tests/fsinfer/trees/"


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
    "subpixel": Target(
        files=("fsinfer/depth/subpixel.py", "fsinfer/depth/photo_confidence.py"),
        tests=("tests/fsinfer/depth/test_photo_confidence.py", "tests/fsinfer/depth/test_subpixel.py"),
    ),
    "point-errors": Target(
        files=(
            "fsinfer/fusion/depth_error.py",
            "fsinfer/trees/points/errors.py",
            "fsinfer/trees/points/smoothing.py",
        ),
        tests=(
            "tests/fsinfer/fusion/test_depth_error.py",
            f"{_TREES}points/test_errors.py",
            f"{_TREES}points/test_smoothing.py",
            f"{_TREES}test_point_errors.py",
        ),
    ),
    "edge-depths": Target(
        files=("fsinfer/silhouettes/edge_depths.py",),
        tests=(
            f"{_SILHOUETTES}test_edges.py",
            f"{_SILHOUETTES}test_looks.py",
            f"{_SILHOUETTES}test_join.py::test_photographs_mend_a_hazy_stem",
        ),
    ),
    "patches": Target(files=("fsinfer/poses/adjustment/patches.py",), tests=(f"{_ADJUSTMENT}test_patches.py",)),
    "rematch": Target(
        files=("fsinfer/poses/adjustment/rematch.py",),
        tests=tuple(
            f"{_ADJUSTMENT}test_rematch.py::{test}"
            for test in (
                "test_the_patch_of_a_point_is_taken_from_the_photo_with_the_middle_one_of_its_depths",
                "test_a_patch_is_looked_for_where_the_photo_shows_it_as_large_and_turned_as_it_does",
                "test_every_cell_has_the_points_it_asks_for_as_far_as_there_are",
                "test_each_observation_is_one_photo_of_one_point",
                "test_patches_that_are_not_sharp_enough_do_not_count",
                "test_in_photos_twice_as_large_patches_may_lie_twice_as_many_pixels_away",
            )
        ),
    ),
    "last-fit": Target(
        files=("fsinfer/poses/adjustment/last_fit.py",),
        tests=(
            f"{_ADJUSTMENT}test_fit.py",
            f"{_ADJUSTMENT}test_adjust.py",
            f"{_ADJUSTMENT}test_precision.py",
            f"{_ADJUSTMENT}test_rematch.py::test_cameras_are_placed_better_than_by_features[turning]",
            f"{_ADJUSTMENT}test_rematch.py::"
            "test_where_patches_find_nothing_or_contradict_the_features_those_count[another place]",
        ),
    ),
    "evidence": Target(files=("fsinfer/poses/adjustment/evidence.py",), tests=(f"{_ADJUSTMENT}test_evidence.py",)),
    "ground": Target(
        files=(
            "fsinfer/trees/ground/ground.py",
            "fsinfer/trees/ground/lowest.py",
            "fsinfer/trees/ground/raster.py",
            "fsinfer/trees/ground/at_stems.py",
            "fsinfer/trees/ground/settings.py",
        ),
        tests=(f"{_TREES}ground",),
    ),
    "stand": Target(
        files=("fsinfer/trees/stand.py",),
        tests=(f"{_TREES}test_stand.py", f"{_TREES}test_rough_dbh.py", f"{_TREES}ground/test_relief.py"),
    ),
    "plot-border": Target(
        files=(
            "fsinfer/plot_border/border.py",
            "fsinfer/plot_border/crossing.py",
            "fsinfer/plot_border/hectare.py",
            "fsinfer/plot_border/place.py",
            "fsinfer/plot_border/plot.py",
            "fsinfer/plot_border/sight.py",
        ),
        tests=("tests/fsinfer/plot_border",),
    ),
    "evaluation": Target(
        files=(
            "fsinfer/evaluation/metrics.py",
            "fsinfer/evaluation/alignment.py",
            "fsinfer/evaluation/registration.py",
            "fsinfer/evaluation/units.py",
        ),
        tests=("tests/fsinfer/evaluation",),
    ),
    "height": Target(
        files=("fsinfer/trees/height.py", "fsinfer/trees/ends.py", "fsinfer/trees/rough_dbh.py"),
        tests=(f"{_TREES}test_height.py", f"{_TREES}test_ends.py", f"{_TREES}test_rough_dbh.py"),
    ),
    "sanity": Target(
        files=("fsinfer/trees/sanity.py",),
        tests=(
            f"{_TREES}test_coarse_steps.py",
            f"{_TREES}test_units_of_the_file.py::test_stems_measured_in_feet_by_a_file_that_says_nothing_are_too_thick",
            f"{_TREES}ground/test_at_stems.py",
            f"{_TREES}test_upright.py",
        ),
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

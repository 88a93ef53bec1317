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
_DEPTH = "tests/fsinfer/depth/"
_POSES = "tests/fsinfer/poses/"
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
            f"{_TREES}test_measure.py::test_an_array_of_another_shape_is_no_cloud",
        ),
    ),
    "stem-measurement": Target(
        files=("fsinfer/trees/stem_measurement.py",),
        tests=(f"{_TREES}test_stem_measurement.py", f"{_TREES}test_height.py"),
    ),
    "tapers": Target(
        files=("fsinfer/trees/stem_curve.py", "fsinfer/trees/taper_curve.py"),
        tests=(f"{_TREES}test_taper_curve.py", f"{_TREES}test_stem_curve.py"),
    ),
    "cuts-and-leans": Target(
        files=(
            "fsinfer/trees/level_cut.py",
            "fsinfer/trees/common_lean.py",
            "fsinfer/trees/plot_doubt.py",
            "fsinfer/trees/posts.py",
        ),
        tests=(
            f"{_TREES}test_level_cut.py",
            f"{_TREES}test_common_lean.py",
            *(
                f"tests/fsinfer/workflow/test_tree_stage.py::{test}"
                for test in (
                    "test_a_doubtful_stem_at_a_marker_is_taken_for_its_post",
                    "test_what_speaks_against_all_stems_leaves_none_that_is_ok",
                    "test_stems_of_joined_parts_are_doubtful_too",
                )
            ),
        ),
    ),
    "edits": Target(
        files=(
            "fsinfer/trees/by_hand.py",
            "fsinfer/trees/edits.py",
            "fsinfer/trees/edited_trees.py",
            "fsinfer/trees/edit_rows.py",
        ),
        tests=(f"{_TREES}test_edited_trees.py", f"{_TREES}test_edits.py"),
    ),
    "scale-doubts": Target(
        files=(
            "fsinfer/scale/doubts.py",
            "fsinfer/scale/agreement.py",
            "fsinfer/scale/blooming.py",
            "fsinfer/scale/find.py",
            "fsinfer/scale/markers_seen.py",
        ),
        tests=(
            f"{_SCALE}test_agreement.py",
            f"{_SCALE}test_blooming.py",
            f"{_SCALE}test_doubts.py",
            f"{_SCALE}test_scale_doubts.py",
            f"{_SCALE}test_markers_seen.py",
        ),
    ),
    "sections": Target(
        files=(
            "fsinfer/trees/diameter/section.py",
            "fsinfer/trees/diameter/faces.py",
            "fsinfer/trees/diameter/sides.py",
            "fsinfer/trees/diameter/outline.py",
            "fsinfer/trees/diameter/double_wall.py",
            "fsinfer/trees/diameter/verdict.py",
            "fsinfer/trees/diameter/budget.py",
            "fsinfer/trees/diameter/tapered_fit.py",
        ),
        tests=(
            f"{_DIAMETER}test_budget.py",
            f"{_DIAMETER}test_section.py",
            f"{_DIAMETER}test_outline.py",
            f"{_DIAMETER}test_double_wall.py",
            f"{_DIAMETER}test_faces.py",
            f"{_DIAMETER}test_sides_and_spread.py",
            f"{_DIAMETER}test_tapered_fit.py",
            f"{_DIAMETER}test_measure_together.py",
        ),
    ),
    "search": Target(
        files=(
            "fsinfer/trees/search/find.py",
            "fsinfer/trees/search/verify.py",
            "fsinfer/trees/search/hough.py",
            "fsinfer/trees/search/giants.py",
            "fsinfer/trees/search/blurred.py",
            "fsinfer/trees/search/remaining.py",
        ),
        tests=(f"{_TREES}search",),
    ),
    "measure": Target(
        files=("fsinfer/trees/measure.py",),
        tests=(
            f"{_TREES}test_measure.py",
            f"{_TREES}ground/test_at_stems.py",
            f"{_TREES}test_upright.py::test_stems_that_all_grow_thicker_upwards_are_told_of",
        ),
    ),
    "cells": Target(
        files=(
            "fsinfer/trees/points/cells.py",
            "fsinfer/trees/points/sums.py",
            "fsinfer/trees/points/surface.py",
            "fsinfer/geometry/hull.py",
            "fsinfer/geometry/similarity.py",
        ),
        tests=(f"{_TREES}points", "tests/fsinfer/geometry"),
    ),
    "silhouette-views": Target(
        files=(
            "fsinfer/silhouettes/visibility.py",
            "fsinfer/silhouettes/walk.py",
            "fsinfer/silhouettes/tops.py",
            "fsinfer/silhouettes/shrubs.py",
            "fsinfer/silhouettes/points_alone.py",
            "fsinfer/silhouettes/strips.py",
            "fsinfer/silhouettes/stem_axis.py",
        ),
        tests=(
            f"{_SILHOUETTES}test_visibility.py",
            f"{_SILHOUETTES}test_shrubs.py",
            f"{_SILHOUETTES}test_tops.py",
            f"{_SILHOUETTES}test_walk.py",
            f"{_SILHOUETTES}test_edges.py",
            f"{_SILHOUETTES}test_looks.py",
        ),
    ),
    "depth-maps": Target(
        files=(
            "fsinfer/depth/map_levels.py",
            "fsinfer/depth/median_filter.py",
            "fsinfer/depth/surface.py",
            "fsinfer/depth/network_input.py",
            "fsinfer/depth/precision.py",
            "fsinfer/depth/candidates.py",
        ),
        tests=(
            f"{_DEPTH}test_map_levels.py",
            f"{_DEPTH}test_median_filter.py",
            f"{_DEPTH}test_surface.py",
            f"{_DEPTH}test_network_input.py",
            f"{_DEPTH}test_candidates.py",
            *(
                f"{_DEPTH}test_precision.py::{test}"
                for test in (
                    "test_processors_that_are_fast_at_8_bit_integers",
                    "test_windows_is_asked_for_avx2",
                )
            ),
        ),
    ),
    "views": Target(
        files=(
            "fsinfer/poses/view_selection.py",
            "fsinfer/poses/undistortion.py",
            "fsinfer/poses/closing.py",
            "fsinfer/poses/thinning.py",
        ),
        tests=(
            f"{_POSES}test_view_selection.py",
            f"{_POSES}test_undistortion.py",
            f"{_POSES}test_closing.py",
            f"{_POSES}test_thinning.py",
        ),
    ),
    "astray": Target(
        files=(
            "fsinfer/poses/verification/stretches.py",
            "fsinfer/poses/verification/misplaced.py",
            "fsinfer/poses/verification/loose_parts.py",
            "fsinfer/poses/verification/point_votes.py",
            "fsinfer/poses/verification/scale_jumps.py",
            "fsinfer/poses/verification/pair_votes.py",
            "fsinfer/poses/verification/repair.py",
        ),
        tests=(f"{_POSES}verification",),
    ),
    "joined": Target(
        files=(
            "fsinfer/poses/joining/parts.py",
            "fsinfer/poses/joining/place.py",
            "fsinfer/poses/joining/evidence.py",
            "fsinfer/poses/joining/stretches.py",
            "fsinfer/poses/joining/known_boards.py",
            "fsinfer/trees/pattern/match.py",
            "fsinfer/trees/pattern/join.py",
        ),
        tests=(f"{_POSES}joining", f"{_TREES}pattern"),
    ),
    "cylinder": Target(
        files=(
            "fsinfer/trees/cylinder/axis.py",
            "fsinfer/trees/cylinder/batch.py",
            "fsinfer/trees/cylinder/kernels.py",
        ),
        tests=(
            f"{_TREES}cylinder",
            f"{_TREES}test_stem_measurement.py",
            f"{_DIAMETER}test_tapered_fit.py",
            f"{_DIAMETER}test_measure_together.py",
        ),
    ),
    "adjustment": Target(
        files=(
            "fsinfer/poses/adjustment/photo_effects.py",
            "fsinfer/poses/adjustment/precision.py",
            "fsinfer/poses/adjustment/projection.py",
            "fsinfer/poses/adjustment/reduced_system.py",
        ),
        tests=tuple(
            f"{_ADJUSTMENT}test_{name}.py" for name in ("projection", "reduced_system", "photo_effects", "precision")
        ),
    ),
    "pairs": Target(
        files=(
            "fsinfer/poses/pairs.py",
            "fsinfer/poses/view_graph.py",
            "fsinfer/poses/geometric_check.py",
            "fsinfer/poses/sparse.py",
        ),
        tests=tuple(f"{_POSES}test_{name}.py" for name in ("sparse", "view_graph", "pairs", "geometric_check")),
    ),
    "what-phones-note": Target(
        files=(
            "fsinfer/io/gravity.py",
            "fsinfer/io/exif.py",
            "fsinfer/io/turned.py",
            "fsinfer/scale/clicks/sizes.py",
            "fsinfer/scale/clicks/file.py",
        ),
        tests=(
            "tests/fsinfer/io/test_gravity.py",
            "tests/fsinfer/io/test_images.py",
            f"{_SCALE}test_click_sizes.py",
            "tests/fsinfer/frames/test_captures.py",
        ),
    ),
    "large-clouds": Target(
        files=("fsinfer/trees/thinning.py",),
        tests=tuple(
            f"{_TREES}test_large_clouds.py::{test}"
            for test in (
                "test_pieces_are_the_whole_file[a.laz]",
                "test_thinning_keeps_the_budget_and_breast_height[a.laz]",
                "test_what_a_file_marks_as_noise_is_not_measured[30000]",
                "test_a_point_at_zero_of_a_cloud_in_national_coordinates_stops_nothing[30000]",
            )
        ),
    ),
    "tables": Target(
        files=(
            "fsinfer/trees/outputs/table.py",
            "fsinfer/trees/outputs/maps.py",
            "fsinfer/trees/outputs/workbook.py",
            "fsinfer/trees/outputs/labels.py",
            "fsinfer/trees/tree.py",
        ),
        tests=(
            f"{_TREES}outputs/test_workbook.py",
            f"{_TREES}outputs/test_maps.py",
            f"{_TREES}outputs/test_table.py::test_figures_are_written",
            f"{_TREES}outputs/test_table.py::test_bare_ground_is_a_result_with_a_diagnosis",
        ),
    ),
    "triangulation": Target(
        files=("fsinfer/geometry/triangulation.py",),
        tests=(f"{_SCALE}test_two_ends.py", f"{_SCALE}test_square_fit.py"),
    ),
    "placement": Target(
        files=(
            "fsinfer/placement/place.py",
            "fsinfer/placement/ground_plane.py",
            "fsinfer/placement/on_side.py",
        ),
        tests=("tests/fsinfer/placement",),
    ),
    "importers": Target(
        files=(
            "fsinfer/importers/arkit.py",
            "fsinfer/importers/colmap.py",
            "fsinfer/importers/foreign.py",
            "fsinfer/importers/lens.py",
            "fsinfer/importers/metashape.py",
            "fsinfer/importers/metashape_scale.py",
            "fsinfer/importers/openmvs.py",
            "fsinfer/importers/rtabmap.py",
            "fsinfer/importers/thinning.py",
            "fsinfer/importers/transforms.py",
            "fsinfer/importers/views.py",
        ),
        tests=tuple(
            f"tests/fsinfer/importers/test_{name}.py"
            for name in ("formats", "lens", "metashape_scale", "same_name", "upright", "write")
        ),
    ),
    "frames": Target(
        files=(
            "fsinfer/frames/quality.py",
            "fsinfer/frames/select.py",
            "fsinfer/frames/times.py",
            "fsinfer/frames/view_shift.py",
        ),
        tests=(
            "tests/fsinfer/frames/test_times.py",
            "tests/fsinfer/frames/test_select.py",
            "tests/fsinfer/frames/test_captures.py",
        ),
    ),
    "check": Target(
        files=(
            "fsinfer/check/advice.py",
            "fsinfer/check/coverage.py",
            "fsinfer/check/habits.py",
            "fsinfer/check/open_sides.py",
            "fsinfer/check/sightings.py",
            "fsinfer/check/sparse_stems.py",
            "fsinfer/check/survey.py",
            "fsinfer/check/visible_stems.py",
            "fsinfer/check/compass.py",
        ),
        tests=(
            "tests/fsinfer/check/test_coverage.py",
            "tests/fsinfer/check/test_habits.py",
            "tests/fsinfer/check/test_open_sides.py",
            "tests/fsinfer/check/test_sparse_stems.py",
            "tests/fsinfer/check/test_advice.py",
            *(
                f"tests/fsinfer/check/test_run.py::{test}"
                for test in (
                    "test_who_sees_a_stem_is_known_photo_by_photo",
                    "test_a_photo_an_arms_length_away_sees_the_stem",
                    "test_one_photo_alone_does_not_see",
                    "test_sparse_points_show_stems_and_no_bush",
                )
            ),
        ),
    ),
    "notices": Target(
        files=(
            "fsinfer/notices/capture.py",
            "fsinfer/notices/numbers.py",
            "fsinfer/notices/sentences.py",
            "fsinfer/notices/stems.py",
        ),
        tests=("tests/fsinfer/notices", f"{_SCALE}test_doubts.py", f"{_SCALE}test_scale_doubts.py"),
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

"""Tables for people: the metrics of an evaluation, and the demo's trees against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fsinfer.notices.numbers import counted
from fsinfer.notices.sentences import joined
from fsinfer.notices.stems import StemCode

if TYPE_CHECKING:
    from fsinfer.evaluation.metrics import Evaluation
    from fsinfer.plot_border.hectare import HectareFigure
    from fsinfer.plot_border.plot import PlotFigures
    from fsinfer.scale.scale import Scale
    from fsinfer.workflow.demo import DemoResult
    from fsinfer.workflow.trees_result import UnmeasuredTree

#: Of more trees than this without a DBH, the table tells the rest. Source: layout.
_MOST_REASONS = 8
#: Why no tree of one table is one of the other, by position and by number. Source: layout.
_NOT_THERE = (
    "no extracted tree stands where a measured one does. See whether x_m and y_m are metres in both tables, and of the "
    "same plot; give --max-distance-m where they are rough, or --by-id where the same tree has the same tree_id"
)
#: By :class:`fsinfer.evaluation.alignment.AlignmentDoubt`.
_ALIGNMENT_DOUBTS = {
    "chance": (
        "Positions: no motion lays the two maps on each other better than chance. Are they of the same trees, in "
        "metres?"
    ),
    "symmetric": (
        "Positions: the trees stand so regularly that the mirror image fits as well. See whether the partners are the "
        "right ones (--json), or match them with --by-id"
    ),
    "mirrored": (
        "Positions: the mirror image of the measured map fits far better. Are x_m (east) and y_m (north) interchanged, "
        "or was a bearing taken for an angle from the x axis?"
    ),
    "other_numbers": (
        "Numbers: the trees of the same tree_id do not stand as far from each other in both tables: are the numbers "
        "those of the same trees? Without --by-id they are matched by position."
    ),
}
_OTHER_NUMBERS = "no extracted tree has the tree_id of a measured one; without --by-id they are matched by position"


def evaluation_rows(evaluation: Evaluation, *, by_id: bool = False) -> list[str]:
    """The metrics, completeness first, one a line; ``by_id`` is how the trees were matched."""
    unmeasured, without = evaluation.detected - evaluation.matched, evaluation.without_dbh
    rows = [
        f"Measured trees      {evaluation.n}" + (f"  (and {without} without a DBH)" if without else ""),
        f"Matched with DBH    {evaluation.matched}  (r = {100 * evaluation.r:.1f} %)",
        f"Found without DBH   {unmeasured}",
        f"Omitted             {evaluation.omitted}",
        f"False               {evaluation.false}",
        f"Outside the area    {evaluation.outside}",
    ]
    motion = evaluation.measured_from_extracted
    if motion is not None:
        shift = f"({motion['shift_x_m']:+.2f}, {motion['shift_y_m']:+.2f}) m"
        rows.append(f"Positions aligned   turned {motion['rotation_deg']:+.1f} deg, moved {shift}")
    if evaluation.alignment_doubt:
        rows.append(_ALIGNMENT_DOUBTS[evaluation.alignment_doubt])
    if evaluation.detected == 0:
        why = "there are no extracted trees" if evaluation.extracted == 0 else _OTHER_NUMBERS if by_id else _NOT_THERE
        return [*rows, f"No accuracy can be given: {why}."]
    if evaluation.rmse_cm is None or evaluation.rrmse is None or evaluation.ae is None:
        return [*rows, "No matched tree has a DBH: no accuracy can be given."]
    intervals = (
        [f"In their interval   {evaluation.in_interval} of {evaluation.with_interval}  (95 % of many)"]
        if evaluation.with_interval
        else []
    )
    return [
        *rows,
        f"RMSE                {evaluation.rmse_cm:.2f} cm",
        f"rRMSE of matched    {100 * evaluation.rrmse:.2f} %",
        f"AE of matched       {100 * evaluation.ae:.2f} %",
        f"Bias                {evaluation.bias_cm:+.2f} cm",
        f"MAE                 {evaluation.mae_cm:.2f} cm",
        *intervals,
    ]


def unmeasured_rows(trees: Sequence[UnmeasuredTree]) -> list[str]:
    """Why trees have no DBH, one a line; the first of them where there are many."""
    # That no scale is known is said by itself.
    missing = [tree for tree in trees if all(reason.code != StemCode.no_scale for reason in tree.reasons)]
    rows = [f"  tree {tree.tree_id} has no DBH: {joined(tree.reasons)}" for tree in missing[:_MOST_REASONS]]
    more = len(missing) - len(rows)
    return [*rows, f"  and {more} more: see the column reason of trees.csv"] if more else rows


def scale_rows(scale: Scale) -> list[str]:
    """The boards that gave the scale, and the numbers that were seen in vain; nothing where it is not by boards.

    A board that a forester put up and that does not count is seen at once, while there is time to photograph it again.
    """
    # Only after a run, which needed them; --help shall load nothing heavy.
    from fsinfer.scale.scale import BoardVerdict
    from fsinfer.trees.points.sums import Z95

    used = sorted({marker.id for marker in scale.markers if marker.verdict != BoardVerdict.outvoted})
    if not used or scale.rel_std is None:
        return []
    known = f"known to {100 * Z95 * scale.rel_std:.1f} %"
    rows = [f"Scale: by {counted(len(used), 'board', 'boards')} ({', '.join(map(str, used))}), {known}"]
    rows += [f"  number {other.id} does not count: {other.reason}" for other in scale.rejected[:_MOST_REASONS]]
    return rows


def plot_rows(plot: PlotFigures | None) -> list[str]:
    """The plot within its border; nothing where it has none."""
    if plot is None:
        return []
    shape = f"radius {plot.radius_m:g} m" if plot.radius_m is not None else "a polygon"
    unseen = f", {plot.on_unseen} where it was not seen" if plot.on_unseen else ""
    rows = [
        f"Plot: {shape} ({plot.origin}), {plot.area_m2:.0f} m², {100 * plot.seen_share:.0f} % of it seen; "
        f"{counted(plot.stems, 'stem', 'stems')} in ({plot.doubtful} doubtful, {plot.unmeasured} without a "
        f"DBH{unseen}), {plot.outside} out"
    ]
    if plot.stems_per_ha is not None:
        rows.append(f"  stems/ha {_interval(plot.stems_per_ha, '.0f')}")
    if plot.basal_area_m2_per_ha is not None:
        rows.append(f"  basal area m²/ha {_interval(plot.basal_area_m2_per_ha, '.1f')}")
    elif plot.no_basal_area:
        rows.append("  basal area m²/ha 0.0 (no stem)")
    return rows


def _interval(figure: HectareFigure, form: str) -> str:
    return f"{figure.value:{form}} [{figure.lo95:{form}} - {figure.hi95:{form}}]"


def demo_rows(result: DemoResult) -> list[str]:
    """Each tree of the truth with what was measured of it, then the metrics; the numbers are those of the truth."""
    extracted = {str(tree.tree_id): tree for tree in result.trees}
    pairs = {pair.measured_id: pair for pair in result.evaluation.pairs}
    rows = ["Tree   Truth     Measured DBH [95 % interval]     Error   In the report"]
    for truth in result.truth:
        pair = pairs.get(truth.tree_id)
        start = f"{truth.tree_id:>4}  {truth.dbh_cm:5.1f} cm  "
        if pair is None:
            rows.append(start + "not found")
            continue
        tree = extracted[pair.extracted_id]
        if tree.dbh_cm is None:
            rows.append(start + f"found, not measured: {tree.reason}")
            continue
        interval = f"[{tree.dbh_lo95_cm:.1f} - {tree.dbh_hi95_cm:.1f}]"
        error = f"{tree.dbh_cm - pair.measured_cm:+6.1f} cm"
        rows.append(start + f"{tree.dbh_cm:5.1f} cm  {interval:<22} {error}   tree {tree.tree_id}")
    rows += ["", *evaluation_rows(result.evaluation)]
    if result.evaluation.outside:
        rows.append(
            f"The report shows {len(result.trees)} stems: {result.evaluation.outside} stand outside the plot, where "
            "the photos show trees and shrubs too, from one side mostly, that the truth says nothing of."
        )
    return rows

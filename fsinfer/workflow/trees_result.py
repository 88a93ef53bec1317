"""What the tree stage found, as its record keeps it."""

from __future__ import annotations

from dataclasses import dataclass

from fsinfer.notices.notice import Notice
from fsinfer.plot_border.plot import PlotFigures
from fsinfer.trees import PlotResult, StandTable
from fsinfer.trees.pattern.join import JoinedPart


@dataclass(frozen=True, kw_only=True)
class UnmeasuredTree:
    """A tree without a DBH, and why."""

    tree_id: int
    reasons: tuple[Notice, ...]


@dataclass(frozen=True, kw_only=True)
class TreesResult:
    """What the tree stage found.

    Attributes
    ----------
    trees, trees_with_dbh, trees_with_silhouette: numbers of stems; of those with a DBH; with edges in photographs.
    trees_outside: stems outside of the walk, which are not among ``trees``.
    joined: parts of the walk, measured apart, whose stems are among ``trees``.
    ground_method: how the ground was found, None where it was not.
    diagnosis: what was found, or why nothing was.
    stand: the stand table of the seen ground; plot_area_m2: its area, None when unknown.
    plot: the plot within its border; None where it has none.
    unmeasured: the trees without a DBH.
    warnings: repeat the diagnosis when no tree was found.
    """

    trees: int = 0
    trees_with_dbh: int = 0
    trees_with_silhouette: int = 0
    ground_method: str | None = None
    diagnosis: Notice
    stand: StandTable | None = None
    plot_area_m2: float | None = None
    unmeasured: tuple[UnmeasuredTree, ...] = ()
    plot: PlotFigures | None = None
    warnings: tuple[Notice, ...] = ()
    trees_outside: int = 0
    joined: tuple[JoinedPart, ...] = ()


def summarized(result: PlotResult, plot: PlotFigures | None) -> TreesResult:
    """The numbers and what is to be told of measured stems; ``plot`` within its border."""
    counted = [tree for tree in result.all_trees if not tree.outside]
    unmeasured = [tree for tree in counted if tree.dbh_cm is None]
    own = zip(result.trees, result.sections, strict=True)
    return TreesResult(
        trees=len(counted),
        trees_with_dbh=len(counted) - len(unmeasured),
        trees_with_silhouette=sum(section.silhouette is not None for tree, section in own if not tree.outside),
        ground_method=None if result.ground is None else result.ground.method,
        diagnosis=result.diagnosis,
        stand=result.stand,
        plot_area_m2=result.plot_area_m2 or None,
        unmeasured=tuple(UnmeasuredTree(tree_id=tree.tree_id, reasons=tree.reasons) for tree in unmeasured),
        plot=plot,
        warnings=(*result.warnings, *(() if result.all_trees else (result.diagnosis,))),
        trees_outside=len(result.all_trees) - len(counted),
    )

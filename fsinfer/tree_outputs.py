"""What the tree stage leaves in the output folder: ``trees.csv``, ``figures/``, and why there are no trees."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from fsinfer.errors import OutputError
from fsinfer.progress import Progress, silent

if TYPE_CHECKING:
    from fsinfer.cloud import PointCloud
    from fsinfer.trees import TreeSettings

# Where a standing person holds a phone.
CAMERA_HEIGHT_M = 1.5


def write_tree_outputs(
    cloud: PointCloud,
    out: Path,
    *,
    settings: TreeSettings,
    scale_rel_std: float | None = None,
    metric: bool = True,
    camera_height: float | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure the trees of a cloud (z up) and write table and figures into ``out``.

    Parameters
    ----------
    cloud: z up; metres, or model units with ``metric=False``: then the trees get positions and no DBH.
    out: receives ``trees.csv`` and ``figures/*.png``; figures of an earlier measurement are removed.
    settings: of the measurement.
    scale_rel_std: relative standard deviation of the scale, if known; it widens every interval.
    camera_height: median height of the cameras above the ground, in units of the cloud; a person holds a camera at
        about 1.5 m, which tells roughly how large the trees are while the scale is unknown.

    Returns
    -------
    JSON values: ``trees``, ``trees_with_dbh``, ``ground_method``, ``diagnosis``, and ``warnings``, which repeat the
    diagnosis when no tree was found.

    Raises
    ------
    CloudError
        The cloud holds no plot: too few points, no ground, or a size that cannot be in metres.
    """
    from fsinfer.trees import analyse_plot
    from fsinfer.trees.figures import write_figures
    from fsinfer.trees.table import write_trees

    hint = None if camera_height is None or camera_height <= 0 else camera_height / CAMERA_HEIGHT_M
    result = analyse_plot(
        cloud.xyz,
        settings=settings,
        scale_rel_std=scale_rel_std or 0.0,
        metric=metric,
        units_per_m_hint=None if metric else hint,
        progress=progress,
    )
    write_trees(out / "trees.csv", result.trees)
    _clear_figures(out)
    write_figures(out / "figures", result)
    return {
        "trees": len(result.trees),
        "trees_with_dbh": sum(tree.dbh_cm is not None for tree in result.trees),
        "ground_method": None if result.ground is None else result.ground.method,
        "diagnosis": result.diagnosis,
        "warnings": [*result.warnings, *(() if result.trees else (result.diagnosis,))],
    }


def write_no_trees(out: Path, *, reason: str) -> dict[str, Any]:
    """Write an empty ``trees.csv`` where measuring is impossible; returns what :func:`write_tree_outputs` does."""
    from fsinfer.trees.table import write_trees

    write_trees(out / "trees.csv", [])
    _clear_figures(out)
    return {"trees": 0, "trees_with_dbh": 0, "ground_method": None, "diagnosis": reason, "warnings": [reason]}


def _clear_figures(out: Path) -> None:
    for figure in (out / "figures").glob("*.png"):
        try:
            figure.unlink()
        except OSError as error:
            msg = f"cannot remove the old {figure}: {error.strerror or error}; close the program that shows it"
            raise OutputError(msg) from error

"""Files that the tree stage writes into an output folder: old ones go, those of others stay."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from fsinfer.errors import CloudError, InputError
from fsinfer.io.files import remove_old
from fsinfer.output.layout import FIGURES_FOLDER, METRIC_TREE_FILES, TREE_FIGURE, TREES_CSV, TREES_JSON
from fsinfer.output.plot_json import read_plot
from fsinfer.workflow.ledger import Ledger

#: Stages that write the tables and figures of trees, by their names in the ledger.
_WRITERS = ("trees", "measure")
_TABLES = (TREES_CSV, TREES_JSON, *METRIC_TREE_FILES)
#: What a measurement makes beside trees.csv.
BESIDE_TREES = (TREES_JSON, *METRIC_TREE_FILES, FIGURES_FOLDER)


def clear_outputs(out: Path) -> None:
    """Remove maps and figures of an earlier measurement; :class:`OutputError` where a program holds them."""
    for path in (*_figures(out), *_there(out, METRIC_TREE_FILES)):
        remove_old(path, way_out="close the program that shows it")


def refuse_files_of_others(out: Path) -> None:
    """Raise :class:`InputError` where a file that would be written over was made by no measurement of ours.

    A folder is ours by its records, or, where it was copied without them, by a ``plot.json`` of fsinfer.
    """
    ledger = Ledger(out)
    if any(ledger.has(stage) for stage in _WRITERS) or _has_plot_of_ours(out):
        return
    for found in (*_there(out, _TABLES), *_figures(out)):
        msg = f"{found} would be replaced, and no measurement of fsinfer made it; choose another output folder"
        raise InputError(msg)


def refuse_to_write_over(cloud_path: Path, out: Path) -> None:
    """Raise :class:`CloudError` where the cloud that is to be read is a file that would be written into ``out``."""
    # By the file, not by its name: links, and disks that do not tell TREES.LAZ from trees.laz.
    for path in _there(out, _TABLES):
        if cloud_path.exists() and cloud_path.samefile(path):
            msg = (
                f"{cloud_path} would be replaced by the {path.name} of this measurement; choose another output folder, "
                "or give the cloud that it was made from"
            )
            raise CloudError(msg)


def _has_plot_of_ours(out: Path) -> bool:
    try:
        versions = read_plot(out).get("versions")
    except InputError:  # damaged: it tells nothing
        return False
    return isinstance(versions, dict) and "fsinfer" in versions


def _there(out: Path, names: tuple[str, ...]) -> Iterator[Path]:
    return (path for name in names if (path := out / name).is_file())


def _figures(out: Path) -> Iterator[Path]:
    """Figures with names of ours, in their order."""
    folder = out / FIGURES_FOLDER
    return (path for path in sorted(folder.glob("*.png")) if TREE_FIGURE.fullmatch(path.name))

"""Files that stages write straight into an output folder: old ones go, those of others stay."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from fsinfer.errors import CloudError, InputError
from fsinfer.io.files import remove_old
from fsinfer.output.layout import (
    CLOUD_LAZ,
    CLOUD_PLY,
    FIGURES_FOLDER,
    METRIC_TREE_FILES,
    TREE_FIGURE,
    TREES_CSV,
    TREES_JSON,
)
from fsinfer.output.plot_json import of_file, read_plot
from fsinfer.workflow.ledger import Ledger

#: Stages that write the tables and figures of trees, by their names in the ledger.
_WRITERS = ("trees", "measure")
#: Stages that write the cloud, likewise.
_CLOUD_WRITERS = ("cloud", "fuse_scene")
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


def refuse_clouds_of_others(out: Path) -> None:
    """Raise :class:`InputError` where a cloud that would be written over is none of ours, as of a scanner.

    It is ours by the record of the stage that wrote it, or, where the folder was copied without records, by a
    ``plot.json`` that tells where its photographs stand in it.
    """
    ledger = Ledger(out)
    if any(ledger.has(stage) for stage in _CLOUD_WRITERS) or _has_plot_of_ours(out, key="cloud_from_scene"):
        return
    for found in _there(out, (CLOUD_PLY, CLOUD_LAZ)):
        msg = f"{found} would be replaced, and no run of fsinfer made it; choose another output folder"
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


def _has_plot_of_ours(out: Path, *, key: str = "versions") -> bool:
    """Whether fsinfer wrote the folder's ``plot.json``, and it tells something of ``key``."""
    try:
        plot = of_file(read_plot(out))  # of the cloud, whatever cloud the trees are of
    except InputError:  # damaged: it tells nothing
        return False
    versions = plot.get("versions")
    return isinstance(versions, dict) and "fsinfer" in versions and plot.get(key) is not None


def _there(out: Path, names: tuple[str, ...]) -> Iterator[Path]:
    return (path for name in names if (path := out / name).is_file())


def _figures(out: Path) -> Iterator[Path]:
    """Figures with names of ours, in their order."""
    folder = out / FIGURES_FOLDER
    return (path for path in sorted(folder.glob("*.png")) if TREE_FIGURE.fullmatch(path.name))

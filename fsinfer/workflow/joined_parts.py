"""Parts of a walk that were measured apart, put into the plot's tables by the pattern of their stems."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import FsinferError, ImageError
from fsinfer.geometry.similarity import apply, compose
from fsinfer.io.cloud import read_cloud
from fsinfer.io.digest import file_digest
from fsinfer.io.files import copy_file
from fsinfer.notices.notice import Notice
from fsinfer.notices.stems import StemCode
from fsinfer.output.layout import OutputFolder
from fsinfer.output.plot_json import read_plot
from fsinfer.plot_border.sight import Cameras
from fsinfer.scene import read_scene
from fsinfer.silhouettes.walk import WalkSettings, outside_walk, stems_outside_walk
from fsinfer.trees.ground.ground import find_ground
from fsinfer.trees.ground.settings import GroundSettings
from fsinfer.trees.measure import PlotResult, trees_found
from fsinfer.trees.outputs.reasons import read_reasons
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.pattern.join import JoinedPart, PartStems, join_parts
from fsinfer.trees.pattern.match import PatternSettings
from fsinfer.trees.stand import near_ground, seen_cells
from fsinfer.trees.tree import OUTSIDE, Tree

_log = logging.getLogger(__name__)
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class JoinedParts:
    """What joined parts add to a plot.

    Attributes
    ----------
    parts: those that are joined. numbers: of their stems in their parts, by those in the plot.
    ground_xy: (N, 2), where they saw ground, in the plot's frame, outside of their walks too.
    """

    parts: tuple[JoinedPart, ...] = ()
    numbers: dict[int, int] = field(default_factory=dict)
    ground_xy: Floats = field(default_factory=lambda: np.zeros((0, 2)))


def digests_of(folders: Sequence[Path]) -> list[str]:
    """What the stems of the parts depend on."""
    return [file_digest(path) for folder in folders if (path := OutputFolder(folder).trees_csv).is_file()]


def join_measured(
    result: PlotResult,
    folders: Sequence[Path],
    *,
    settings: PatternSettings,
    ground: GroundSettings,
    walk: WalkSettings,
    gone: Sequence[Tree] = (),
) -> tuple[PlotResult, JoinedParts]:
    """The plot with the stems of the parts in ``folders``, each stem once.

    Parameters
    ----------
    folders: of parts that were measured; one without metres, or that cannot be read, stays apart.
    walk: says which of the ground that a part saw belongs to it, where it has photographs.
    gone: trees of the plot that were taken out by hand; they do not come back by a part that saw them too.

    Returns
    -------
    The plot, whose area holds the ground of the joined parts, and what they add besides.
    """
    if not folders:
        return result, JoinedParts()
    stems = [part for folder in folders if (part := _stems_of(folder)) is not None]
    joined = join_parts(result.trees, stems, settings=settings, gone=gone)
    if not joined.parts:
        return result, JoinedParts()
    stay = {tree.tree_id for tree in joined.stay}
    pairs = [pair for pair in zip(result.trees, result.sections, strict=True) if pair[0].tree_id in stay]
    by_name = {folder.name: folder for folder in folders}
    grounds = [_ground_of(by_name[part.name], part, ground) for part in joined.parts]
    added = JoinedParts(parts=joined.parts, numbers=joined.numbers, ground_xy=np.concatenate(grounds))
    walked = [_walked(xy, by_name[part.name], part, walk) for xy, part in zip(grounds, joined.parts, strict=True)]
    trees = (*joined.stay, *joined.joined)
    plot = replace(
        result,
        diagnosis=trees_found(trees),
        trees=tuple(tree for tree, _ in pairs),
        sections=tuple(section for _, section in pairs),
        joined=joined.joined,
        warnings=(*_outside_now(result.warnings, trees), *joined.warnings),
    )
    return _with_ground(plot, np.concatenate(walked)), added


def cameras_of(out: Path, parts: Sequence[JoinedPart]) -> tuple[Cameras, ...]:
    """The cameras of joined parts, in the plot's frame."""
    return tuple(_cameras(out / part.name, part) for part in parts)


def copy_figures(out: Path, plot: PlotResult, numbers: dict[int, int]) -> None:
    """The figures of joined stems, by their numbers in the plot; ``numbers`` are those in their parts.

    The title of a section has the number in the part: that in the plot stands above it.
    """
    from fsinfer.trees.outputs.figures import relabel_section  # loads matplotlib

    there = OutputFolder(out)
    for tree in plot.joined:
        part = OutputFolder(out / str(tree.part))
        number = numbers[tree.tree_id]
        section, edges = part.section_figure(number), part.edges_figure(number)
        if section.is_file():
            told = f"{number} in {tree.part}"
            try:
                relabel_section(section, there.section_figure(tree.tree_id), number=tree.tree_id, told=told)
            except ImageError as error:
                _log.info("the figure of tree %s cannot be read: %s", told, error)
        if edges.is_file():
            copy_file(edges, there.edges_figure(tree.tree_id))


def _outside_now(warnings: Sequence[Notice], trees: Sequence[Tree]) -> tuple[Notice, ...]:
    """The warnings, of which the one about stems outside of the walk names those that no part measured."""
    outside = [tree for tree in trees if tree.status == OUTSIDE]
    others = tuple(told for told in warnings if told.code != StemCode.stems_outside_walk)
    return (*others, stems_outside_walk(outside)) if outside and len(others) < len(warnings) else others


def _stems_of(folder: Path) -> PartStems | None:
    """The stems that a part measured, None where it has no metres or cannot be read."""
    part = OutputFolder(folder)
    try:
        if read_plot(folder).get("units") != "m":
            return None
        reasons = read_reasons(part.trees_json)
        trees = tuple(replace(tree, reasons=reasons[tree.tree_id]) for tree in read_trees(part.trees_csv))
    except (FsinferError, OSError, KeyError) as error:
        _log.info("the stems of %s cannot be read: %s", folder.name, error)
        return None
    return PartStems(name=folder.name, trees=trees)


def _cameras(folder: Path, part: JoinedPart) -> Cameras:
    own = np.asarray(read_plot(folder)["cloud_from_scene"], np.float64)
    place = compose(part.plot_from_part, own)
    return Cameras(scene=read_scene(OutputFolder(folder).scene), cloud_from_scene=place)


def _walked(ground_xy: Floats, folder: Path, part: JoinedPart, walk: WalkSettings) -> Floats:
    """Those of the places (N, 2) where the part saw ground that belong to its walk; all where it has no photographs."""
    try:
        cameras = _cameras(folder, part)
    except (FsinferError, OSError, KeyError) as error:
        _log.info("where %s was photographed cannot be read: %s", folder.name, error)
        return ground_xy
    far, _ = outside_walk(ground_xy, cameras.places[:, :2], walk)
    return np.asarray(ground_xy[~far])


def _ground_of(folder: Path, part: JoinedPart, settings: GroundSettings) -> Floats:
    """Middles (N, 2) of the cells where the part saw ground, in the plot's frame."""
    points = read_cloud(OutputFolder(folder).cloud_ply).xyz
    ground = find_ground(points, settings=settings)
    cells = seen_cells(near_ground(points, ground.height_at(points[:, :2])))
    flat = np.column_stack([cells.middles, np.zeros(np.count_nonzero(cells.seen))])
    return np.asarray(apply(part.plot_from_part, flat)[:, :2])


def _with_ground(plot: PlotResult, more_xy: Floats) -> PlotResult:
    """The plot, whose area has the ground of the parts too."""
    if not len(more_xy) or plot.seen_ground is None:
        return plot
    places = np.array([[tree.x_m, tree.y_m] for tree in plot.all_trees if not tree.outside]).reshape(-1, 2)
    ground = plot.seen_ground.with_places(more_xy)
    return replace(plot, seen_ground=ground, plot_area_m2=ground.area(places))

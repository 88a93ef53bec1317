"""A stem map corrected by hand: trees deleted, added and merged by a CSV, and measured again in the same cloud.

The cloud is searched as before, so that the trees keep the numbers which the edits name; then the rows are applied in
their order. Depth and cloud are not touched.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import InputError
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.by_hand import PlotAgain
from fsinfer.trees.diameter.section import Section, unmeasured_section
from fsinfer.trees.edit_rows import EDITS_FILE, TreeEdit
from fsinfer.trees.level_cut import without_tops_at
from fsinfer.trees.measure import PlotResult
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.search.stem import Stem
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.shape_doubts import allow_for_shape
from fsinfer.trees.stem_measurement import doubt_the_rough, tree_of
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]
_Pair = tuple[Tree, Section]
#: Radius in metres of the ring on the map where nothing is measured. Source: layout.
LABEL_RADIUS_M = 0.1
#: A tree may be added so far beyond the cloud, metres: a stem that nobody saw. Source: judgement; what is farther is a
#: place in another frame, or a slip of the pen.
BEYOND_M = 100.0
#: Two entries that are to be merged are one stem: they stand no farther apart than the sum of their radii and this,
#: metres. Source: judgement; what a lean or a haze tears apart is less, the next stem of a dense stand farther.
MERGE_REACH_M = 0.5


@dataclass(frozen=True, kw_only=True)
class _Entry:
    """A tree of the map: as it was ``found``, or one by hand, of which ``said`` tells and whose stem is measured last.

    ``place`` (2,) and ``radius_m`` are those at breast height, 0 where it has none.
    """

    place: Floats
    radius_m: float = 0.0
    stem: Stem | None = None
    found: _Pair | None = None
    said: Notice | None = None

    def holds(self, place: Floats) -> bool:
        """Whether a place (2,) lies in it; one without a diameter may be anything, and counts for a thin one."""
        return float(np.linalg.norm(place - self.place)) < max(self.radius_m, LABEL_RADIUS_M)


def apply_edits(
    result: PlotResult,
    points: Floats,
    edits: Sequence[TreeEdit],
    *,
    settings: TreeSettings,
    scale_rel_std: float = 0.0,
    metric: bool = True,
    errors: PointErrors | None = None,
    parts: Sequence[str] = (),
) -> PlotResult:
    """Apply ``edits`` to the trees of a plot; trees that they do not name stay as they are, with their numbers.

    Parameters
    ----------
    result: of :func:`fsinfer.trees.analyse_plot` on ``points``.
    points: (N, 3), z up, in the frame of the trees' positions.
    metric: False where positions are in model units: then trees are moved about, but nothing is measured.
    errors: of a cloud of photographs, by which the points of a stem are weighed.
    parts: folders of parts of the walk, whose trees come into the plot's table later and are corrected there.

    Raises
    ------
    InputError
        An edit names a tree that is not there (any more), adds one with a number that is taken, within another one or
        far outside of the cloud, or merges two that stand too far apart.
    """
    trees = {
        tree.tree_id: _Entry(
            place=np.array([tree.x_m, tree.y_m]),
            radius_m=tree.radius_m,
            found=(tree, section),
        )
        for tree, section in zip(result.trees, result.sections, strict=True)
    }
    first_free = max([0, *trees, *(edit.tree_id or 0 for edit in edits if edit.action == "add")]) + 1
    done: list[Notice] = []
    again = None
    if metric and any(edit.action != "delete" for edit in edits):
        again = PlotAgain.of(result, points, settings, scale_rel_std, errors)
    for edit in edits:
        if edit.action == "add":
            number = edit.tree_id if edit.tree_id is not None else first_free
            if number in trees:
                msg = f"row {edit.row} of the edits adds a tree {number}, but there is one; leave tree_id empty"
                raise InputError(msg)
            first_free += edit.tree_id is None
            place = np.array([_number(edit.x_m), _number(edit.y_m)])
            if metric:
                _refuse_within(place, trees, edit.row)
            _refuse_beyond(place, result, edit.row)
            said = notice(StemCode.added_by_hand)
            trees[number] = _by_hand(place[None], said, again, trees.values(), settings.bh_m)
            done.append(notice(StemCode.tree_added, tree_id=number))
        elif edit.action == "delete":
            number = _known(edit.tree_id, trees, edit.row, parts)
            del trees[number]
            done.append(notice(StemCode.tree_deleted, tree_id=number))
        else:
            number, other = (_known(named, trees, edit.row, parts) for named in (edit.tree_id, edit.other_id))
            if metric:
                _refuse_far(trees, number, other, edit.row)
            places = np.array([trees.pop(number).place, trees.pop(other).place])
            said = notice(StemCode.merged_by_hand, tree_id=number, other_id=other)
            trees[number] = _by_hand(places, said, again, trees.values(), settings.bh_m)
            done.append(notice(StemCode.tree_merged, other_id=other, tree_id=number))
    measured_by_hand = {} if again is None else _measured(trees, result, again)
    ordered = [
        entry.found or _numbered(measured_by_hand.get(number), number, entry, result, settings, metric=metric)
        for number, entry in sorted(trees.items())
    ]
    measured = sum(tree.dbh_cm is not None for tree, _ in ordered)
    told = (notice(StemCode.corrected_by_hand, changes=tuple(done)),) if done else ()
    return replace(
        result,
        trees=tuple(tree for tree, _ in ordered),
        sections=tuple(section for _, section in ordered),
        diagnosis=notice(StemCode.trees_corrected, trees=len(ordered), measured=measured),
        warnings=(*result.warnings, *told),
    )


def _by_hand(places: Floats, said: Notice, again: PlotAgain | None, others: Iterable[_Entry], bh_m: float) -> _Entry:
    """The entry of a tree at one place (1, 2), or of two (2, 2) that are one; none of ``others``."""
    others = tuple(others)
    stem = None
    if again is not None:
        stem = again.stem_at(places, lambda center: any(other.holds(center) for other in others))
    if stem is None:
        return _Entry(place=places.mean(axis=0), said=said)
    return _Entry(place=stem.axis.center_at(bh_m), radius_m=stem.axis.radius_m, stem=stem, said=said)


def _measured(trees: Mapping[int, _Entry], result: PlotResult, again: PlotAgain) -> dict[int, _Pair]:
    """The entries by hand that measure as a tree, by their numbers.

    When all rows are applied: what stands beside a tree, and what is usual in its plot, the corrected map tells.
    """
    bh_m = again.settings.bh_m
    own = {number: entry.stem for number, entry in trees.items() if entry.found is None and entry.stem is not None}
    if not own:
        return {}
    found = {number: entry.found for number, entry in trees.items() if entry.found is not None}
    of_trees = {tree.tree_id for tree in result.trees}
    beside = []
    for other in result.stems:
        # What the search found and is no tree's hides others as before, unless a person says that it is one of them.
        here = other.stem.axis.center_at(bh_m)
        is_own = any(
            np.linalg.norm(stem.axis.center_at(bh_m) - here) < max(stem.axis.radius_m, other.stem.axis.radius_m)
            for stem in own.values()
        )
        if other.tree_id in found or (other.tree_id not in of_trees and not is_own):
            beside.append(other.stem)
    measured = dict(zip(own, again.measured(list(own.values()), beside), strict=True))
    pairs = {number: pair for number, pair in measured.items() if pair is not None}
    entries = list(pairs.values())
    if result.cut_level_m is not None:
        entries = without_tops_at(result.cut_level_m, entries)
    # What is usual in this plot, its other stems tell.
    allowed = allow_for_shape(entries, beside=[section for _, section in found.values()], settings=again.settings)
    return dict(zip(pairs, doubt_the_rough(allowed, beside=[tree for tree, _ in found.values()]), strict=True))


def _refuse_within(place: Floats, trees: Mapping[int, _Entry], row: int) -> None:
    for number, entry in trees.items():
        if entry.holds(place):
            msg = (
                f"row {row} of the edits adds a tree at ({place[0]:.2f}, {place[1]:.2f}), which lies in tree "
                f"{number}; leave the row out, or, where that is no tree of the map (a warning of the last run may say "
                f"that it was left out), delete {number} in a row above"
            )
            raise InputError(msg)


def _refuse_far(trees: Mapping[int, _Entry], one: int, other: int, row: int) -> None:
    apart = float(np.linalg.norm(trees[one].place - trees[other].place))
    most = trees[one].radius_m + trees[other].radius_m + MERGE_REACH_M
    if apart > most:
        msg = (
            f"row {row} of the edits merges the trees {one} and {other}, which stand {apart:.2f} m "
            f"apart (at most {most:.2f} m for one stem); check the numbers, or delete one and add another"
        )
        raise InputError(msg)


def _refuse_beyond(place: Floats, result: PlotResult, row: int) -> None:
    x_min, y_min, x_max, y_max = result.extent_m
    reach = BEYOND_M * (result.units_per_m or 1.0)
    if not (x_min - reach <= place[0] <= x_max + reach and y_min - reach <= place[1] <= y_max + reach):
        msg = (
            f"row {row} of the edits adds a tree at ({place[0]:.2f}, {place[1]:.2f}), far outside of the cloud, which "
            f"reaches from ({x_min:.2f}, {y_min:.2f}) to ({x_max:.2f}, {y_max:.2f}); check its place"
        )
        raise InputError(msg)


def _numbered(
    found: _Pair | None,
    number: int,
    entry: _Entry,
    result: PlotResult,
    settings: TreeSettings,
    *,
    metric: bool,
) -> _Pair:
    said = () if entry.said is None else (entry.said,)
    if found is not None:
        tree, section = found
        reasons = (*said, *tree.reasons)
        return replace(tree, tree_id=number, reasons=reasons), replace(section, reasons=reasons)
    reasons = (*said, notice(StemCode.no_stem_here if metric else StemCode.no_scale))
    section = unmeasured_section(entry.place, settings.bh_m, reasons, radius_m=LABEL_RADIUS_M)
    # The ground is in the metres that were guessed, the place in units.
    units = result.units_per_m or 1.0
    z_ground = 0.0 if result.ground is None else units * float(result.ground.height_at(entry.place[None] / units)[0])
    tree = tree_of(section, z_ground, None, np.zeros(3))
    return replace(tree, tree_id=number), section


def _known(number: int | None, trees: Iterable[int], row: int, parts: Sequence[str]) -> int:
    known = sorted(trees)
    if number is None or number not in known:
        there = ", ".join(map(str, known)) or "none"
        msg = f"row {row} of the edits names tree {number}, which is not there (any more); the trees are: {there}"
        if parts:
            files = " or ".join(f"{part}/{EDITS_FILE}" for part in parts)
            msg += f"; one that only a part of the walk saw is corrected in {files}, by the number it has there"
        raise InputError(msg)
    return number


def _number(value: float | None) -> float:
    return math.nan if value is None else value

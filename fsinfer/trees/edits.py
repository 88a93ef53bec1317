"""A stem map corrected by hand: trees deleted, added and merged by a CSV, and measured again in the same cloud.

The cloud is searched as before, so that the trees keep the numbers which the edits name; then the rows are applied in
their order. Depth and cloud are not touched.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import InputError
from fsinfer.io.csv_text import CsvRow, read_table
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.diameter.section import Section, unmeasured_section
from fsinfer.trees.measure import PlotResult
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.search.find import find_stems
from fsinfer.trees.search.stem import Stem, StemSettings
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.shape_doubts import allow_for_shape
from fsinfer.trees.stem_measurement import doubt_the_rough, measure_stems, tree_of
from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]

EDITS_FILE = "edits.csv"
#: The columns that each action needs.
ACTIONS = {"delete": ("tree_id",), "add": ("x_m", "y_m"), "merge": ("tree_id", "other_id")}
#: A point set by hand on a map lies within this of the stem's middle, besides its radius, metres. Source: not recorded.
REACH_M = 0.35
#: Points around a place that are looked at, metres: the widest stem, and what it has to stand out from.
#: Source: not recorded.
AROUND_M = 1.5
#: Radius in metres of the ring on the map where nothing is measured. Source: layout.
LABEL_RADIUS_M = 0.1
#: A tree may be added so far beyond the cloud, metres: a stem that nobody saw. Source: judgement; what is farther is a
#: place in another frame, or a slip of the pen.
BEYOND_M = 100.0
#: Numbers of trees go no higher: tables of other programs hold them in 32 bits. Source: format.
MOST_NUMBER = 999_999_999
#: Two entries that are to be merged are one stem: they stand no farther apart than the sum of their radii and this,
#: metres. Source: judgement; what a lean or a haze tears apart is less, the next stem of a dense stand farther.
MERGE_REACH_M = 0.5
#: Of two stems as near to a place the better one is taken; metres a unit of quality. Source: numerics.
TIE = 1e-3
#: A person says that a stem stands there: much less evidence is asked for than where nobody said so. Source: not
#: recorded.
SEEN_BY_PERSON = StemSettings(
    min_votes=0.8, min_length_m=0.3, min_arc=0.08, max_filled=0.6, max_noise=0.6, min_contrast=1.1, rough_m=0.025,
    sure_length_m=0.3, sure_arc=0.08, thin_m=0.0,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class TreeEdit:
    """One row of the CSV; fields that the action does not use are None. ``tree_id`` of an added tree is its number."""

    action: str
    row: int
    tree_id: int | None = None
    other_id: int | None = None
    x_m: float | None = None
    y_m: float | None = None


def read_edits(path: Path | str) -> tuple[TreeEdit, ...]:
    """Read an edits file: ``action, tree_id, other_id, x_m, y_m``, of which each action needs its own.

    Commas between the cells, or semicolons, and then decimal commas are understood too.

    Raises
    ------
    InputError
        The file cannot be read, a column that an action needs is missing, or a cell is wrong; file and row are named.
    """
    table = read_table(
        path,
        what="the edits",
        required=("action",),
        way_out="give a CSV whose first line is action,tree_id,other_id,x_m,y_m (see docs/trees.md)",
    )
    edits = tuple(_read_row(row, table.columns) for row in table.rows)
    given = Counter(edit.tree_id for edit in edits if edit.action == "add" and edit.tree_id is not None)
    for number, count in given.items():
        if count > 1:
            msg = f"{path}: {count} added trees have the tree_id {number}; give each its own, or leave the cell empty"
            raise InputError(msg)
    return edits


def find_edits(out: Path, given: Path | None) -> tuple[TreeEdit, ...]:
    """The edits of a file that was given, or of ``edits.csv`` in the output folder; none where there is neither."""
    if given is not None:
        return read_edits(given)
    path = out / EDITS_FILE
    return read_edits(path) if path.is_file() else ()


def apply_edits(
    result: PlotResult,
    points: Floats,
    edits: Sequence[TreeEdit],
    *,
    settings: TreeSettings,
    scale_rel_std: float = 0.0,
    metric: bool = True,
    errors: PointErrors | None = None,
) -> PlotResult:
    """Apply ``edits`` to the trees of a plot; trees that they do not name stay as they are, with their numbers.

    Parameters
    ----------
    result: of :func:`fsinfer.trees.analyse_plot` on ``points``.
    points: (N, 3), z up, in the frame of the trees' positions.
    metric: False where positions are in model units: then trees are moved about, but nothing is measured.
    errors: of a cloud of photographs, by which the points of a stem are weighed.

    Raises
    ------
    InputError
        An edit names a tree that is not there (any more), adds one with a number that is taken, within another one or
        far outside of the cloud, or merges two that stand too far apart.
    """
    trees = {tree.tree_id: (tree, section) for tree, section in zip(result.trees, result.sections, strict=True)}
    first_free = max([0, *trees, *(edit.tree_id or 0 for edit in edits if edit.action == "add")]) + 1
    done: list[Notice] = []
    measured_at = partial(_measured_at, result, points, errors, settings, scale_rel_std)
    for edit in edits:
        if edit.action == "add":
            number = edit.tree_id if edit.tree_id is not None else first_free
            if number in trees:
                msg = f"row {edit.row} of the edits adds a tree {number}, but there is one; leave tree_id empty"
                raise InputError(msg)
            first_free += edit.tree_id is None
            place = np.array([_number(edit.x_m), _number(edit.y_m)])
            others = list(trees.values()) if metric else []
            _refuse_within(place, [tree for tree, _ in others], edit.row)
            _refuse_beyond(place, result, edit.row)
            found = measured_at(place[None], others) if metric else None
            said = notice(StemCode.added_by_hand)
            trees[number] = _numbered(found, number, place, result, settings, said, metric=metric)
            done.append(notice(StemCode.tree_added, tree_id=number))
        elif edit.action == "delete":
            number = _known(edit.tree_id, trees, edit.row)
            del trees[number]
            done.append(notice(StemCode.tree_deleted, tree_id=number))
        else:
            number, other = _known(edit.tree_id, trees, edit.row), _known(edit.other_id, trees, edit.row)
            places = np.array([[trees[i][0].x_m, trees[i][0].y_m] for i in (number, other)])
            if metric:
                _refuse_far(trees[number][0], trees[other][0], edit.row)
            others = [pair for i, pair in trees.items() if i not in (number, other)]
            found = measured_at(places, others) if metric else None
            said = notice(StemCode.merged_by_hand, tree_id=number, other_id=other)
            del trees[other]
            trees[number] = _numbered(found, number, places.mean(axis=0), result, settings, said, metric=metric)
            done.append(notice(StemCode.tree_merged, other_id=other, tree_id=number))
    ordered = [trees[number] for number in sorted(trees)]
    measured = sum(tree.dbh_cm is not None for tree, _ in ordered)
    told = (notice(StemCode.corrected_by_hand, changes=tuple(done)),) if done else ()
    return replace(
        result,
        trees=tuple(tree for tree, _ in ordered),
        sections=tuple(section for _, section in ordered),
        diagnosis=notice(StemCode.trees_corrected, trees=len(ordered), measured=measured),
        warnings=(*result.warnings, *told),
    )


def _refuse_within(place: Floats, others: Sequence[Tree], row: int) -> None:
    for tree in others:
        if _within(place, tree):
            msg = (
                f"row {row} of the edits adds a tree at ({place[0]:.2f}, {place[1]:.2f}), which lies in tree "
                f"{tree.tree_id}; delete that one first, or leave the row out"
            )
            raise InputError(msg)


def _refuse_far(one: Tree, other: Tree, row: int) -> None:
    apart = math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
    most = one.radius_m + other.radius_m + MERGE_REACH_M
    if apart > most:
        msg = (
            f"row {row} of the edits merges the trees {one.tree_id} and {other.tree_id}, which stand {apart:.2f} m "
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


def _within(place: Floats, tree: Tree) -> bool:
    """Whether a place lies in a tree; one without a diameter may be anything, and counts for a thin one."""
    return math.hypot(place[0] - tree.x_m, place[1] - tree.y_m) < max(tree.radius_m, LABEL_RADIUS_M)


def _measured_at(
    result: PlotResult,
    points: Floats,
    errors: PointErrors | None,
    settings: TreeSettings,
    scale_rel_std: float,
    places: Floats,
    others: Sequence[tuple[Tree, Section]],
) -> tuple[Tree, Section] | None:
    """The best stem at one place (1, 2), or over two (2, 2) that are the same tree; None where nothing can be seen.

    It is none of ``others``, which have entries of their own.
    """
    if result.ground is None:
        return None
    middle = places.mean(axis=0)
    apart = float(np.linalg.norm(places - middle, axis=1).max())
    about = np.hypot(*(points[:, :2] - middle).T) <= AROUND_M + apart
    # About an origin of its own, as in the search: map coordinates would cost precision in the fits.
    origin = np.r_[np.floor(middle), 0.0]
    ground = result.ground.moved(-origin[:2])
    stand = points[about] - origin
    stand[:, 2] -= ground.height_at(stand[:, :2])
    own = None if errors is None else errors.select(about)
    best: tuple[Stem, float] | None = None
    for wanted in (settings.stems, SEEN_BY_PERSON):
        search = find_stems(stand, bh_m=settings.bh_m, settings=wanted, seed=settings.seed)
        for stem in search.stems:
            center = stem.axis.center_at(settings.bh_m) + origin[:2]
            off = float(np.linalg.norm(center - middle))
            if off > REACH_M + apart + stem.axis.radius_m or any(_within(center, tree) for tree, _ in others):
                continue
            # One place: the nearest. Two: the one with the most to show for itself.
            worth = stem.quality if len(places) > 1 else -max(off - stem.axis.radius_m, 0.0) + TIE * stem.quality
            if best is None or worth > best[1]:
                best = stem, worth
        if best is not None:
            alone = replace(search, stems=(best[0],))
            pairs = measure_stems(stand, alone, ground, settings, scale_rel_std, origin, errors=own)
            if not pairs:
                return None
            # What is usual in this plot, its other stems tell.
            pairs = allow_for_shape(pairs, beside=[section for _, section in others], settings=settings)
            return doubt_the_rough(pairs, beside=[tree for tree, _ in others])[0]
    return None


def _numbered(
    found: tuple[Tree, Section] | None,
    number: int,
    place: Floats,
    result: PlotResult,
    settings: TreeSettings,
    said: Notice,
    *,
    metric: bool,
) -> tuple[Tree, Section]:
    if found is not None:
        tree, section = found
        reasons = (said, *tree.reasons)
        return replace(tree, tree_id=number, reasons=reasons), replace(section, reasons=reasons)
    reasons = (said, notice(StemCode.no_stem_here if metric else StemCode.no_scale))
    section = unmeasured_section(place, settings.bh_m, reasons, radius_m=LABEL_RADIUS_M)
    # The ground is in the metres that were guessed, the place in units.
    units = result.units_per_m or 1.0
    z_ground = 0.0 if result.ground is None else units * float(result.ground.height_at(place[None] / units)[0])
    tree = tree_of(section, z_ground, None, np.zeros(3))
    return replace(tree, tree_id=number), section


def _known(number: int | None, trees: Iterable[int], row: int) -> int:
    known = sorted(trees)
    if number is None or number not in known:
        there = ", ".join(map(str, known)) or "none"
        msg = f"row {row} of the edits names tree {number}, which is not there (any more); the trees are: {there}"
        raise InputError(msg)
    return number


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _is_tree_number(value: float) -> bool:
    return value == int(value) and 1 <= value <= MOST_NUMBER


def _read_row(row: CsvRow, columns: Sequence[str]) -> TreeEdit:
    action = row.text("action").lower()
    if action not in ACTIONS:
        msg = f"{row.place}: the action is '{action}'; it must be {', '.join(ACTIONS)}"
        raise InputError(msg)
    missing = [name for name in ACTIONS[action] if name not in columns]
    if missing:
        msg = f"{row.place}: '{action}' needs the column {' and '.join(missing)}, which the file does not have; add it"
        raise InputError(msg)
    numbers: dict[str, float | None] = {}
    for name in ("tree_id", "other_id", "x_m", "y_m"):
        value = row.value(name)
        if value is None and name not in ACTIONS[action]:
            numbers[name] = None
            continue
        whole = name.endswith("_id")
        if value is None or not math.isfinite(value) or (whole and not _is_tree_number(value)):
            kind = f"the number of a tree, 1 to {MOST_NUMBER}," if whole else "a number"
            msg = f"{row.place}: '{action}' needs {kind} in the column {name}, not '{row.text(name)}'"
            raise InputError(msg)
        numbers[name] = value
    tree_id, other_id = numbers["tree_id"], numbers["other_id"]
    if action == "merge" and tree_id == other_id:
        msg = f"{row.place}: a tree cannot be merged with itself; name two trees"
        raise InputError(msg)
    return TreeEdit(
        action=action,
        row=row.row,
        tree_id=None if tree_id is None else int(tree_id),
        other_id=None if other_id is None else int(other_id),
        x_m=numbers["x_m"],
        y_m=numbers["y_m"],
    )

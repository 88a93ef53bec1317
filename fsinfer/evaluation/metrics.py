"""How good the extracted diameters are, against a caliper or tape: the metrics of the field, reported together.

Accuracy without completeness misleads, so both are always given. With ``n_measured`` trees on the ground:

- *detected*: measured trees that have an extracted stem at their place;
- *matched*: detected trees whose extracted stem has a DBH. A stem found but not measured counts as detected only;
- ``r`` = matched / n_measured (the paper's completeness), *omitted* = n_measured - detected, *false* = extracted
  stems that no measured tree explains (with or without a DBH). Photographs also see trees beyond the plot, where nobody
  measured: those that the table itself calls ``outside`` of the walk, and with an area margin those beyond it, are
  *outside* and not judged;
- over the matched: bias = mean(extracted - measured), MAE, RMSE = sqrt(mean(difference^2)),
  rRMSE = RMSE / mean measured DBH of the matched, AE = 1 - rRMSE (FS-MVSNet, Forests 2025, 16, 927). Omitted trees have
  no error: these are figures of the matched, not of all trees, and are shown as such.

Where the two lists have different local frames, a rigid motion of the plane (rotation and shift, never a scale) is
found from pairs of trees at equal distances, and used only when it explains clearly more trees. Trees are never matched
by their diameters, which are what is judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import InputError
from fsinfer.evaluation.registration import apply, assign, register
from fsinfer.evaluation.settings import MAX_DISTANCE_M, Align
from fsinfer.geometry.hull import in_hull
from fsinfer.io.csv_text import read_table

Floats = NDArray[np.float64]
ALIGNMENTS = tuple(align.value for align in Align)

#: A measured diameter is below this, cm. Source: format; no tree is thicker, millimetres are.
_MOST_DBH_CM = 1000.0
#: A table without a thicker tree than this is not in centimetres. Source: judgement; a stem of 2 m has 2 in metres.
_LEAST_DBH_CM = 2.0
#: Diameters of the same trees that differ by so many times are in other units. Source: judgement; a centimetre has ten
#: millimetres.
_OTHER_UNIT = (7.0, 14.0)
#: Status of a stem outside of the walk. Source: format; ``trees.csv``.
_OUTSIDE = "outside"
#: Frames are registered where fewer than this share of the trees match as given. Source: judgement.
_FEW_MATCHES = 0.5
#: Registration counts where it finds so many times the matches, so many more, and so many at least. Source: judgement.
_MORE_TIMES, _MORE_MATCHES, _LEAST_MATCHES = 1.5, 2, 3


class HasDbh(Protocol):
    """What :func:`evaluate` needs of a tree; :class:`MeasuredTree` and :class:`fsinfer.trees.Tree` have it.

    They have a ``status`` besides, which says what stands outside of the walk.
    """

    @property
    def tree_id(self) -> Any: ...  # noqa: D102
    @property
    def x_m(self) -> float: ...  # noqa: D102
    @property
    def y_m(self) -> float: ...  # noqa: D102
    @property
    def dbh_cm(self) -> float | None: ...  # noqa: D102


@dataclass(frozen=True, kw_only=True)
class MeasuredTree:
    """A tree from a CSV: identifier as written, position in metres (NaN when not given), DBH in cm or None.

    ``status`` is that of a ``trees.csv``, empty where the table has none.
    """

    tree_id: str
    x_m: float
    y_m: float
    dbh_cm: float | None
    status: str = ""


@dataclass(frozen=True, kw_only=True)
class Pair:
    """A measured tree and the stem found for it; ``distance_m`` is after alignment, None when matched by id."""

    measured_id: str
    extracted_id: str
    measured_cm: float
    extracted_cm: float | None
    distance_m: float | None


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The metrics of :mod:`fsinfer.evaluation.metrics`; those of accuracy are None when nothing matched.

    ``false`` counts extracted trees without a partner, but not those that have the status ``outside``; with an area
    margin only those inside the measured area. ``outside`` counts those others: nobody measured there, and nothing can
    be said.

    ``measured_from_extracted`` holds rotation in degrees and shift in metres when the frames were aligned, else None.
    """

    n: int
    extracted: int
    detected: int
    matched: int
    omitted: int
    false: int
    outside: int
    r: float
    rmse_cm: float | None
    rrmse: float | None
    ae: float | None
    bias_cm: float | None
    mae_cm: float | None
    measured_from_extracted: dict[str, float] | None
    pairs: tuple[Pair, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, for JSON."""
        return asdict(self)


def read_measured(path: Path, *, need_dbh: bool = True, need_position: bool = True) -> list[MeasuredTree]:
    """Read a CSV with ``tree_id, x_m, y_m, dbh_cm`` (other columns are ignored; comma, semicolon or tab).

    With ``need_dbh=False`` empty DBH cells become None, as in a ``trees.csv``; with ``need_position=False`` empty or
    missing positions become NaN, for matching by id. Raises :class:`~fsinfer.errors.InputError` naming row and column.
    """
    table = read_table(
        path,
        what="the trees",
        required=("tree_id", "x_m", "y_m", "dbh_cm") if need_position else ("tree_id", "dbh_cm"),
        way_out="give a CSV file whose first line is tree_id,x_m,y_m,dbh_cm",
    )
    trees: list[MeasuredTree] = []
    seen: dict[str, int] = {}
    for row in table.rows:
        tree_id = row.text("tree_id")
        if not tree_id:
            msg = f"{row.place}: the tree_id is empty; give every tree its own"
            raise InputError(msg)
        if tree_id in seen:
            msg = f"{row.place}: tree_id {tree_id} was used in row {seen[tree_id]} already; make it unique"
            raise InputError(msg)
        seen[tree_id] = row.row
        if row.text("reason") == "no scale":
            msg = f"{path} was made without a scale: its positions are no metres; give fsinfer run a scale first"
            raise InputError(msg)
        dbh = row.given("dbh_cm") if need_dbh else row.number("dbh_cm")
        if dbh is not None and not 0.0 < dbh < _MOST_DBH_CM:
            msg = f"{row.place}: dbh_cm is {dbh:g}; it must lie between 0 and 1000 cm (0 is not 'unmeasured')"
            raise InputError(msg)
        x, y = (row.given(name) if need_position else row.number(name) for name in ("x_m", "y_m"))
        trees.append(
            MeasuredTree(
                tree_id=tree_id,
                x_m=float("nan") if x is None else x,
                y_m=float("nan") if y is None else y,
                dbh_cm=dbh,
                status=row.text("status"),
            )
        )
    thickest = max((tree.dbh_cm or 0.0 for tree in trees), default=0.0)
    if need_dbh and trees and thickest < _LEAST_DBH_CM:
        msg = f"{path}: no dbh_cm is above {thickest:g} cm; give centimetres, not metres"
        raise InputError(msg)
    if need_dbh and not trees:
        msg = f"{path} holds no measured trees, only a header; give at least one tree"
        raise InputError(msg)
    return trees


def _refuse_other_units(pairs: Sequence[Pair]) -> None:
    """Refuse one of two tables that holds millimetres."""
    ratios = [pair.measured_cm / pair.extracted_cm for pair in pairs if pair.extracted_cm and pair.measured_cm]
    if len(ratios) < _LEAST_MATCHES:
        return
    times = float(np.median(ratios))
    for name, larger in (("measured", times), ("extracted", 1.0 / times)):
        if _OTHER_UNIT[0] <= larger <= _OTHER_UNIT[1]:
            msg = f"the {name} diameters are {larger:.0f} times the others: give centimetres, not millimetres"
            raise InputError(msg)


def evaluate(
    measured: Sequence[HasDbh],
    extracted: Sequence[HasDbh],
    *,
    max_distance_m: float = MAX_DISTANCE_M,
    by_id: bool = False,
    align: str = Align.auto.value,
    area_margin_m: float | None = None,
) -> Evaluation:
    """Compare ``extracted`` trees with ``measured`` ones, one to one.

    ``align``: "auto" registers the frames when they match fewer than half of the trees as given and registration finds
    clearly more; "never" and "always" decide it. ``area_margin_m``: where given, the measured area is the convex
    hull of the measured trees grown by this much, and an unmatched tree beyond it is ``outside``, not ``false``. Raises
    :class:`~fsinfer.errors.InputError` for unusable input.
    """
    if align not in ALIGNMENTS:
        msg = f"align must be one of {', '.join(ALIGNMENTS)}, got {align!r}"
        raise InputError(msg)
    if not (np.isfinite(max_distance_m) and max_distance_m > 0):
        msg = f"the maximum distance must be a positive number of metres, got {max_distance_m}"
        raise InputError(msg)
    if not measured:
        msg = "no measured trees: the file of measured trees holds only a header; give at least one tree"
        raise InputError(msg)
    if any(tree.dbh_cm is None for tree in measured):
        msg = "a measured tree has no DBH; leave it out or give its diameter"
        raise InputError(msg)
    motion: dict[str, float] | None = None
    distances: list[float | None]
    if by_id:
        links = _links_by_id(measured, extracted)
        distances = [None] * len(links)
    else:
        truth, found = _positions(measured, "measured"), _positions(extracted, "extracted")
        links, moved = assign(truth, found, max_distance_m), found
        if align == Align.always or (align == Align.auto and len(links) < _FEW_MATCHES * min(len(truth), len(found))):
            registered = register(truth, found, max_distance_m)
            if registered is not None:
                candidate = apply(registered, found)
                better = assign(truth, candidate, max_distance_m)
                clearly = len(better) >= max(len(links) + _MORE_MATCHES, _LEAST_MATCHES, _MORE_TIMES * len(links))
                if align == Align.always or clearly:
                    links, moved = better, candidate
                    motion = {
                        "rotation_deg": float(np.degrees(registered[0])),
                        "shift_x_m": float(registered[1]),
                        "shift_y_m": float(registered[2]),
                    }
        distances = [float(np.linalg.norm(truth[i] - moved[j])) for i, j in links]
    pairs = tuple(
        Pair(
            measured_id=str(measured[i].tree_id),
            extracted_id=str(extracted[j].tree_id),
            measured_cm=float(measured[i].dbh_cm or 0.0),
            extracted_cm=extracted[j].dbh_cm,
            distance_m=distance,
        )
        for (i, j), distance in zip(links, distances, strict=True)
    )
    _refuse_other_units(pairs)
    partners = {j for _, j in links}
    lonely = [j for j in range(len(extracted)) if j not in partners]
    outside = np.array([getattr(extracted[j], "status", "") == _OUTSIDE for j in lonely], dtype=bool)
    if area_margin_m is not None and not by_id:
        outside |= ~in_hull(truth, moved[lonely], area_margin_m)
    return _metrics(len(measured), len(extracted), int(outside.sum()), pairs, motion)


def _metrics(
    n: int, extracted: int, outside: int, pairs: tuple[Pair, ...], motion: dict[str, float] | None
) -> Evaluation:
    both = [(p.measured_cm, p.extracted_cm) for p in pairs if p.extracted_cm is not None]
    rmse = rrmse = bias = mae = None
    if both:
        truth = np.array([b[0] for b in both])
        difference = np.array([b[1] for b in both]) - truth
        rmse = float(np.sqrt(np.mean(difference**2)))
        rrmse = rmse / float(truth.mean())
        bias, mae = float(difference.mean()), float(np.abs(difference).mean())
    return Evaluation(
        n=n,
        extracted=extracted,
        detected=len(pairs),
        matched=len(both),
        omitted=n - len(pairs),
        false=extracted - len(pairs) - outside,
        outside=outside,
        r=len(both) / n,
        rmse_cm=rmse,
        rrmse=rrmse,
        ae=None if rrmse is None else 1.0 - rrmse,
        bias_cm=bias,
        mae_cm=mae,
        measured_from_extracted=motion,
        pairs=pairs,
    )


def _positions(trees: Sequence[HasDbh], which: str) -> Floats:
    xy = np.array([[tree.x_m, tree.y_m] for tree in trees], dtype=np.float64).reshape(-1, 2)
    if not np.isfinite(xy).all():
        bad = trees[int(np.argmin(np.isfinite(xy).all(axis=1)))].tree_id
        msg = f"{which} tree {bad} has no position; give x_m and y_m, or match by id"
        raise InputError(msg)
    return xy


def _links_by_id(measured: Sequence[HasDbh], extracted: Sequence[HasDbh]) -> list[tuple[int, int]]:
    place = {str(tree.tree_id): j for j, tree in enumerate(extracted)}
    ids = [str(tree.tree_id) for tree in measured]
    if len(place) != len(extracted) or len(set(ids)) != len(ids):
        msg = "a tree_id occurs twice; matching by id needs every tree_id once in each file"
        raise InputError(msg)
    return [(i, place[name]) for i, name in enumerate(ids) if name in place]

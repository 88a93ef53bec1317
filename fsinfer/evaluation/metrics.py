"""How good the extracted diameters are, against a caliper or tape: the metrics of the field, reported together.

Accuracy without completeness misleads, so both are always given. With ``n_measured`` trees on the ground:

- *detected*: measured trees that have an extracted stem at their place;
- *matched*: detected trees whose extracted stem has a DBH. A stem found but not measured counts as detected only;
- ``r`` = matched / n_measured (the paper's completeness), *omitted* = n_measured - detected, *false* = extracted
  stems that no measured tree explains (with or without a DBH). Photographs also see trees beyond the plot, where nobody
  measured: those that the table itself calls ``outside`` of the walk, or has outside of the plot's border, and with an
  area margin those beyond it, are *outside* and not judged;
- over the matched: bias = mean(extracted - measured), MAE, RMSE = sqrt(mean(difference^2)),
  rRMSE = RMSE / mean measured DBH of the matched, AE = 1 - rRMSE (FS-MVSNet, Forests 2025, 16, 927). Omitted trees have
  no error: these are figures of the matched, not of all trees, and are shown as such.

Where the two lists have different local frames, a rigid motion of the plane (rotation and shift, never a scale) is
found from pairs of trees at equal distances, and used only when it explains clearly more trees, and more than it would
of the mirror image (:mod:`fsinfer.evaluation.alignment`). Trees are never matched by their diameters, which are what is
judged.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import InputError
from fsinfer.evaluation.alignment import AlignmentDoubt, align_maps, doubt_of_numbers
from fsinfer.evaluation.settings import MAX_DISTANCE_M, Align
from fsinfer.evaluation.units import refuse_other_units
from fsinfer.geometry.hull import in_hull

Floats = NDArray[np.float64]
ALIGNMENTS = tuple(align.value for align in Align)

#: Status of a stem outside of the walk. Source: format; ``trees.csv``.
_OUTSIDE = "outside"
#: A whole number, as tables of trees have it. Source: format; ASCII digits, a fraction of zeros.
_WHOLE = re.compile(r"[0-9]+([.,]0+)?")


class HasDbh(Protocol):
    """What :func:`evaluate` needs of a tree.

    :class:`fsinfer.evaluation.measured.MeasuredTree` and :class:`fsinfer.trees.Tree` have it, and a ``status`` besides,
    which says what stands outside of the walk, ``in_plot``, and the interval of the diameter.
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
class Pair:
    """A measured tree and the stem found for it; ``distance_m`` is after alignment, None when matched by id."""

    measured_id: str
    extracted_id: str
    measured_cm: float
    extracted_cm: float | None
    distance_m: float | None
    extracted_lo95_cm: float | None = None
    extracted_hi95_cm: float | None = None

    @property
    def in_interval(self) -> bool | None:
        """Whether the measured diameter lies in the extracted interval; None where there is none."""
        if self.extracted_cm is None or self.extracted_lo95_cm is None or self.extracted_hi95_cm is None:
            return None
        return self.extracted_lo95_cm <= self.measured_cm <= self.extracted_hi95_cm


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The metrics of :mod:`fsinfer.evaluation.metrics`; those of accuracy are None when nothing matched.

    ``false`` counts extracted trees without a partner, but not those that have the status ``outside`` or stand outside
    of the plot's border; with an area margin only those inside the measured area. ``outside`` counts those others:
    nobody measured there, and nothing can be said.

    ``without_dbh`` counts measured trees whose DBH nobody gave, which are none of ``n``: a stem at such a place is no
    false one. Of the matched ``with_interval`` have an interval, and ``in_interval`` lie in theirs.

    ``alignment_doubt`` is ``chance`` where the frames differ and no motion lays more trees on each other than on the
    mirror image, and ``mirrored`` where that fits far better: then "auto" compares the positions as given. It is
    ``symmetric`` where a motion was used and the mirror image fits as well, and ``other_numbers`` where trees were
    matched by their numbers and their places are not those of the same trees.

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
    without_dbh: int = 0
    alignment_doubt: str = AlignmentDoubt.none.value
    with_interval: int = 0
    in_interval: int = 0

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, for JSON."""
        return asdict(self)


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
    clearly more, and of a ``max_distance_m`` above the usual one also when it finds as many that lie clearly nearer;
    "never" and "always" decide it. ``area_margin_m``: where given, the measured area is the convex
    hull of the measured trees grown by this much, and an unmatched tree beyond it is ``outside``, not ``false``. Raises
    :class:`~fsinfer.errors.InputError` for unusable input.
    """
    if align not in ALIGNMENTS:
        msg = f"align must be one of {', '.join(ALIGNMENTS)}, got {align!r}"
        raise InputError(msg)
    if not (np.isfinite(max_distance_m) and max_distance_m > 0):
        msg = f"the maximum distance must be a positive number of metres, got {max_distance_m}"
        raise InputError(msg)
    if area_margin_m is not None and not (np.isfinite(area_margin_m) and area_margin_m >= 0):
        msg = f"the area margin must be a number of metres, 0 or more, got {area_margin_m}"
        raise InputError(msg)
    if not measured:
        msg = "no measured trees: the file of measured trees holds only a header; give at least one tree"
        raise InputError(msg)
    if all(tree.dbh_cm is None for tree in measured):
        msg = "no measured tree has a DBH; give the diameter of at least one"
        raise InputError(msg)
    motion, doubt = None, AlignmentDoubt.none
    distances: list[float | None]
    if by_id:
        links = _links_by_id(measured, extracted)
        distances = [None] * len(links)
        there, here = _places([measured[i] for i, _ in links]), _places([extracted[j] for _, j in links])
        doubt = doubt_of_numbers(there, here, max_distance_m)
    else:
        truth, found = _positions(measured, "measured"), _positions(extracted, "extracted")
        aligned = align_maps(truth, found, max_distance_m, align)
        links, moved = aligned.links, aligned.moved
        motion, doubt = aligned.motion, aligned.doubt
        distances = [float(np.linalg.norm(truth[i] - moved[j])) for i, j in links]
    pairs = tuple(
        Pair(
            measured_id=str(measured[i].tree_id),
            extracted_id=str(extracted[j].tree_id),
            measured_cm=dbh,
            extracted_cm=extracted[j].dbh_cm,
            distance_m=distance,
            extracted_lo95_cm=getattr(extracted[j], "dbh_lo95_cm", None),
            extracted_hi95_cm=getattr(extracted[j], "dbh_hi95_cm", None),
        )
        for (i, j), distance in zip(links, distances, strict=True)
        if (dbh := measured[i].dbh_cm) is not None
    )
    judged = [pair for pair in pairs if pair.extracted_cm is not None]
    refuse_other_units([pair.measured_cm for pair in judged], [pair.extracted_cm or 0.0 for pair in judged])
    partners = {j for _, j in links}
    lonely = [j for j in range(len(extracted)) if j not in partners]
    outside = np.array([_not_judged(extracted[j]) for j in lonely], dtype=bool)
    if area_margin_m is not None and not by_id:
        outside |= ~in_hull(truth, moved[lonely], area_margin_m)
    return _metrics(
        sum(tree.dbh_cm is not None for tree in measured),
        len(extracted),
        false=len(lonely) - int(outside.sum()),
        outside=int(outside.sum()),
        pairs=pairs,
        motion=motion,
        without_dbh=sum(tree.dbh_cm is None for tree in measured),
        doubt=doubt,
    )


def _metrics(
    n: int,
    extracted: int,
    *,
    false: int,
    outside: int,
    pairs: tuple[Pair, ...],
    motion: dict[str, float] | None,
    without_dbh: int,
    doubt: AlignmentDoubt,
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
        false=false,
        outside=outside,
        r=len(both) / n,
        rmse_cm=rmse,
        rrmse=rrmse,
        ae=None if rrmse is None else 1.0 - rrmse,
        bias_cm=bias,
        mae_cm=mae,
        measured_from_extracted=motion,
        pairs=pairs,
        without_dbh=without_dbh,
        alignment_doubt=doubt.value,
        with_interval=sum(pair.in_interval is not None for pair in pairs),
        in_interval=sum(pair.in_interval is True for pair in pairs),
    )


def _not_judged(tree: HasDbh) -> bool:
    """Whether its own table says that it stands where nobody measured: outside of the walk, or of the plot's border."""
    return getattr(tree, "status", "") == _OUTSIDE or getattr(tree, "in_plot", None) is False


def _places(trees: Sequence[HasDbh]) -> Floats:
    """Positions (N, 2), NaN where there is none."""
    return np.array([[tree.x_m, tree.y_m] for tree in trees], dtype=np.float64).reshape(-1, 2)


def _positions(trees: Sequence[HasDbh], which: str) -> Floats:
    xy = _places(trees)
    if not np.isfinite(xy).all():
        bad = trees[int(np.argmin(np.isfinite(xy).all(axis=1)))].tree_id
        msg = f"{which} tree {bad} has no position; give x_m and y_m, or match by id"
        raise InputError(msg)
    return xy


def _links_by_id(measured: Sequence[HasDbh], extracted: Sequence[HasDbh]) -> list[tuple[int, int]]:
    ids, others = ([str(tree.tree_id) for tree in trees] for trees in (measured, extracted))
    if len(set(others)) != len(others) or len(set(ids)) != len(ids):
        msg = "a tree_id occurs twice; matching by id needs every tree_id once in each file"
        raise InputError(msg)
    ids, others = _as_numbers(ids), _as_numbers(others)
    place = {name: j for j, name in enumerate(others)}
    return [(i, place[name]) for i, name in enumerate(ids) if name in place]


def _as_numbers(names: list[str]) -> list[str]:
    """Names that are whole numbers as these are written: a field sheet has 07, a spreadsheet 7.0.

    As they are where two of them would become one.
    """
    plain = [str(int(re.split("[.,]", name)[0])) if _WHOLE.fullmatch(name) else name for name in names]
    return plain if len(set(plain)) == len(plain) else names

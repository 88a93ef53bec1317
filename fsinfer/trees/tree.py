"""One tree of the plot: a row of ``trees.csv``."""

from __future__ import annotations

from dataclasses import dataclass

from fsinfer.notices.notice import Notice
from fsinfer.notices.sentences import joined
from fsinfer.notices.stems import StemCode

#: The status of a stem outside of the walk that was not measured.
OUTSIDE = "outside"


@dataclass(frozen=True, kw_only=True)
class Tree:
    """One row of ``trees.csv``.

    ``x_m, y_m`` is the stem's centre at ``bh_m`` above ``z_ground_m``, in the frame of the cloud. ``z_ground_m`` is the
    one level that all heights of the tree are counted from: the ground at the middle of its foot, or the highest
    ground round that (:class:`~fsinfer.conventions.breast_height.BhRule`), which on a slope is not the ground below a
    leaning stem's centre. ``dbh_cm`` and its 95 % interval come from the circle; ``dbh_perimeter_cm`` is what a
    diameter tape reads (girth / pi) and ``dbh_min_cm``, ``dbh_max_cm`` what callipers read, where the stem was seen
    nearly all round. ``arc_coverage`` in [0, 1]; ``points`` are those the circle used; ``residual_cm`` is the noise of
    the bark about the model, by the sharper points where a cloud tells which those are. None means "not measured", and
    ``reasons`` say why. ``status`` is ok, doubtful, unmeasured, or outside: too far from where the photographs were
    taken, listed apart and not measured.

    Where the plot has a border (:mod:`fsinfer.plot_border`), ``in_plot`` says whether the centre is within it,
    ``border_m`` how far from it, negative outside, and ``at_border`` whether that is less than the stem's radius or
    than the error of its place.

    ``part`` names the folder of the part of the walk that measured the stem, None for the walk's main part: its figures
    and points are there (:mod:`fsinfer.trees.pattern.join`).
    """

    tree_id: int
    x_m: float
    y_m: float
    z_ground_m: float
    dbh_cm: float | None
    dbh_lo95_cm: float | None
    dbh_hi95_cm: float | None
    dbh_perimeter_cm: float | None
    dbh_min_cm: float | None
    dbh_max_cm: float | None
    bh_m: float
    arc_coverage: float
    points: int
    residual_cm: float | None
    lean_deg: float
    height_m: float | None
    status: str
    reasons: tuple[Notice, ...]
    in_plot: bool | None = None
    border_m: float | None = None
    at_border: bool | None = None
    part: str | None = None

    @property
    def outside(self) -> bool:
        """Whether it stands outside of the walk, measured or not: then it does not count in the stand."""
        return any(why.code == StemCode.outside_walk for why in self.reasons)

    @property
    def half95_cm(self) -> float:
        """Half the width of the 95 % interval, infinite where there is none."""
        lo, hi = self.dbh_lo95_cm, self.dbh_hi95_cm
        return float("inf") if lo is None or hi is None else (hi - lo) / 2.0

    @property
    def radius_m(self) -> float:
        """At breast height, 0 where there is no DBH."""
        return 0.0 if self.dbh_cm is None else self.dbh_cm / 200.0

    @property
    def reason(self) -> str:
        """The reasons in words, with semicolons between; empty where there is none."""
        return joined(self.reasons)

"""What the measurement of one stem at breast height gave, or why it gave nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.notices.notice import Notice
from fsinfer.trees.cylinder.axis import Axis
from fsinfer.trees.diameter.budget import factor95
from fsinfer.trees.diameter.outline import Outline
from fsinfer.trees.diameter.roundness import Roundness
from fsinfer.trees.diameter.silhouette import SilhouetteFit

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Section:
    """What one stem's breast-height section gave; lengths in metres, angles in degrees.

    ``offsets_m`` (M, 2) are the slice's points about ``center`` in the plane perpendicular to the axis, without the
    taper and as far from round as the stem is, ``kept`` (M,) those the circle used, ``circle_m`` (x, y, radius) the
    fused circle in the same plane. ``dbh_m`` is at breast height: ``by_taper_m`` was added to the radius measured at
    ``bh_m`` where the stem is not seen there. ``center`` (2,) is the axis position at ``bh_m`` above the level that the
    stem's heights count from (``Tree.z_ground_m``), in the frame of the cloud, ``slope`` (2,) its dx/dh and dy/dh,
    ``taper`` the radius's dr/dh, ``top_m`` the height to which the stem was seen (below the search's upper end).
    ``parts_m`` are the standard deviations of the radius that make up the interval, by name, ``dof`` their degrees of
    freedom together (:mod:`fsinfer.trees.diameter.budget`), ``tau_m`` the error that neighbouring points share. Of
    ``sd_m``, that of the diameter, ``shared_sd_m`` is the part with one cause in all stems of a plot, without that of
    the scale. ``dbh_m`` is None when ``reasons`` say why there is none. Where photographs were looked at too
    (:mod:`fsinfer.silhouettes.join`), ``silhouette`` is what their edges say and ``cloud_dbh_m`` what the points alone
    gave. ``roundness`` is how far from round the points have it, None where no fit holds.
    """

    center: Floats
    bh_m: float
    dbh_m: float | None
    sd_m: float
    coverage: float
    points: int
    residual_m: float
    parts_m: dict[str, float]
    tau_m: float
    lean_deg: float
    slope: Floats
    taper: float
    top_m: float
    status: str
    reasons: tuple[Notice, ...]
    offsets_m: Floats
    kept: Bools
    circle_m: Floats
    half_slice_m: float
    outline: Outline | None
    silhouette: SilhouetteFit | None = None
    cloud_dbh_m: float | None = None
    dof: float = float("inf")
    shared_sd_m: float = 0.0
    by_taper_m: float = 0.0
    roundness: Roundness | None = None

    @property
    def half95_m(self) -> float:
        """Half the width of the 95 % interval of the diameter."""
        return factor95(self.dof) * self.sd_m


def unmeasured_section(
    center: Floats,
    bh_m: float,
    reasons: tuple[Notice, ...],
    *,
    radius_m: float,
    lean_deg: float = 0.0,
    slope: Floats | None = None,
    taper: float = 0.0,
    top_m: float | None = None,
    offsets_m: Floats | None = None,
    half_slice_m: float = 0.0,
) -> Section:
    """A stem at ``center`` (2,) without a diameter; ``radius_m`` only says how large to draw it on a map.

    ``offsets_m`` (M, 2) are what points there are within ``half_slice_m`` of breast height, to be looked at.
    """
    offsets = np.zeros((0, 2)) if offsets_m is None else offsets_m
    return Section(
        center=center,
        bh_m=bh_m,
        dbh_m=None,
        sd_m=float("nan"),
        coverage=0.0,
        points=0,
        residual_m=float("nan"),
        parts_m={},
        tau_m=float("nan"),
        lean_deg=lean_deg,
        slope=np.zeros(2) if slope is None else slope,
        taper=taper,
        top_m=bh_m if top_m is None else top_m,
        status="unmeasured",
        reasons=reasons,
        offsets_m=offsets,
        kept=np.zeros(len(offsets), dtype=bool),
        circle_m=np.array([0.0, 0.0, radius_m]),
        half_slice_m=half_slice_m,
        outline=None,
    )


def as_searched(section: Section, axis: Axis) -> Section:
    """A section without a DBH, about the ``axis`` that the search had found.

    A fit that has left what was searched for has its centre and radius anywhere; photographs are to be asked for the
    stem where the search saw it.
    """
    center = axis.center_at(section.bh_m)
    return replace(
        section,
        center=center,
        slope=axis.parameters[2:4],
        taper=float(axis.parameters[5]),
        lean_deg=axis.lean_deg,
        circle_m=np.array([0.0, 0.0, axis.radius_at(section.bh_m)]),
        offsets_m=section.offsets_m + (section.center - center),
    )

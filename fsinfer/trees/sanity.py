"""Clouds that cannot be measured as they are: too few points, lost digits, a wrong unit, a wrong way up."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fsinfer.errors import CloudError
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.trees.ground.ground import Ground, find_ground, reach_of
from fsinfer.trees.ground.settings import GroundSettings

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
_log = logging.getLogger(__name__)


#: Every k-th point so that so many are left tells the percentiles of a plot's extent to a centimetre, and as many
#: coordinates the step in which they come. Source: numerics.
BOX_POINTS, STEP_POINTS = 200_000, 20_000
#: Between them on each axis lies the middle of a plot: trees that are seen from afar, without their ground, widen the
#: whole severalfold. Source: an open wood, rendered, whose box was ten times the walk's.
MIDDLE_PERCENTILES = (10.0, 90.0)
#: Points that are enough to find stems, few enough for a second a side. Source: numerics.
TURNED_POINTS = 300_000


@dataclass(frozen=True, kw_only=True)
class SanitySettings:
    """Limits beyond which a cloud is doubted or refused.

    Attributes
    ----------
    min_points: of a cloud. Source: not recorded.
    warn_step_m: single precision beyond 40 km: as coarse as a photogrammetric cloud's noise. Source: arithmetic.
    coarse_step_m: beyond 300 km, as in map coordinates: no circle is left. Source: arithmetic.
    extent_m: a slice of one stem; the widest plot, which is 50 hectares. Source: not recorded.
    head_ground: a plot whose ground is under less of it than this may be lying on its head. Source: not recorded.
    head_gain: it does where the other way up more than so many times that can be ground. Source: not recorded.
    min_ground: share of the lowest parts that show ground: less is said. Source: not recorded.
    little_ground: of the middle of the plot in plan: less is said. Source: not recorded.
    far_apart_m: distance of neighbouring points at stem height from which on stems are missed: more is said. Source:
        three simulated scans of 72 stems thinned to 1 to 30 %; one of 166 is missed at 1 to 2.6 cm, 7 of 72 at 3.3 to
        3.7 cm, 24 of 72 at 4 to 5 cm.
    turned_trees: measured beyond doubt, to turn a cloud: one may be chance. Source: not recorded.
    max_turned_cm: corners of a building measure as thicker trees. Source: not recorded.
    thinner_share: of the stems that grow thinner upwards, in a cloud that is not on its head. Source:
        :func:`thin_upwards`.
    thicker_trees, thicker_share: of at least so many stems at most this share grows thinner upwards, where a cloud may
        be on its head. Source: judgement.
    thick_trees, thick_cm: of so many stems beyond doubt or more half are thicker than this: more is said. Source:
        judgement; stems of 21 cm measured in feet; stands whose median stem is as thick are old reserves.
    turned_ground: times more ground seen than the other way round, where both ways show stems. Source: not recorded.
    """

    min_points: int = 100
    warn_step_m: float = 0.005
    coarse_step_m: float = 0.03
    extent_m: tuple[float, float] = (0.3, 700.0)
    head_ground: float = 0.5
    head_gain: float = 2.0
    min_ground: float = 0.6
    little_ground: float = 0.33
    far_apart_m: float = 0.032
    turned_trees: int = 2
    max_turned_cm: float = 100.0
    thinner_share: float = 0.7
    thicker_trees: int = 4
    thicker_share: float = 0.2
    thick_trees: int = 5
    thick_cm: float = 70.0
    turned_ground: float = 1.5


#: Ways a cloud may lie: rotation matrices that turn it z up, with the words for the user.
#: Source: format; the quarter turns.
TURNS: tuple[tuple[str, Floats], ...] = (
    ("y points up", np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])),
    ("y points down", np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])),
    ("x points up", np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])),
    ("x points down", np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])),
    ("z points down", np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])),
)


def turned_message(how: str) -> str:
    """What to tell the user of a cloud in which ``how`` (see ``TURNS``)."""
    return f"the cloud does not stand upright: {how} in it; turn it so that z points up, and measure it again"


class TurnedCloudError(CloudError):
    """The cloud does not stand upright, and ``turn`` (3, 3) would set it up; ``how`` says which way it lies."""

    def __init__(self, how: str, turn: Floats) -> None:
        super().__init__(turned_message(how))
        self.how, self.turn = how, turn

    @property
    def warning(self) -> Notice:
        """What to say where the cloud was turned for the user."""
        return notice(StemCode.turned, how=self.how)


def may_be_upside_down(
    points: Floats, ground: Ground, settings: GroundSettings, sanity: SanitySettings, *, seed: int = 0
) -> bool:
    """Whether the points (N, 3) show much more ground with the cloud turned on its head.

    So does an upright cloud whose ground is thin, and which was cut off level in the crowns: see :func:`thin_upwards`.
    """
    if ground.reach >= sanity.head_ground:
        return False
    turned = points[:: max(len(points) // TURNED_POINTS, 1)] * [1.0, -1.0, -1.0]
    if reach_of(turned, settings=settings) <= sanity.head_gain * ground.reach:
        return False
    try:
        find_ground(turned, settings=settings, seed=seed)
    except CloudError:
        return False
    return True


def thin_upwards(tapers: Sequence[float], sanity: SanitySettings) -> bool:
    """Whether stems with these tapers (dr/dh) stand on their feet: enough of them, and nearly all grow thinner upwards.

    Of two scans of pines cut at 5 and 8 m 79 to 94 % do, and 31 to 50 % where they are turned on their head.
    """
    thinner = sum(taper < 0.0 for taper in tapers)
    return len(tapers) >= sanity.turned_trees and thinner >= sanity.thinner_share * len(tapers)


def thicker_upwards(tapers: Sequence[float], sanity: SanitySettings) -> bool:
    """Whether so many stems with these tapers (dr/dh) grow thicker upwards that the cloud may be on its head."""
    thinner = sum(taper < 0.0 for taper in tapers)
    return len(tapers) >= sanity.thicker_trees and thinner <= sanity.thicker_share * len(tapers)


def all_thick(dbh_cm: Sequence[float], sanity: SanitySettings) -> tuple[Notice, ...]:
    """What to say where stems of these diameters, beyond doubt, are so thick that the unit may be another; or nothing.

    Only the size of what is known tells a unit: in feet a stand is as dense and as slender as in metres.
    """
    if len(dbh_cm) < sanity.thick_trees or (middle := float(np.median(dbh_cm))) <= sanity.thick_cm:
        return ()
    return (notice(StemCode.all_thick, stems=len(dbh_cm), dbh_cm=middle),)


def coordinate_step(xyz: Floats) -> float:
    """Smallest step between different x or y coordinates of a sample of points (N, 3): the resolution of storage."""
    sample = xyz[:: max(len(xyz) // STEP_POINTS, 1), :2]
    steps = [np.diff(np.unique(sample[:, axis])) for axis in (0, 1)]
    return max((float(step.min()) for step in steps if len(step)), default=0.0)


def as_numbers(points: ArrayLike) -> Floats:
    """The points as float64, NaN where masked; :class:`~fsinfer.errors.CloudError` where they are no numbers."""
    try:
        if isinstance(points, np.ma.MaskedArray):
            return np.asarray(np.ma.filled(points.astype(np.float64), np.nan))
        return np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        msg = f"the cloud must be an array of numbers of shape (N, 3), got {type(points).__name__}: {error}"
        raise CloudError(msg) from error


def finite_points(xyz: Floats) -> Bools:
    """Which of points (N, 3) have three coordinates: those that :func:`clean` keeps."""
    # A sum is finite only where all three are (coordinates near the largest double are none).
    with np.errstate(over="ignore"):
        return np.asarray(np.isfinite(xyz[:, 0] + xyz[:, 1] + xyz[:, 2]))


def clean(points: ArrayLike, sanity: SanitySettings) -> tuple[Floats, list[Notice]]:
    """Finite points (N, 3) float64 with warnings; raises where too few are left or their steps are too coarse."""
    xyz = as_numbers(points)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        msg = f"the cloud must be an array of shape (N, 3), got {xyz.shape=}"
        raise CloudError(msg)
    finite = finite_points(xyz)
    warnings = []
    if not finite.all():
        warnings.append(notice(StemCode.not_finite, points=int((~finite).sum())))
        _log.warning(sentence(warnings[-1]))
        xyz = xyz[finite]
    if len(xyz) < sanity.min_points:
        msg = f"the cloud holds only {len(xyz)} usable points; a plot needs thousands: check the file and the fusion"
        raise CloudError(msg)
    step = coordinate_step(xyz)
    if step >= sanity.coarse_step_m:
        msg = f"the coordinates come in steps of {100 * step:.0f} cm, as if they were metres: {_why_coarse(step)}"
        raise CloudError(msg)
    if step >= sanity.warn_step_m:
        warnings.append(notice(StemCode.coarse_steps, step_mm=1000.0 * step))
    return xyz, warnings


def _why_coarse(step_m: float) -> str:
    """What coordinates in such steps are, and the way out: steps of single precision are powers of two."""
    if any(np.isclose(step_m, unit, rtol=1e-3) for unit in (0.1, 1.0, 10.0)):
        return (
            "are they millimetres or centimetres? Give the scale (--scale 0.001 or 0.01), or export the cloud with "
            "more decimals"
        )
    if np.isclose(np.frexp(step_m)[0], 0.5, rtol=1e-3):
        return (
            "the cloud was stored in single precision far from its origin; export it as LAS/LAZ or with double "
            "coordinates, or shift it to a local origin first"
        )
    return (
        "the cloud was thinned to a grid (voxels) of that width, or stored with too few digits; give it as it was "
        "before, or thinned to 1 cm at most, or export it as LAS/LAZ or with double coordinates"
    )


def check_unit(extent: Floats, sanity: SanitySettings) -> None:
    """Raise where the box (2, 2) of a plot cannot be in metres."""
    size = float(np.max(extent[1] - extent[0]))
    if size < sanity.extent_m[0]:
        msg = f"the cloud is only {100 * size:.1f} cm wide: it is not in metres; give the scale (--scale, --endpoints)"
        raise CloudError(msg)
    if size > sanity.extent_m[1]:
        msg = (
            f"the cloud is {size:.0f} m wide: is it in centimetres or millimetres? Give the scale "
            f"(--scale 0.01 or 0.001), or cut the cloud into plots below {sanity.extent_m[1]:.0f} m"
        )
        raise CloudError(msg)

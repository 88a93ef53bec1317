"""Whether a fit is a diameter: why there is none, or why it is doubtful."""

from __future__ import annotations

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.cylinder.axis import AxisFit
from fsinfer.trees.diameter.circle import LEAST_POINTS
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.double_wall import TwoWalls


def may_be_measured(walls: TwoWalls, s: DbhSettings) -> bool:
    """Whether two walls leave the stem a diameter, if a doubtful one."""
    return walls.shifted and 0.0 < walls.gap_m <= s.most_walls_m


def walls_std_m(walls: TwoWalls, radius_m: float, s: DbhSettings) -> float:
    """Standard deviation of the radius, metres, by two walls."""
    whole = walls.whole and walls.gap_m <= s.whole_walls * 2.0 * radius_m
    return 0.5 * walls.gap_m * s.walls_std[1 if whole else 0]


def refused(
    fit: AxisFit, coverage: float, dbh_m: float, half_m: float, walls: TwoWalls, count: int, s: DbhSettings
) -> tuple[Notice, ...]:
    """Why there is no diameter; empty where there is one."""
    if count < LEAST_POINTS:
        return (notice(StemCode.too_few_on_bark, points=count),)
    if coverage < s.min_coverage:
        return (notice(StemCode.too_little_seen, seen_deg=360.0 * coverage),)
    if walls.gap_m > 0.0 and not may_be_measured(walls, s):
        return (notice(StemCode.double_wall, gap_cm=100.0 * walls.gap_m),)
    most = s.blurred_sigma_m if coverage >= s.blurred_coverage else s.max_sigma_m
    if fit.sigma_m > min(most, 0.5 * s.max_sigma_of_radius * dbh_m):
        return (notice(StemCode.too_rough, residual_cm=100.0 * fit.sigma_m),)
    return too_uncertain(dbh_m, half_m, s)


def too_uncertain(dbh_m: float, half_m: float, s: DbhSettings) -> tuple[Notice, ...]:
    """Why a diameter is no measurement, ``half_m`` being half of its interval; both metres. Empty where it is one."""
    if 2 * half_m > s.max_interval * dbh_m:
        return (notice(StemCode.too_uncertain, dbh_cm=100.0 * dbh_m, half_width_cm=100.0 * half_m),)
    return ()


def wide_interval(dbh_m: float, half_m: float, s: DbhSettings) -> tuple[Notice, ...]:
    """The doubt about a diameter, ``half_m`` being half of its interval, both metres, if there is one."""
    if 2 * half_m > s.doubtful_interval * dbh_m:
        return (notice(StemCode.wide_interval, half_width_cm=100.0 * half_m),)
    return ()


def ground_doubt(level_std_m: float, s: DbhSettings) -> tuple[Notice, ...]:
    """The doubt about where breast height is, if there is one: of a stem without a diameter, too.

    Its edges in photographs may give it one, and they do not know the ground.
    """
    if level_std_m > s.doubtful_level_m:
        return (notice(StemCode.ground_unsure, std_cm=100.0 * level_std_m),)
    return ()


def doubts_about(
    fit: AxisFit,
    coverage: float,
    dbh_m: float,
    half_m: float,
    walls: TwoWalls,
    shift: float,
    level_std_m: float,
    s: DbhSettings,
) -> tuple[Notice, ...]:
    """What is doubtful about a diameter; ``shift`` is how far from breast height it was measured, metres."""
    doubts = []
    if walls.gap_m > 0.0:
        doubts.append(notice(StemCode.double_wall, gap_cm=100.0 * walls.gap_m))
    if fit.sigma_m > s.max_sigma_m:
        doubts.append(notice(StemCode.blurred_points, residual_cm=100.0 * fit.sigma_m))
    doubts += ground_doubt(level_std_m, s)
    if shift > s.max_off_m:
        doubts.append(notice(StemCode.above_breast_height, off_cm=100.0 * shift))
    elif shift < -s.max_off_m:
        doubts.append(notice(StemCode.below_breast_height, off_cm=-100.0 * shift))
    if coverage < s.doubtful_coverage:
        doubts.append(notice(StemCode.little_seen, seen_deg=360.0 * coverage))
    return (*doubts, *wide_interval(dbh_m, half_m, s))

"""What else has the size of a stem that the cloud refused: edges alone are no measurement.

A second pair of its sides by itself (:mod:`fsinfer.trees.diameter.second_pair`), or what the points say of it in spite
of all. Two half supports are one: a second pair that looks from almost as far apart as it should, and points that are
almost sure enough. A strip of bark would have to be both a stem's size for the points and as wide from the other side.

Edges of leaves beside a thin stem agree as well as a stem's where the vote allows centimetres, and so may both parts of
them. But they are ragged: they lie about the lines that were found by far more than a pixel, and a stem's do not. Such
edges need the points.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fsinfer.notices.notice import Notice
from fsinfer.notices.stems import StemCode
from fsinfer.silhouettes.combine import CombineSettings
from fsinfer.silhouettes.one_look import Looked
from fsinfer.trees import Section
from fsinfer.trees.diameter.second_pair import SecondPairSettings, second_pair
from fsinfer.trees.diameter.silhouette import SilhouetteFit
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings

#: Said of a stem beside its reasons.
BY_HAND = frozenset({StemCode.added_by_hand, StemCode.merged_by_hand})
#: Where the cloud refused for one of these its radius means nothing.
SIZELESS = frozenset(
    {
        StemCode.too_few_at_breast_height,
        StemCode.too_few_on_bark,
        StemCode.double_wall,
        StemCode.not_round,
        StemCode.no_stem_here,
    }
)


@dataclass(frozen=True, kw_only=True)
class SupportSettings:
    """Constants of :func:`is_supported`.

    Attributes
    ----------
    points_std: the points of a stem that the cloud refused support its edges where their own standard deviation is
        below this share of the radius and the two agree. Source: statistics and renders only: at 0.1 the edges of four
        stems of four plots were refused, all four within 0.8 cm; at 0.2 the points still rule out half the size.
    half_points_std: the same beside a second pair of sides that looks from almost as far apart as it should. Source:
        statistics, they rule out twice the size; renders only: of 24 stems of seven plots whose points were refused
        one more has a diameter, 9.2 cm for 9.2.
    least_rays: share of the rays that must agree on the edges, or nothing supports them. Source: renders only: of eight
        stems of five walks measured by their edges alone 0.85 to 0.97 do; of a shrub of the demo, "81 cm", 0.77 did.
    most_scatter: edges that lie about their fit by more than this share of its radius, beside what pixels and
        photographs are off by, may be those of leaves. Source: renders only, nine plots by two renderers, afterwards:
        185 trees of 8 cm and more whose size their edges have right have 0.05 at most, 181 of them the least there is;
        leaves that made 8 to 10 cm of three saplings of 2 to 3 cm have 0.16 to 0.35.
    second: of a second pair of sides.
    """

    points_std: float = 0.2
    half_points_std: float = 0.3
    least_rays: float = 0.8
    most_scatter: float = 0.1
    second: SecondPairSettings = field(default_factory=SecondPairSettings)


def is_supported(
    section: Section,
    points_std_m: float,
    looked: Looked,
    fit: SilhouetteFit,
    *,
    silhouette: SilhouetteSettings,
    settings: SupportSettings | None = None,
    gate: float = CombineSettings.gate,
) -> bool:
    """Whether anything beside the edges of ``fit`` has the size of a stem, which they need where the cloud refused it.

    ``points_std_m`` is the standard deviation of the points' radius, metres; ``gate`` that of
    :class:`fsinfer.silhouettes.combine.CombineSettings`, within which the two agree.
    """
    s = settings or SupportSettings()
    if section.dbh_m is not None:
        return True
    if fit.share < s.least_rays:
        return False
    if is_ragged(fit, s):
        return points_support(section, points_std_m, fit, s.points_std, gate=gate)
    stem = looked.stem
    # Small pictures of the stem may be what lacks for a second pair, or what spoils it.
    seen = [looked.edges] if looked.fitted is looked.edges else [looked.edges, looked.fitted]
    enough = s.points_std
    for edges in seen:
        pair = second_pair(edges, stem.radius_m, taper=stem.taper, silhouette=silhouette, settings=s.second)
        if pair.agree:
            return True
        if pair.weak:
            enough = s.half_points_std
    return points_support(section, points_std_m, fit, enough, gate=gate)


def is_ragged(fit: SilhouetteFit, settings: SupportSettings | None = None) -> bool:
    """Whether the edges lie about their fit as a stem's do not: those of leaves, or of what else is no smooth surface.

    A crooked thin stem's may, too; where its points say the same, the diameter is right all the same.
    """
    s = settings or SupportSettings()
    return fit.noise_m > s.most_scatter * fit.radius_m


def points_support(
    section: Section, points_std_m: float, fit: SilhouetteFit, enough: float, *, gate: float = CombineSettings.gate
) -> bool:
    """Whether the points of a stem that the cloud refused have the size of its edges all the same.

    Their standard deviation has to be below ``enough`` of the radius. Points that were too few, not round, or lie in
    two walls have no size.
    """
    why = refusal(section)
    if not section.parts_m or why is None or why.code in SIZELESS:
        return False
    near = abs(float(section.circle_m[2]) - fit.radius_m) <= gate * float(np.hypot(points_std_m, fit.std_m))
    return near and points_std_m <= enough * fit.radius_m


def said_by_hand(section: Section) -> tuple[Notice, ...]:
    """That a person put the stem on the map, which stays said whatever is found of it."""
    return tuple(why for why in section.reasons if why.code in BY_HAND)


def refusal(section: Section) -> Notice | None:
    """Why the cloud gave no diameter; None where it gave one."""
    if section.dbh_m is not None:
        return None
    return next((why for why in section.reasons if why.code not in BY_HAND), None)

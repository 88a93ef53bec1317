"""One stem's section from both sources: its diameter, the budget of its interval, and what is doubtful about it.

What points and edges each know goes into :func:`fsinfer.silhouettes.combine.combine`; what they share (height, scale,
poses) comes on top. What the cloud doubted or refused, the edges may know, and the other way round.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.silhouettes.combine import Combined, combine
from fsinfer.silhouettes.join_settings import SilhouetteJoinSettings
from fsinfer.silhouettes.points_alone import NOT_OF_POINTS, OF_SHAPE
from fsinfer.silhouettes.support import is_ragged, refusal, said_by_hand
from fsinfer.trees import DbhSettings, Section
from fsinfer.trees.diameter.budget import effective_dof, factor95, shared_std, total_std
from fsinfer.trees.diameter.outline import Outline
from fsinfer.trees.diameter.roundness import oval_factor, oval_share
from fsinfer.trees.diameter.silhouette import SilhouetteFit
from fsinfer.trees.diameter.verdict import too_uncertain, wide_interval
from fsinfer.trees.one_entry import HAZE_NOISE_M

#: Doubts of the cloud about its diameter that photographs do not lift: at which height it is, and whose it is.
NOT_LIFTED = frozenset({StemCode.above_breast_height, StemCode.below_breast_height, StemCode.forks_here})
#: Those that stay without a diameter of the cloud, too: whether it is a stem at all, and where its breast height is;
#: the edges of a post are as sharp, and none tells the ground.
NEVER_LIFTED = frozenset({StemCode.top_seen, StemCode.hangs, StemCode.ground_unsure})
#: Points that weigh less than this leave the diameter to the edges, and where they are a haze they do not vouch for
#: those: not for few, either. Source: definition, the half; that few count, renders only, seed 955057, afterwards: a
#: stem of 43 cm, of which six photos show a quarter, came out as 52 cm +- 5 cm.
MOST_BY_EDGES = 0.5
#: Directions in which an outline is drawn. Source: numerics.
DIRECTIONS = 180


def join(
    section: Section,
    fit: SilhouetteFit,
    *,
    scale_rel_std: float,
    dbh: DbhSettings,
    settings: SilhouetteJoinSettings,
    supported: bool = True,
    pose_std_m: float = 0.0,
) -> Section:
    """Combine the radii of cloud and silhouette; what they share (height, scale, poses) comes on top.

    ``supported`` says whether anything beside the edges agrees on the size of a stem that the cloud refused;
    ``pose_std_m`` is what the cameras' own errors do to the radius.
    """
    s = settings
    points_m = None if section.dbh_m is None else section.dbh_m / 2.0
    # The edges are seen where the points were measured, which is not always at breast height.
    edges_m = fit.radius_m + section.by_taper_m
    oval_m, one_sided_m = _hidden_oval(section, fit, s), _one_sided(section, fit, s)
    found = combine(
        points_m,
        points_std(section, s),
        edges_m,
        float(np.sqrt(max(fit.std_m**2 - fit.one_sided_m**2, 0.0))),
        points_doubt_m=_shape_doubt(section),
        edges_doubt_m=float(np.hypot(oval_m, one_sided_m)),
        oval=_misses_an_oval(section, fit, edges_m, s),
        hazy=section.residual_m > s.haze_m,
        counted=fit.faces > 0,
        fuller=fit.fuller,
        settings=s.combine,
    )
    radius = found.radius_m
    level = section.parts_m.get("level", (abs(fit.taper) + dbh.taper_std) * dbh.ground_std_m)
    parts = {
        "silhouette": found.edges_std_m,
        "cloud": found.points_std_m,
        "disagreement": found.disagreement_m,
        "poses": pose_std_m,
        "level": level,
        "scale": radius * scale_rel_std,
    }
    shared = {
        "silhouette": (1.0 - found.weight) * s.combine.factor(fuller=fit.fuller) * fit.common_m,
        "cloud": found.points_std_m * _shared_by_points(section, s),
        "level": level,
    }
    sd = 2.0 * total_std(parts)
    dof = effective_dof(parts, {"silhouette": fit.dof, "cloud": section.dof})
    status, reasons = _status(
        section, fit, 2.0 * radius, factor95(dof) * sd, dbh, s, found, supported=supported, oval=oval_m > fit.std_m
    )
    measured = status != "unmeasured"
    return replace(
        section,
        dbh_m=2.0 * radius if measured else None,
        sd_m=sd,
        dof=dof,
        parts_m=parts,
        status=status,
        reasons=(*said_by_hand(section), *reasons),
        circle_m=np.array([*fit.shift_m, radius - section.by_taper_m]),
        outline=_outline(fit, radius) if measured and fit.sectors >= dbh.outline_coverage else None,
        silhouette=fit,
        cloud_dbh_m=section.dbh_m,
        shared_sd_m=2.0 * total_std(shared),
    )


def points_std(section: Section, s: SilhouetteJoinSettings) -> float:
    """Standard deviation of the points' radius without what both sources share, and without doubts of its shape."""
    parts = {name: part for name, part in _of_points(section).items() if name not in OF_SHAPE}
    return float(np.hypot(total_std(parts), s.cloud_floor_m))


def _shape_doubt(section: Section) -> float:
    """Standard deviation of the points' radius by what the shape of its section leaves open."""
    return total_std({name: part for name, part in section.parts_m.items() if name in OF_SHAPE})


def _hidden_oval(section: Section, fit: SilhouetteFit, s: SilhouetteJoinSettings) -> float:
    """Standard deviation of the edges' radius, metres, by sides that they miss of a section far from round.

    What those leave open is in the edges' own standard deviation as far as hulls are as round as usual.
    """
    more = oval_factor(section.roundness) / s.fit.hull_of_rough_bark
    return fit.left_open_m * float(np.sqrt(max(more**2 - 1.0, 0.0)))


def _one_sided(section: Section, fit: SilhouetteFit, s: SilhouetteJoinSettings) -> float:
    """Standard deviation of the edges' radius, metres, by sides unseen.

    It is more where nothing is sharp: a haze does not tell which edges are the stem's, nor do edges that stand out
    little.
    """
    sharp = section.residual_m <= s.haze_m or fit.contrast >= s.clear_contrast
    return fit.one_sided_m * (1.0 if sharp else s.hazy_one_sided)


def _misses_an_oval(section: Section, fit: SilhouetteFit, edges_m: float, s: SilhouetteJoinSettings) -> bool:
    """Whether the points have the section so far from round that edges from few sides may differ from them as they do.

    A section's mean radius and that of some of its sides are an oval's amplitude apart at most.
    """
    if section.dbh_m is None or oval_factor(section.roundness) <= 1.0 or fit.sectors >= s.fit.sides_enough:
        return False
    points_m = section.dbh_m / 2.0
    apart_m = abs(points_m - edges_m) - oval_share(section.roundness) * points_m
    return apart_m <= s.combine.gate * float(np.hypot(points_std(section, s), fit.std_m))


def _shared_by_points(section: Section, s: SilhouetteJoinSettings) -> float:
    """Share of the points' standard deviation that has one cause in all stems of a plot, as fattened edges have."""
    std = float(np.hypot(points_std(section, s), _shape_doubt(section)))
    return float(np.hypot(shared_std(_of_points(section)), s.cloud_floor_m)) / std if std > 0 else 0.0


def _of_points(section: Section) -> dict[str, float]:
    return {name: part for name, part in section.parts_m.items() if name not in NOT_OF_POINTS}


def _status(
    section: Section,
    fit: SilhouetteFit,
    dbh_m: float,
    half_m: float,
    dbh: DbhSettings,
    s: SilhouetteJoinSettings,
    found: Combined,
    *,
    supported: bool,
    oval: bool,
) -> tuple[str, tuple[Notice, ...]]:
    """Status and reasons anew: what the cloud doubted or refused, the silhouette may know.

    ``oval`` says that what a section far from round hides is most of what is not known.
    """
    refused = refusal(section)
    faint = fit.contrast < s.wider.sure_contrast
    if refused is not None and not supported:
        photos, edges_cm = fit.photos, 100.0 * dbh_m
        if is_ragged(fit, s.support):
            why = notice(StemCode.edges_ragged, photos=photos, edges_cm=edges_cm, refused=refused)
        elif faint or fit.share < s.support.least_rays:
            # Twigs have edges, too, but few rays agree on them, or they stand out as little as chance's.
            why = notice(StemCode.edges_unsure, photos=photos, edges_cm=edges_cm, refused=refused)
        else:
            why = notice(StemCode.edges_unsupported, photos=photos, edges_cm=edges_cm, refused=refused)
        return "unmeasured", (why,)
    uncertain = too_uncertain(dbh_m, half_m, dbh)
    if uncertain:
        return "unmeasured", uncertain
    disagree: tuple[Notice, ...] = ()
    if found.contradict and section.dbh_m is not None:
        points_cm, edges_cm = 100.0 * section.dbh_m, 200.0 * fit.radius_m
        disagree = (notice(StemCode.sources_disagree, points_cm=points_cm, edges_cm=edges_cm),)
        # That the edges are the surer of the two holds for a stem's: of leaves, either may be wrong by all of it.
        apart_m = abs(points_cm - edges_cm) / 100.0
        uncertain = too_uncertain(dbh_m, apart_m, dbh) if is_ragged(fit, s.support) else ()
        if uncertain:
            return "unmeasured", (*uncertain, *disagree)
    stays = NEVER_LIFTED if section.dbh_m is None else NEVER_LIFTED | NOT_LIFTED
    doubts = [why for why in section.reasons if why.code in stays]
    few = fit.photos < s.sure_photos or fit.sectors < s.sure_sectors or faint
    # Two walls are poses that do not agree: the distance of two edges stands it, but somebody should look.
    if refused is not None and (few or refused.code == StemCode.double_wall):
        doubts.append(notice(StemCode.edges_alone, photos=fit.photos, refused=refused))
    elif few and found.weight < MOST_BY_EDGES and section.residual_m > HAZE_NOISE_M:
        doubts.append(notice(StemCode.faint_edges if faint else StemCode.few_edges, photos=fit.photos))
    doubts += disagree
    doubts += wide_interval(dbh_m, half_m, dbh)
    if oval and section.dbh_m is not None:
        doubts.append(notice(StemCode.far_from_round))
    return ("doubtful" if doubts else "ok"), tuple(doubts)


def _outline(fit: SilhouetteFit, radius: float) -> Outline:
    """Hull whose support function is the fit's about ``radius``: x = p n + p' n' (Santalo 2004, section 1.2)."""
    angle = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False)
    support = fit.support(angle) + radius - fit.radius_m
    slope = (np.roll(support, -1) - np.roll(support, 1)) / (angle[2] - angle[0])
    normal, along = np.column_stack([np.cos(angle), np.sin(angle)]), np.column_stack([-np.sin(angle), np.cos(angle)])
    width = support + np.roll(support, len(angle) // 2)
    return Outline(
        curve_m=support[:, None] * normal + slope[:, None] * along,
        girth_diameter_m=2.0 * radius,
        min_diameter_m=float(width.min()),
        max_diameter_m=float(width.max()),
    )

"""Diameters from the photographs' own edges, joined with those from the cloud.

A cloud knows a stem's surface as well as depth maps do: to millimetres from two metres, to centimetres from ten. The
edges between stem and background in the same photographs are sharp at any distance. So each stem of the cloud is looked
up in all photographs that show it (:mod:`fsinfer.silhouettes.edges`), its silhouette is fitted
(:mod:`fsinfer.trees.diameter.silhouette`), both again where it turns out to be another than the cloud thought
(:mod:`fsinfer.silhouettes.looks`), and the two diameters are averaged by their precision. Where they contradict
each other the silhouette's stands, doubtful, the contradiction in its interval (:mod:`fsinfer.silhouettes.combine`).
Edges alone are no measurement: where the points refused, something else has to have the same size
(:mod:`fsinfer.silhouettes.support`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMaps
from fsinfer.io.csv_text import write_table
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.progress import Progress, silent
from fsinfer.scene import Scene
from fsinfer.silhouettes.combine import Combined, CombineSettings, combine
from fsinfer.silhouettes.edges import EdgeSettings, StemAxis
from fsinfer.silhouettes.looks import Looked, LookSettings, look_at_stems
from fsinfer.silhouettes.points_alone import NOT_OF_POINTS, OF_SHAPE, by_points_alone
from fsinfer.silhouettes.pose_errors import radius_std
from fsinfer.silhouettes.strips import draw_strips
from fsinfer.silhouettes.support import SupportSettings, is_supported, refusal
from fsinfer.trees import DbhSettings, PlotResult, Section, Tree
from fsinfer.trees.cylinder.axis import LEAST_RADIUS_M
from fsinfer.trees.diameter.budget import effective_dof, factor95, shared_std, total_std
from fsinfer.trees.diameter.dbh import too_uncertain, wide_interval
from fsinfer.trees.diameter.edge_problem import SilhouetteSettings
from fsinfer.trees.diameter.outline import Outline
from fsinfer.trees.diameter.roundness import oval_factor
from fsinfer.trees.diameter.silhouette import SilhouetteFit, edge_contrast
from fsinfer.trees.measure import trees_found
from fsinfer.trees.one_entry import one_entry_a_stem
from fsinfer.trees.stem_measurement import with_diameter

Floats = NDArray[np.float64]

SOURCE_COLUMNS = (
    "tree_id", "points_cm", "edges_cm", "edges_std_cm", "photos", "sides_seen", "rays_agreeing", "contrast",
    "points_used",
)  # fmt: skip

#: Doubts of the cloud that photographs do not lift.
NOT_LIFTED = frozenset({StemCode.above_breast_height, StemCode.below_breast_height, StemCode.forks_here})


@dataclass(frozen=True, kw_only=True)
class StemPhotos:
    """The photographs a cloud was made of: ``cloud_from_scene`` (4, 4) maps the scene to the cloud, in metres.

    ``depth_folder`` holds ``depth/`` and ``confidence/``. ``ray_std_m`` tells how far the cameras' own errors move the
    rays of each view at a place (3,) of the cloud (:func:`fsinfer.silhouettes.pose_errors.ray_errors`); that goes into
    the interval as the part ``poses``. None where nothing is known of that.
    """

    scene: Scene
    depth_folder: Path
    cloud_from_scene: Floats
    ray_std_m: Callable[[Floats], Floats] | None = None


#: Depth maps held at once, and directions in which an outline is drawn. Source: numerics.
CACHED_MAPS, DIRECTIONS = 2, 180


@dataclass(frozen=True, kw_only=True)
class SilhouetteJoinSettings:
    """Constants of :func:`measure_silhouettes`. "Three renders" are the open, the sloped and the test plot.

    Attributes
    ----------
    cloud_floor_m: added to the error of the cloud's radius: depth maps fatten edges. Source: renders only, three
        renders.
    points_alone_factor: points whose stem's edges no photograph shows are off by so many times what they say. Source:
        renders only, 22 stems in and round seven plots photographed by a phone (seeds 954001, 955001 to 955006): 2.24
        times, 15 of them inside their intervals, RMSE 5.2 cm; those with edges there 1.0 times.
    sure_photos: fewer, and a stem that the cloud could not measure stays doubtful. Source: renders only, three renders.
    sure_sectors: the same for the directions that they cover. Source: renders only, three renders.
    shrub_photos: so many photographs show the place, and ... Source: renders only, undergrown plot, afterwards.
    shrub_contrast: ... their edges agree no better than this on a stem: a shrub. Source: renders only, undergrown plot,
        afterwards: 1.02 to 1.07, a half-hidden stem 1.18.
    edges, looks, fit, support, combine: of the steps.
    """

    cloud_floor_m: float = 0.0015
    points_alone_factor: float = 2.25
    sure_photos: int = 8
    sure_sectors: float = 0.3
    shrub_photos: int = 15
    shrub_contrast: float = 1.12
    edges: EdgeSettings = field(default_factory=EdgeSettings)
    looks: LookSettings = field(default_factory=LookSettings)
    fit: SilhouetteSettings = field(default_factory=SilhouetteSettings)
    support: SupportSettings = field(default_factory=SupportSettings)
    combine: CombineSettings = field(default_factory=CombineSettings)


def measure_silhouettes(
    result: PlotResult,
    photos: StemPhotos,
    *,
    scale_rel_std: float = 0.0,
    dbh: DbhSettings | None = None,
    settings: SilhouetteJoinSettings | None = None,
    figures: Path | None = None,
    kept: Collection[int] = (),
    progress: Progress = silent,
) -> PlotResult:
    """Look every stem of ``result`` up in the photographs and join what they say with what the cloud says.

    Stems that no photograph shows clearly keep what their points say, less surely
    (:mod:`fsinfer.silhouettes.points_alone`). Sections get ``silhouette`` and ``cloud_dbh_m``.
    What is doubtful in the cloud and no stem in many photographs is left out with a warning, unless ``kept`` has its
    number; so are entries that turn out to stand in another stem. ``figures`` is a folder for ``tree_ID_edges.png``:
    strips of the photographs with the edges that were found.
    Raises :class:`~fsinfer.errors.FsinferError` where a photograph or a depth map cannot be read.
    """
    s = settings or SilhouetteJoinSettings()
    dbh = dbh or DbhSettings()
    stems = [_axis(tree, section) for tree, section in zip(result.trees, result.sections, strict=True)]
    if not stems:
        return result
    maps = DepthMaps(photos.scene, photos.depth_folder, cache_maps=CACHED_MAPS)
    points = [None if sec.dbh_m is None else (sec.dbh_m / 2.0, _points_std(sec, s)) for sec in result.sections]
    found = look_at_stems(
        stems,
        points,
        photos.scene,
        maps,
        photos.cloud_from_scene,
        edges=s.edges,
        fit=s.fit,
        settings=s.looks,
        keep_strips=figures is not None,
        progress=progress,
    )
    pairs, shrubs = [], []
    for tree, section, stem, looked in zip(result.trees, result.sections, stems, found, strict=True):
        fit = looked.fit
        if fit is None or not looked.clear(s.looks):
            if fit is None and tree.tree_id not in kept and _is_shrub(tree, looked, s):
                shrubs.append(tree)
            else:
                pairs.append(by_points_alone(tree, section, s.points_alone_factor, dbh=dbh))
            continue
        if figures is not None:
            names = [photos.scene.views[strip.photo].name for strip in looked.strips]
            draw_strips(figures / f"tree_{tree.tree_id:03d}_edges.png", looked.strips, names, looked.stem, fit)
        pose_std_m = 0.0
        if photos.ray_std_m is not None:
            pose_std_m = radius_std(looked.fitted, fit, photos.ray_std_m(looked.stem.breast))
        fit = replace(fit, shift_m=fit.shift_m + looked.moved_m)  # about the section's own axis
        joined = join(
            section,
            fit,
            scale_rel_std=scale_rel_std,
            dbh=dbh,
            settings=s,
            supported=is_supported(
                section,
                _points_std(section, s),
                looked,
                fit,
                silhouette=s.fit,
                settings=s.support,
                gate=s.combine.gate,
            ),
            pose_std_m=pose_std_m,
        )
        pairs.append((_tree(tree, joined, stem, fit), joined))
    pairs, same = one_entry_a_stem(pairs, kept)
    return replace(
        result,
        trees=tuple(tree for tree, _ in pairs),
        sections=tuple(section for _, section in pairs),
        diagnosis=_diagnosis([tree for tree, _ in pairs]),
        warnings=(*result.warnings, *_shrub_warning(shrubs), *same),
    )


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
    oval_m = _hidden_oval(section, fit, s)
    found = combine(
        points_m,
        _points_std(section, s),
        edges_m,
        float(np.hypot(fit.std_m, oval_m)),
        points_doubt_m=_shape_doubt(section),
        oval=_misses_an_oval(section, fit, s),
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
        "silhouette": (1.0 - found.weight) * fit.common_m,
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
        reasons=reasons,
        circle_m=np.array([*fit.shift_m, radius - section.by_taper_m]),
        outline=_outline(fit, radius) if measured and fit.sectors >= dbh.outline_coverage else None,
        silhouette=fit,
        cloud_dbh_m=section.dbh_m,
        shared_sd_m=2.0 * total_std(shared),
    )


def _points_std(section: Section, s: SilhouetteJoinSettings) -> float:
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


def _misses_an_oval(section: Section, fit: SilhouetteFit, s: SilhouetteJoinSettings) -> bool:
    """Whether the points have the section far from round, and edges from too few sides to know."""
    return oval_factor(section.roundness) > 1.0 and fit.sectors < s.fit.sides_enough


def _shared_by_points(section: Section, s: SilhouetteJoinSettings) -> float:
    """Share of the points' standard deviation that has one cause in all stems of a plot, as fattened edges have."""
    std = float(np.hypot(_points_std(section, s), _shape_doubt(section)))
    return float(np.hypot(shared_std(_of_points(section)), s.cloud_floor_m)) / std if std > 0 else 0.0


def _of_points(section: Section) -> dict[str, float]:
    return {name: part for name, part in section.parts_m.items() if name not in NOT_OF_POINTS}


def write_sources(path: Path, result: PlotResult) -> None:
    """Write what the points alone and the photographs' edges said of each diameter, a row for each tree with edges."""
    rows = []
    for tree, section in zip(result.trees, result.sections, strict=True):
        fit = section.silhouette
        if fit is None:
            continue
        points = None if section.cloud_dbh_m is None else f"{100 * section.cloud_dbh_m:.2f}"
        edges = (f"{200 * fit.radius_m:.2f}", f"{200 * fit.std_m:.2f}", fit.photos)
        shares = (f"{fit.sectors:.2f}", f"{fit.share:.2f}", f"{fit.contrast:.2f}")
        rows.append((tree.tree_id, points, *edges, *shares, "yes" if section.parts_m["cloud"] > 0 else "no"))
    write_table(path, SOURCE_COLUMNS, rows)


def _axis(tree: Tree, section: Section) -> StemAxis:
    along = np.array([*section.slope, 1.0])
    radius = float(section.circle_m[2]) if section.dbh_m is None else section.dbh_m / 2.0
    return StemAxis(
        breast=np.array([tree.x_m, tree.y_m, tree.z_ground_m + section.bh_m]),
        along=along / np.linalg.norm(along),
        radius_m=max(radius, LEAST_RADIUS_M),
        taper=section.taper,
    )


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
    if refused is not None and not supported:
        why = notice(StemCode.edges_unsupported, photos=fit.photos, edges_cm=100.0 * dbh_m, refused=refused)
        return "unmeasured", (why,)
    uncertain = too_uncertain(dbh_m, half_m, dbh)
    if uncertain:
        return "unmeasured", uncertain
    doubts = [why for why in section.reasons if why.code in NOT_LIFTED and section.dbh_m is not None]
    few = fit.photos < s.sure_photos or fit.sectors < s.sure_sectors
    # Two walls are poses that do not agree: the distance of two edges stands it, but somebody should look.
    if refused is not None and (few or refused.code == StemCode.double_wall):
        doubts.append(notice(StemCode.edges_alone, photos=fit.photos, refused=refused))
    if found.contradict and section.dbh_m is not None:
        points_cm, edges_cm = 100.0 * section.dbh_m, 200.0 * fit.radius_m
        doubts.append(notice(StemCode.sources_disagree, points_cm=points_cm, edges_cm=edges_cm))
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


def _tree(tree: Tree, section: Section, stem: StemAxis, fit: SilhouetteFit) -> Tree:
    first, second = stem.across
    moved = stem.breast + fit.shift_m[0] * first + fit.shift_m[1] * second
    return with_diameter(replace(tree, x_m=float(moved[0]), y_m=float(moved[1])), section)


def _is_shrub(tree: Tree, looked: Looked, s: SilhouetteJoinSettings) -> bool:
    stem, edges = looked.stem, looked.fitted
    if tree.status == "ok" or len(np.unique(edges.photo)) < s.shrub_photos:
        return False
    return edge_contrast(edges, stem.radius_m, taper=stem.taper, settings=s.fit) < s.shrub_contrast


def _shrub_warning(shrubs: Sequence[Tree]) -> tuple[Notice, ...]:
    if not shrubs:
        return ()
    places = tuple(f"({tree.x_m:.1f}, {tree.y_m:.1f})" for tree in shrubs)
    return (notice(StemCode.shrubs_left_out, places=places),)


def _diagnosis(trees: Sequence[Tree]) -> Notice:
    if not trees:
        return notice(StemCode.none_in_photos)
    return trees_found(trees)

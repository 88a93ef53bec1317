"""Diameters from the photographs' own edges, joined with those from the cloud.

A cloud knows a stem's surface as well as depth maps do: to millimetres from two metres, to centimetres from ten. The
edges between stem and background in the same photographs are sharp at any distance. So each stem of the cloud is looked
up in all photographs that show it (:mod:`fsinfer.silhouettes.edges`), its silhouette is fitted
(:mod:`fsinfer.trees.diameter.silhouette`), both again where it turns out to be another than the cloud thought
(:mod:`fsinfer.silhouettes.looks`) or not to stand there (:mod:`fsinfer.silhouettes.wide_look`), and the two diameters
are averaged by their precision. Where they contradict each other the silhouette's stands, doubtful, the contradiction
in its interval (:mod:`fsinfer.silhouettes.combine`). Edges alone are no measurement: where the
points refused, something else has to have the same size (:mod:`fsinfer.silhouettes.support`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMaps
from fsinfer.io.csv_text import write_table
from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.processes import shared_out
from fsinfer.progress import Progress, silent
from fsinfer.scene import Scene
from fsinfer.silhouettes.across import with_sizes_below
from fsinfer.silhouettes.edges import Strip
from fsinfer.silhouettes.join_settings import SilhouetteJoinSettings
from fsinfer.silhouettes.joined_section import join, points_std
from fsinfer.silhouettes.looks import look_at_stems
from fsinfer.silhouettes.points_alone import by_points_alone
from fsinfer.silhouettes.pose_errors import radius_std
from fsinfer.silhouettes.shrubs import is_arc_of_haze, is_shrub, shows_no_edges_all_round
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.silhouettes.strips import draw_strips
from fsinfer.silhouettes.support import is_supported
from fsinfer.silhouettes.surface import points_about
from fsinfer.trees import DbhSettings, PlotResult, Section, Tree
from fsinfer.trees.cylinder.axis import LEAST_RADIUS_M
from fsinfer.trees.diameter.silhouette import SilhouetteFit
from fsinfer.trees.measure import trees_found
from fsinfer.trees.one_entry import one_entry_a_stem
from fsinfer.trees.stem_measurement import with_diameter

Floats = NDArray[np.float64]

SOURCE_COLUMNS = (
    "tree_id", "points_cm", "edges_cm", "edges_std_cm", "photos", "sides_seen", "rays_agreeing", "contrast",
    "points_used",
)  # fmt: skip


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


#: Depth maps held at once. Source: numerics.
CACHED_MAPS = 2


def measure_silhouettes(
    result: PlotResult,
    photos: StemPhotos,
    *,
    scale_rel_std: float = 0.0,
    dbh: DbhSettings | None = None,
    settings: SilhouetteJoinSettings | None = None,
    figures: Path | None = None,
    kept: Collection[int] = (),
    cloud_xyz: Floats | None = None,
    progress: Progress = silent,
) -> PlotResult:
    """Look every stem of ``result`` up in the photographs and join what they say with what the cloud says.

    Stems that no photograph shows clearly keep what their points say, less surely
    (:mod:`fsinfer.silhouettes.points_alone`). Sections get ``silhouette`` and ``cloud_dbh_m``.
    What is doubtful in the cloud and no stem in many photographs is left out with a warning, unless ``kept`` has its
    number; so are entries that turn out to stand in another stem. Of those of whose size nothing is known the cloud
    tells what stands below them (:mod:`fsinfer.silhouettes.across`). ``figures`` is a folder for ``tree_ID_edges.png``:
    strips of the photographs with the edges that were found. ``cloud_xyz`` (N, 3) is the cloud, metres, whose sharp
    faces tell of sides that no photograph shows the edges of.
    Raises :class:`~fsinfer.errors.FsinferError` where a photograph or a depth map cannot be read.
    """
    s = settings or SilhouetteJoinSettings()
    dbh = dbh or DbhSettings()
    stems = [_axis(tree, section) for tree, section in zip(result.trees, result.sections, strict=True)]
    if not stems:
        return result
    maps = DepthMaps(photos.scene, photos.depth_folder, cache_maps=CACHED_MAPS)
    points = [None if sec.dbh_m is None else (sec.dbh_m / 2.0, points_std(sec, s)) for sec in result.sections]
    found = look_at_stems(
        stems,
        points,
        photos.scene,
        maps,
        photos.cloud_from_scene,
        edges=s.edges,
        fit=s.fit,
        settings=s.looks,
        wider=s.wider,
        keep_strips=figures is not None,
        surface=None if cloud_xyz is None else partial(points_about, cloud_xyz, settings=s.fit.faces),
        progress=progress,
    )
    pairs, shrubs, sheets = [], [], []
    for tree, section, stem, looked in zip(result.trees, result.sections, stems, found, strict=True):
        fit = looked.fit
        if fit is None or not looked.clear(s.looks):
            alone = by_points_alone(tree, section, s.points_alone_factor, dbh=dbh)
            asked = fit is None and tree.tree_id not in kept
            if asked and (is_shrub(tree, looked, s) or is_arc_of_haze(alone[0], looked)):
                shrubs.append(tree)
            else:
                pairs.append(alone)
            continue
        supported = is_supported(
            section,
            points_std(section, s),
            looked,
            fit,
            silhouette=s.fit,
            settings=s.support,
            gate=s.combine.gate,
        )
        if not supported and tree.tree_id not in kept and shows_no_edges_all_round(tree, looked, fit.contrast, s):
            shrubs.append(tree)
            continue
        if figures is not None:
            names = [photos.scene.views[strip.photo].name for strip in looked.strips]
            path = figures / f"tree_{tree.tree_id:03d}_edges.png"
            sheets.append((path, looked.strips, names, looked.stem, fit))
        pose_std_m = 0.0
        if photos.ray_std_m is not None:
            pose_std_m = radius_std(looked.of_fit, fit, photos.ray_std_m(looked.stem.breast))
        fit = replace(fit, shift_m=fit.shift_m + looked.moved_m)  # about the section's own axis
        joined = join(
            section,
            fit,
            scale_rel_std=scale_rel_std,
            dbh=dbh,
            settings=s,
            supported=supported,
            pose_std_m=pose_std_m,
        )
        pairs.append((_tree(tree, joined, stem, fit), joined))
    for _ in shared_out(_draw, sheets):
        pass
    pairs, same = one_entry_a_stem(pairs, kept)
    if cloud_xyz is not None:
        pairs = with_sizes_below(pairs, cloud_xyz)
    return replace(
        result,
        trees=tuple(tree for tree, _ in pairs),
        sections=tuple(section for _, section in pairs),
        diagnosis=_diagnosis([tree for tree, _ in pairs]),
        warnings=(*result.warnings, *_shrub_warning(shrubs), *same),
    )


def _draw(sheet: tuple[Path, Sequence[Strip], Sequence[str], StemAxis, SilhouetteFit]) -> None:
    draw_strips(*sheet)


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
        used = section.parts_m["cloud"] > 0 or fit.faces > 0
        rows.append((tree.tree_id, points, *edges, *shares, "yes" if used else "no"))
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


def _tree(tree: Tree, section: Section, stem: StemAxis, fit: SilhouetteFit) -> Tree:
    moved = stem.moved(fit.shift_m, fit.radius_m).breast
    return with_diameter(replace(tree, x_m=float(moved[0]), y_m=float(moved[1])), section)


def _shrub_warning(shrubs: Sequence[Tree]) -> tuple[Notice, ...]:
    if not shrubs:
        return ()
    # With their numbers: by hand one comes back by a row that deletes its number and one that adds its place.
    places = tuple(f"tree {tree.tree_id} at ({tree.x_m:.1f}, {tree.y_m:.1f})" for tree in shrubs)
    return (notice(StemCode.shrubs_left_out, places=places),)


def _diagnosis(trees: Sequence[Tree]) -> Notice:
    if not trees:
        return notice(StemCode.none_in_photos)
    return trees_found(trees)

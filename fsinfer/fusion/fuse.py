"""From depth maps to one cloud: what several views agree on, once per place.

For each view: take the pixels that are sure enough and no flying pixels, ask the neighbouring views
(:mod:`fsinfer.fusion.consistency`), keep those that enough views agree with, average their depth over these views, and
merge the points of all views in voxels (:mod:`fsinfer.fusion.voxels`).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.maps import DepthMap, DepthMaps
from fsinfer.depth.settings import DepthSettings
from fsinfer.errors import CloudError
from fsinfer.fusion.consistency import LEVELS, NO_LEVEL, Tolerances, check_pair
from fsinfer.fusion.depth_error import depth_std, pixel_size, std_at_unit_depth
from fsinfer.fusion.memory import FusionPlan, plan_fusion
from fsinfer.fusion.surfaces import pixel_normals, smooth_pixels
from fsinfer.fusion.voxels import MAX_EXTENT_VOXELS, Samples, VoxelMerger, much_worse_than_nearby, select, sum_within
from fsinfer.io.cloud import DEPTH_STD, PIXEL_SIZE, PointCloud
from fsinfer.progress import Progress, silent
from fsinfer.scene import Scene, read_view_image
from fsinfer.threads import MOST_AT_ONCE, cores, in_order, one_blas_thread

_log = logging.getLogger(__name__)

#: A pixel of no confidence still counts so much in a mean. Source: numerics.
_LEAST_CONFIDENCE = 0.05
#: Views and pixels that the confidences and footprints of a scene are sampled from: so many views, each so-many-th
#: pixel. Source: numerics.
_SAMPLED_VIEWS, _PIXEL_STRIDE = 16, 7
#: The same for the noise of the maps. Source: numerics.
_NOISE_VIEWS, _NOISE_STRIDE = 8, 11
#: Side of the cells in whose neighbourhood of three specks are looked for, voxels. Source: judgement.
_SPECK_CELL = 4


@dataclass(frozen=True, kw_only=True)
class FusionSettings:
    """Constants of the fusion.

    Attributes
    ----------
    min_confidence: pixels below are left out; None takes ``unsure_percent`` of the scene's confidences, but not more
        than ``confidence_cap``. Source: option.
    unsure_percent: share of the pixels that is left out, the least sure. Source: saharov32, four views: the surer 70 %
        of pixels held 94-99 % within 1 %.
    confidence_cap: a scene in which everything is sure loses nothing. Source: calibrated confidence: even odds.
    source_confidence_part: other views may witness with so much of that confidence. Source: judgement.
    tolerances: of the comparison of two views.
    noise_part: the step of the depth tolerance is at least so much of the median difference between neighbouring maps,
        up to ``noise_step_max``; 0 = off. Source: rendered maps with 0.5 % noise, on which a step of 0.002 kept twice
        the surface of 0.001 with the same error: a tolerance below the noise only makes holes; renders only.
    noise_step_max: see above. Source: judgement.
    max_sources: views asked for each view, those of pair.txt first, then those that list it. Source: judgement.
    extra_views: level i needs i + extra_views agreeing views; fewer only where the view has fewer neighbours. Source:
        D2HC-RMVSNet starts at two views.
    average_level: views agreeing within this level (or the level at which the pixel passed) enter the mean depth.
        Wider than the level that passes, because views chosen for being near the reference's value average its noise
        less. Source: judgement.
    min_smooth_neighbours: of the 8 neighbours, so many must lie on the same surface. Source: 3 of 8 are missing at a
        straight silhouette, so 5 keeps edges and drops the mixed pixels between foreground and background.
    min_seen_through: points that so many views look through, and more than agree with them, are removed. Source:
        judgement; one view may be wrong.
    voxel: side in scene units; None takes ``voxel_percent`` of the pixel footprints. Source: option.
    voxel_percent: percentile of the pixel footprints that is the voxel's side. Source: judgement; the nearer quarter
        of the pixels keeps its detail.
    max_points: the voxel grows until no more points are left. Source: option; what a viewer shows and trees take in
        seconds.
    halo_ratio, halo_cell: points whose standard deviation is over ``halo_ratio`` times that of what lies within
        ``halo_cell`` voxels and faces the same way are the halo of far views; ``None`` keeps them. Source: the demo
        plot and one rendered plot (`tests.bench.plot --halo-ratio`); renders only.
    min_cell_pixels: points with fewer depth pixels in the neighbourhood of 12 voxels are lone specks and removed.
        Source: judgement.
    cache_maps: depth maps kept in memory. Source: numerics.
    batch_points: points merged at a time. Source: numerics.
    memory_gb: limit of the resident memory, 1e9 bytes; where it is tight fewer maps are kept, batches are smaller and,
        with a warning, fewer points are kept (:func:`fsinfer.fusion.memory.plan_fusion`). Source: option; that of
        depth.
    """

    min_confidence: float | None = None
    unsure_percent: float = 30.0
    confidence_cap: float = 0.5
    source_confidence_part: float = 0.5
    tolerances: Tolerances = field(default_factory=Tolerances)
    noise_part: float = 0.7
    noise_step_max: float = 3e-3
    max_sources: int = 12
    extra_views: int = 1
    average_level: int = 6
    min_smooth_neighbours: int = 5
    min_seen_through: int = 2
    voxel: float | None = None
    voxel_percent: float = 25.0
    max_points: int = 4_000_000
    min_cell_pixels: int = 8
    halo_ratio: float | None = 3.0
    halo_cell: float = 6.0
    cache_maps: int = 40
    batch_points: int = 1_500_000
    memory_gb: float = DepthSettings.memory_gb


@one_blas_thread()
def fuse(
    scene: Scene, depth_folder: Path, *, settings: FusionSettings | None = None, progress: Progress = silent
) -> PointCloud:
    """Fuse the depth maps of a scene.

    Parameters
    ----------
    depth_folder: the folder with ``depth/`` and ``confidence/`` that the depth stage wrote.

    Returns
    -------
    Cloud in scene units with rgb, normals (towards the cameras), and in ``extra``: ``views`` (int32, views that agree
    on the point, with its own), ``confidence``, ``depth_std`` and ``pixel_size`` (float32;
    :mod:`fsinfer.fusion.depth_error`).

    Raises
    ------
    SceneError
        There are no depth maps, or one cannot be read.
    CloudError
        No point passed.
    """
    settings = settings or FusionSettings()
    maps = DepthMaps(scene, depth_folder, cache_maps=settings.cache_maps)
    plan = _plan(maps, settings)
    maps.keep(plan.cache_maps)
    if plan.max_points < settings.max_points:
        _log.warning(
            "%g GB of --memory-gb hold %d points; the cloud may be coarser", settings.memory_gb, plan.max_points
        )
    min_confidence, voxel = _adapt(maps, settings)
    neighbours = find_neighbours(scene, maps.available, settings.max_sources)
    settings = replace(settings, tolerances=adapt_tolerances(maps, neighbours, min_confidence, settings))
    middle = np.mean([scene.views[i].camera.center for i in maps.available], axis=0)
    merger = VoxelMerger(voxel, max_points=plan.max_points, batch_points=plan.batch_points)

    def confirmed(index: int) -> Samples:
        return fuse_view(scene, maps, index, neighbours[index], min_confidence=min_confidence, settings=settings)

    # The order of the views stays, so that the sums of a voxel do.
    # While a batch is merged the threads go on.
    in_turn = in_order(confirmed, maps.available, min(plan.at_once, cores()), ahead=plan.ahead)
    for done, (index, samples) in enumerate(zip(maps.available, in_turn, strict=True)):
        progress(done, len(maps.available), scene.views[index].name)
        # The sides of a cube around the cameras: what lies beyond it is no forest, and its voxel keys would wrap.
        near = np.abs(samples.xyz - middle).max(axis=1, initial=0) < voxel * MAX_EXTENT_VOXELS / 2
        merger.add(samples if near.all() else select(samples, near))
    progress(len(maps.available), len(maps.available), "merging")
    merged = merger.result()
    if merged is not None:
        merged = _drop_specks(merged, merger.voxel, settings.min_cell_pixels)
        if settings.halo_ratio is not None:
            halo = much_worse_than_nearby(merged, settings.halo_cell * voxel, settings.halo_ratio)
            merged = select(merged, ~halo)
    if merged is None or not len(merged):
        msg = (
            f"no point of {depth_folder / 'depth'} is seen alike by two views; take photographs closer to each other, "
            "with more overlap, or check that the depth maps belong to this scene"
        )
        raise CloudError(msg)
    _log.info("fused %d points, voxel %.4g, confidence >= %.2f", len(merged), merger.voxel, min_confidence)
    return PointCloud(
        xyz=merged.xyz,
        rgb=np.clip(np.rint(merged.rgb), 0, 255).astype(np.uint8),
        normals=merged.normals,
        extra={
            "views": merged.views.astype(np.int32),
            "confidence": merged.confidence,
            DEPTH_STD: depth_std(merged.quality, std_at_unit_depth(scene, maps.available, maps.picture_focals_px())),
            PIXEL_SIZE: pixel_size(merged.quality, merged.views, maps.focal_px()),
        },
    )


def most_points(scene: Scene, depth_folder: Path, *, settings: FusionSettings | None = None) -> int:
    """Points that a cloud of these depth maps may have within ``settings.memory_gb``; errors as :func:`fuse`."""
    return _plan(DepthMaps(scene, depth_folder), settings or FusionSettings()).max_points


def _plan(maps: DepthMaps, settings: FusionSettings) -> FusionPlan:
    return plan_fusion(
        settings.memory_gb,
        map_pixels=maps.most_pixels(),
        photo_pixels=maps.most_photo_pixels(),
        cache_maps=settings.cache_maps,
        max_points=settings.max_points,
        batch_points=settings.batch_points,
        at_once=MOST_AT_ONCE,  # whatever the cores, so that the cloud is the same
    )


def find_neighbours(scene: Scene, available: tuple[int, ...], limit: int) -> dict[int, tuple[int, ...]]:
    """For each view with a depth map, the views to ask: its sources, then the views whose source it is."""
    has_map = set(available)
    listed_by: dict[int, list[int]] = {index: [] for index in available}
    for index in available:
        for source in scene.views[index].sources:
            if source in has_map:
                listed_by[source].append(index)
    return {
        index: tuple(dict.fromkeys([s for s in scene.views[index].sources if s in has_map] + listed_by[index]))[:limit]
        for index in available
    }


def fuse_view(
    scene: Scene,
    maps: DepthMaps,
    index: int,
    neighbours: tuple[int, ...],
    *,
    min_confidence: float,
    settings: FusionSettings,
) -> Samples:
    """Return the points of one view that its neighbours confirm, one for each pixel, in world coordinates."""
    reference = maps.get(index)
    keep = (reference.inverse_depth > 0) & (reference.confidence >= min_confidence)
    keep &= smooth_pixels(
        reference,
        min_neighbours=settings.min_smooth_neighbours,
        noise=settings.tolerances.relative_depth_step,
    )
    rows, columns = np.nonzero(keep)
    if not neighbours:
        rows, columns = rows[:0], columns[:0]
    u, v = columns.astype(np.float32), rows.astype(np.float32)
    depth = np.asarray(1 / reference.inverse_depth[rows, columns], dtype=np.float32)
    evidence = [
        check_pair(
            reference,
            maps.get(source),
            u,
            v,
            depth,
            tolerances=settings.tolerances,
            min_confidence=min_confidence * settings.source_confidence_part,
        )
        for source in neighbours
        if len(rows)
    ]
    if not evidence:
        return _samples(scene, reference, index, rows, columns, depth, np.ones(len(rows), np.int32), settings)
    levels = np.stack([e.level for e in evidence])
    passed = passing_level(levels, extra_views=settings.extra_views)
    averaged = levels <= np.maximum(np.where(passed > LEVELS, 0, passed), settings.average_level)
    weights = averaged * np.maximum(np.stack([e.confidence for e in evidence]), _LEAST_CONFIDENCE)
    own = np.maximum(reference.confidence[rows, columns], _LEAST_CONFIDENCE)
    mean_depth = (own * depth + (weights * np.stack([e.depth for e in evidence])).sum(axis=0)) / (
        own + weights.sum(axis=0)
    )
    agreeing = _count(levels <= np.maximum(passed, settings.average_level))
    through = _count(np.stack([e.seen_through for e in evidence]))
    good = (passed <= LEVELS) & ~((through >= settings.min_seen_through) & (through > agreeing))
    views = agreeing[good].astype(np.int32) + 1
    return _samples(scene, reference, index, rows[good], columns[good], mean_depth[good], views, settings)


def _count(views: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """(N,) how many of the S views (S, N): small numbers are added up many at a time."""
    return np.asarray(views.sum(axis=0, dtype=np.uint16))


def passing_level(levels: NDArray[np.uint8], *, extra_views: int) -> NDArray[np.uint8]:
    """Lowest level i at which at least ``i + extra_views`` of the S views agree within level i; 255 where none.

    Parameters
    ----------
    levels: (S, N) uint8, the level of each view. With fewer than ``i + extra_views`` views only levels 1 and 2 are
        tried, and all S views must agree, so that a stereo pair (S = 1) still gives a cloud.

    Returns
    -------
    (N,) uint8.
    """
    sources = len(levels)
    passed = np.full(levels.shape[1], NO_LEVEL, dtype=np.uint8)
    for level in range(min(LEVELS, max(2, sources - extra_views)), 0, -1):
        needed = min(level + extra_views, sources)
        passed[_count(levels <= level) >= needed] = level
    return passed


def _samples(
    scene: Scene,
    reference: DepthMap,
    index: int,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    depth: NDArray[np.floating],
    views: NDArray[np.int32],
    settings: FusionSettings,
) -> Samples:
    rotation = reference.cam_from_world[:3, :3]
    pixels = np.stack([columns, rows, np.ones(len(rows))], axis=1)
    in_camera = (pixels @ np.linalg.inv(reference.intrinsic).T) * depth[:, None].astype(np.float64)
    confidence = reference.confidence[rows, columns]
    return Samples(
        # x_world = R^T (x_cam - t); as rows this is (x_cam - t) R.
        xyz=(in_camera - reference.cam_from_world[:3, 3]) @ rotation,
        rgb=_colours(scene, index, reference, rows, columns),
        normals=pixel_normals(reference, rows, columns, noise=settings.tolerances.relative_depth_step)
        @ rotation.astype(np.float32),
        # Variance of a depth grows with the fourth power of the distance and falls with the number of views.
        weight=np.maximum(confidence, _LEAST_CONFIDENCE) * views / depth.astype(np.float64) ** 4,
        confidence=confidence,
        views=views,
        count=np.ones(len(rows), dtype=np.int32),
    )


def _colours(
    scene: Scene, index: int, reference: DepthMap, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> NDArray[np.float32]:
    if not len(rows):
        return np.empty((0, 3), dtype=np.float32)
    image = read_view_image(scene.views[index])
    grid = reference.grid
    # Averaging over what a depth pixel covers keeps the colours from flickering; odd widths leave the centre in place.
    width, height = (max(1, 2 * int(step / 2) + 1) for step in (grid.step_x, grid.step_y))
    smooth = cv2.blur(image, (width, height))
    x = np.clip(np.rint(columns * grid.step_x + grid.offset_x_px), 0, image.shape[1] - 1).astype(np.intp)
    y = np.clip(np.rint(rows * grid.step_y + grid.offset_y_px), 0, image.shape[0] - 1).astype(np.intp)
    return np.asarray(smooth[y, x], dtype=np.float32)


def _adapt(maps: DepthMaps, settings: FusionSettings) -> tuple[float, float]:
    """Confidence threshold and voxel side from views spread over the scene."""
    confidences, footprints = [], []
    for index in maps.available[:: -(-len(maps.available) // _SAMPLED_VIEWS)]:
        found = maps.get(index)
        valid = found.inverse_depth > 0
        confidences.append(found.confidence[valid][::_PIXEL_STRIDE])
        footprints.append((1 / (found.inverse_depth[valid] * found.intrinsic[0, 0]))[::_PIXEL_STRIDE])
    confidence, footprint = np.concatenate(confidences), np.concatenate(footprints)
    if not len(confidence):
        msg = f"the depth maps in {maps.folder / 'depth'} are empty; run again: fsinfer depth"
        raise CloudError(msg)
    threshold = settings.min_confidence
    if threshold is None:
        threshold = min(settings.confidence_cap, float(np.percentile(confidence, settings.unsure_percent)))
    sure = footprint[confidence >= threshold]
    voxel = settings.voxel or float(np.percentile(sure if len(sure) else footprint, settings.voxel_percent))
    return threshold, voxel


def adapt_tolerances(
    maps: DepthMaps, neighbours: dict[int, tuple[int, ...]], min_confidence: float, settings: FusionSettings
) -> Tolerances:
    """Widen the depth tolerance to the noise of the maps, measured between some views and their first neighbour."""
    loose = Tolerances(relative_depth_step=settings.noise_step_max)
    differences = []
    for index in maps.available[:: -(-len(maps.available) // _NOISE_VIEWS)]:
        reference = maps.get(index)
        rows, columns = np.nonzero((reference.confidence >= min_confidence) & (reference.inverse_depth > 0))
        rows, columns = rows[::_NOISE_STRIDE], columns[::_NOISE_STRIDE]
        if not len(rows) or not neighbours[index]:
            continue
        depth = np.asarray(1 / reference.inverse_depth[rows, columns], dtype=np.float32)
        u, v = columns.astype(np.float32), rows.astype(np.float32)
        source = maps.get(neighbours[index][0])
        found = check_pair(reference, source, u, v, depth, tolerances=loose, min_confidence=min_confidence)
        agrees = found.level <= LEVELS
        differences.append(np.abs(found.depth[agrees] / depth[agrees] - 1))
    pooled = np.concatenate(differences) if differences else np.empty(0)
    noise = float(np.median(pooled)) if len(pooled) else 0.0
    step = max(settings.tolerances.relative_depth_step, min(settings.noise_part * noise, settings.noise_step_max))
    _log.info("neighbouring depth maps differ by %.2f %% (median), tolerance step %.4f", 100 * noise, step)
    return replace(settings.tolerances, relative_depth_step=step)


def _drop_specks(samples: Samples, voxel: float, min_pixels: int) -> Samples:
    if min_pixels <= 1:
        return samples
    return select(samples, sum_within(samples.xyz, _SPECK_CELL * voxel, samples.count) >= min_pixels)

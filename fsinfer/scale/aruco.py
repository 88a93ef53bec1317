"""Metric scale from ArUco markers of known size in the photographs of a scene."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.progress import Progress, silent
from fsinfer.scale.agreement import agreement, markers_of_boards
from fsinfer.scale.blooming import common_blooming, without_blooming
from fsinfer.scale.marker_search import SeenMarkers, look_for_markers
from fsinfer.scale.printed_boards import DICTIONARY
from fsinfer.scale.scale import (
    BoardVerdict,
    MarkerDetails,
    MarkerScale,
    NoUsableMarkersError,
    RejectedMarker,
    Scale,
    check_length,
)
from fsinfer.scale.square_fit import FittedMarker, MarkerSettings, Sighting, find_markers
from fsinfer.scene import Scene

_log = logging.getLogger(__name__)

#: A board is measured well from so many photos; of its largest sightings the least side is told. Source: judgement; a
#: mean of five is twice as good as one.
GOOD_SIGHTINGS = 5
#: Photos and reasons that an error names at most. Source: layout.
_NAMED_PHOTOS, _NAMED_REASONS = 6, 4


def scale_from_aruco(
    scene: Scene,
    length_m: float | Mapping[int, float],
    *,
    dictionary: str = DICTIONARY,
    settings: MarkerSettings | None = None,
    progress: Progress = silent,
    seen: SeenMarkers | None = None,
) -> Scale:
    """Find markers in the images of ``scene`` and the scale that gives their sides the length ``length_m``.

    Each marker is fitted as one square to all its detections. Markers that are no squares in space, or are seen in
    fewer than three views, are rejected. The scale is the weighted mean over the boards that agree, so that one wrong
    print or one false detection among three boards does not move it; see :func:`fsinfer.scale.agreement.agreement`.

    Parameters
    ----------
    length_m: side of the black square, metres, the same for all markers, whose numbers then do not matter; or the
        side of each number, and markers of other numbers are left alone.
    dictionary: such as ``4X4_50``; see :func:`dictionary_names`.
    seen: the markers of that dictionary in these images, where they were looked for before.

    Returns
    -------
    ``details`` holds for each marker its residual and the scale without it, and what was rejected and why.

    Raises
    ------
    NoUsableMarkersError
        No marker can be used.
    ScaleError
        The length is not positive, or the dictionary is unknown.
    ImageError
        A scene image cannot be read.
    """
    for length in length_m.values() if isinstance(length_m, Mapping) else (length_m,):
        check_length(length, "the side of the markers")
    settings = settings or MarkerSettings()
    if seen is None or seen.dictionary != dictionary:
        seen = look_for_markers(scene, dictionary=dictionary, settings=settings, progress=progress)
    sightings = [one for one in seen.sightings if not isinstance(length_m, Mapping) or one.marker_id in length_m]
    blooming = common_blooming(
        [sighting.bloom_px for sighting in sightings],
        fewest=settings.min_blooming,
        least_std_px=settings.least_bloom_std_px,
        varies=settings.bloom_varies,
    )
    if blooming is not None:
        shift_px = blooming.shift_px
        sightings = [replace(one, corners_px=without_blooming(one.corners_px, shift_px)) for one in sightings]
    projections = [view.camera.intrinsic @ view.camera.cam_from_world[:3] for view in scene.views]
    centers = np.array([view.camera.center for view in scene.views])
    markers: list[FittedMarker] = []
    rejected: list[RejectedMarker] = []
    for number in sorted({sighting.marker_id for sighting in sightings}):
        own = [sighting for sighting in sightings if sighting.marker_id == number]
        found, reasons = find_markers(own, projections, centers, settings)
        markers += found
        rejected += [RejectedMarker(id=number, reason=reason) for reason in reasons]
    if not markers:
        raise NoUsableMarkersError(_nothing_found(scene, sightings, rejected, dictionary, settings), rejected)
    numbers = [marker.sightings[0].marker_id for marker in markers]
    lengths = [length_m[number] if isinstance(length_m, Mapping) else length_m for number in numbers]
    combined, rel_std, each = _combine(scene, markers, np.array(lengths), settings)
    # What is left of blooming moves every edge the same way: no averaging over views or markers takes it out.
    side_px = float(np.mean([sighting.side_px for marker in markers for sighting in marker.sightings]))
    edge_rel_std = 2 * (settings.edge_std_px if blooming is None else blooming.std_px) / side_px
    rel_std = float(np.hypot(rel_std, edge_rel_std))
    details = MarkerDetails(
        photos_searched=len(scene.views),
        photos_with_markers=len({sighting.view for sighting in sightings}),
        dictionary=dictionary,
        length_m=None if isinstance(length_m, Mapping) else length_m,
        rejected=tuple(rejected),
        mean_side_px=side_px,
        edge_rel_std=edge_rel_std,
        edge_shift_px=None if blooming is None else blooming.shift_px,
        markers=each,
    )
    _log.info("scale %.6g m per unit from %d markers, %.2f %%", combined, len(markers), 100 * rel_std)
    return Scale(m_per_unit=combined, source="aruco", rel_std=rel_std, details=details)


def _nothing_found(
    scene: Scene,
    sightings: Sequence[Sighting],
    rejected: Sequence[RejectedMarker],
    dictionary: str,
    settings: MarkerSettings,
) -> str:
    names = [view.name for view in scene.views]
    if not sightings:
        return (
            f"no ArUco marker of {dictionary} in the {len(names)} photos {names[0]} to {names[-1]} of {scene.folder}; "
            "check --aruco-dictionary, take photos nearer to the markers, or give --endpoints or --scale"
        )
    seen = sorted({names[sighting.view] for sighting in sightings})
    shown = ", ".join(seen[:_NAMED_PHOTOS]) + (", ..." if len(seen) > _NAMED_PHOTOS else "")
    why = "; ".join(f"marker {entry.id}: {entry.reason}" for entry in rejected[:_NAMED_REASONS])
    return (
        f"no ArUco marker of {dictionary} can be used, of {len(sightings)} found in {shown} ({why}); each marker must "
        f"be seen in {settings.min_views} photos from different places, flat and sharp, or give --endpoints or --scale"
    )


def _combine(
    scene: Scene, markers: Sequence[FittedMarker], lengths_m: NDArray[np.float64], settings: MarkerSettings
) -> tuple[float, float, tuple[MarkerScale, ...]]:
    """Metres per unit by all markers, its relative standard deviation without blooming, and each marker's say."""
    scales = lengths_m / np.array([marker.side_units for marker in markers])
    rel_stds = np.array([marker.side_rel_std for marker in markers])
    centers = np.array([marker.corners.mean(axis=0) for marker in markers])
    normals = np.array([_normal(marker.corners) for marker in markers])
    numbers = [marker.sightings[0].marker_id for marker in markers]
    boards = markers_of_boards(numbers, centers, normals, np.array([marker.side_units for marker in markers]))
    # Both faces of a board stand in the same place and come from the same printer: they are one opinion. So is one that
    # a drift of the walk shows at two places, which would outvote the others with its own print.
    shares = [(1 / rel_stds[own] ** 2) / (1 / rel_stds[own] ** 2).sum() for own in boards]
    board_scales = np.array([share @ scales[own] for share, own in zip(shares, boards, strict=True)])
    board_stds = np.array([np.sqrt(share**2 @ rel_stds[own] ** 2) for share, own in zip(shares, boards, strict=True)])
    together = agreement(board_scales, board_stds, settings)
    combined = together.value
    contradicts = not together.decided
    each: list[MarkerScale | None] = [None] * len(markers)
    for board, own in enumerate(boards):
        others = np.arange(len(boards)) != board
        without = agreement(board_scales[others], board_stds[others], settings).value if others.any() else None
        verdict = BoardVerdict.contradicted if contradicts else BoardVerdict.agrees
        verdict = verdict if together.agrees[board] else BoardVerdict.outvoted
        for index in own:
            marker = markers[index]
            x, y, z = centers[index]
            each[index] = MarkerScale(
                id=marker.sightings[0].marker_id,
                views=tuple(scene.views[sighting.view].name for sighting in marker.sightings),
                center=(float(x), float(y), float(z)),
                length_m=float(lengths_m[index]),
                side_units=marker.side_units,
                m_per_unit=float(scales[index]),
                rel_std=float(rel_stds[index]),
                residual_rel=float(marker.side_units * combined / lengths_m[index] - 1),
                residual_mm=float(1000 * (marker.side_units * combined - lengths_m[index])),
                error_px=marker.error_px,
                near_side_px=float(np.sort([one.side_px for one in marker.sightings])[-GOOD_SIGHTINGS:][0]),
                angle_deg=marker.angle_deg,
                leave_one_out_m_per_unit=without,
                leave_one_out_rel=None if without is None else without / combined - 1,
                normal=_normal(marker.corners),
                verdict=verdict,
            )
    return combined, together.rel_std, tuple(one for one in each if one is not None)


def _normal(corners: NDArray[np.float64]) -> tuple[float, float, float]:
    """Unit vector towards who sees the print: its corners run clockwise before them."""
    across = np.cross(corners[2] - corners[0], corners[3] - corners[1])
    x, y, z = -across / np.linalg.norm(across)
    return float(x), float(y), float(z)

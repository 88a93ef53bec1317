"""The placed photos as a scene on the disk: straightened images, cameras, source views, the COLMAP model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import PosesError
from fsinfer.io.exif import gravity_exif
from fsinfer.io.images import read_reduced, write_image
from fsinfer.poses.adjustment.adjust import PhotoAdjustment
from fsinfer.poses.boards import BoardSighting, corners_of_pixels
from fsinfer.poses.model_files import write_model
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.sparse import sparse_of
from fsinfer.poses.undistortion import (
    NoWayBackError,
    intrinsic_of,
    maps_of_photo,
    straightened,
    undistort,
    undistort_model,
    undistortion_maps,
)
from fsinfer.poses.view_selection import depth_range, select_views
from fsinfer.progress import Progress
from fsinfer.scale.markers_seen import MarkersSeen, write_markers_seen
from fsinfer.scale.square_fit import MarkerSettings
from fsinfer.scene import Camera, write_camera, write_pairs
from fsinfer.threads import beside, in_order

_Places = tuple[tuple[int, NDArray[np.float64]], ...]


@dataclass(frozen=True, kw_only=True)
class Photo:
    """A photo to be placed: ``name`` in the scene and ``file`` in the work folder (plain letters for COLMAP)."""

    name: str
    source: Path
    file: str


def write_scene(
    model: Any,
    photos: Sequence[Photo],
    out: Path,
    settings: PoseSettings,
    adjustment: PhotoAdjustment,
    progress: Progress,
    *,
    sightings: Sequence[BoardSighting] | None = None,
) -> tuple[str, ...]:
    """Write images, cams, pair.txt and sparse of a refined model; returns the names of the views.

    ``sightings`` are all markers that the photos show, which are told in ``markers_seen.json``; None where nobody
    looked for them at this size.
    """
    by_file = {photo.file: photo for photo in photos}
    lenses = undistort_model(model)
    image_ids = {by_file[model.images[i].name].name: i for i in model.reg_image_ids()}
    files = {name: model.images[i].name for name, i in image_ids.items()}
    for name, image_id in image_ids.items():
        model.images[image_id].name = f"{name}.jpg"
    maps = {i: undistortion_maps(lens, model.cameras[i]) for i, lens in lenses.items()}
    of_photo = _by_file(sightings or ())

    def straighten(name: str) -> _Places | None:
        image_id, source = image_ids[name], by_file[files[name]].source
        camera_id = model.images[image_id].camera_id
        map_of = maps[camera_id]
        lens, pinhole = lenses[camera_id], model.cameras[camera_id]
        if image_id in adjustment.effects:
            map_of = maps_of_photo(map_of, lens, pinhole, adjustment.effects[image_id])
        pixels = undistort(read_reduced(source, settings.longest_px), map_of)
        write_image(out / "images" / f"{name}.jpg", pixels, quality=settings.jpeg_quality, exif=gravity_exif(source))
        found = []
        for one in of_photo.get(files[name], ()):
            try:
                corners = straightened(corners_of_pixels(one), map_of, lens, pinhole)
            except NoWayBackError:
                return None  # to be searched once more
            if corners is not None:
                found.append((one.number, corners))
        return tuple(found)

    views = sorted(image_ids)
    markers: dict[str, _Places] = {}
    # The images are the work of libraries; meanwhile Python chooses each view's neighbours.
    with beside(lambda _: _cameras_and_pairs(model, image_ids, settings)) as chosen:
        progress(0, len(views), "undistorting")
        straight = in_order(straighten, views, settings.photo_threads)
        for done, (name, seen) in enumerate(zip(views, straight, strict=True), 1):
            if seen is not None:
                markers[name] = seen
            progress(done, len(views), "undistorting")
        cameras, pairs = chosen()
    for name, camera in cameras.items():
        write_camera(out / "cams" / f"{name}_cam.txt", camera)
    write_pairs(out / "pair.txt", pairs)
    write_model(model, out / "sparse")
    if sightings is not None:
        least = MarkerSettings.min_side_px
        write_markers_seen(out, MarkersSeen(dictionary=settings.dictionary, min_side_px=least, places=markers))
    return tuple(image_ids)


def _cameras_and_pairs(
    model: Any, image_ids: Mapping[str, int], settings: PoseSettings
) -> tuple[dict[str, Camera], dict[int, list[tuple[int, float]]]]:
    """The camera of each view with its depth range, and its sources."""
    sparse = sparse_of(model)
    cameras = {}
    for name, image_id in image_ids.items():
        image = model.images[image_id]
        pinhole = model.cameras[image.camera_id]
        pose = np.eye(4)
        pose[:3] = image.cam_from_world().matrix()
        intrinsic = intrinsic_of(pinhole)
        size = (int(pinhole.width), int(pinhole.height))
        depths = depth_range(sparse, sparse.observations[name], intrinsic, pose, size, settings=settings.selection)
        if depths is None:
            # drop_blind_views has taken such views out.
            msg = f"{name} sees no point of the model; take it out of the photos and run again"
            raise PosesError(msg)
        cameras[name] = Camera(intrinsic=intrinsic, cam_from_world=pose, depth_min=depths[0], depth_max=depths[1])
    return cameras, select_views(sparse, cameras, settings.sources, settings=settings.selection)


def _by_file(sightings: Sequence[BoardSighting]) -> Mapping[str, list[BoardSighting]]:
    found: dict[str, list[BoardSighting]] = {}
    for sighting in sightings:
        found.setdefault(sighting.file, []).append(sighting)
    return found

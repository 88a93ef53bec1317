"""A foreign scene as a scene folder of ours: undistorted images, cameras, source views, what is known of its unit."""

from __future__ import annotations

import json
import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.importers.foreign import Floats, ForeignPhoto, ForeignScene, centers_of
from fsinfer.importers.lens import Lens, pinhole_of, undistortion_maps
from fsinfer.importers.views import GeometricSettings, range_without_points, scores_without_points
from fsinfer.io.exif import gravity_exif
from fsinfer.io.files import copy_file, write_text
from fsinfer.io.images import image_size, is_upright_jpeg_or_png, read_image, write_image
from fsinfer.io.turned import sensor_exif
from fsinfer.notices.numbers import counted, noun
from fsinfer.poses.sparse import SparseModel
from fsinfer.poses.undistortion import undistort
from fsinfer.poses.view_selection import SelectionSettings, choose_sources, depth_range, select_views
from fsinfer.progress import Progress, silent
from fsinfer.scene import IMAGE_SUFFIXES, Camera, write_camera, write_pairs

_log = logging.getLogger(__name__)

#: What is known of an imported scene, beside its images.
ORIGIN_FILE = "import.json"
#: Names that a warning tells. Source: layout.
_NAMES_TOLD = 5


@dataclass(frozen=True, kw_only=True)
class ImportSettings:
    """How a scene folder is made of cameras from elsewhere.

    Attributes
    ----------
    selection: of source views and depth ranges by tie points.
    geometry: of both where there are none.
    sources: at most this many source views in ``pair.txt``. Source: MVSNet (Yao et al. 2018) writes 10.
    least_points: with fewer tie points in all, geometry decides. Source: judgement; a scene has thousands.
    jpeg_quality: of the undistorted images. Source: numerics; the coding is not seen.
    """

    selection: SelectionSettings = field(default_factory=SelectionSettings)
    geometry: GeometricSettings = field(default_factory=GeometricSettings)
    sources: int = 10
    least_points: int = 100
    jpeg_quality: int = 95


@dataclass(frozen=True, kw_only=True)
class ImportedScene:
    """What was made of a foreign scene.

    Attributes
    ----------
    scene: folder in MVSNet format.
    program: that the scene is from.
    photos: how many have a camera.
    left_out: names of those without a pose or a file.
    tie_points: that decided source views and depth ranges; 0 where geometry did.
    metric: the unit is the metre.
    z_up: the world's z points up.
    origin: (3,) what was subtracted from the coordinates of the program.
    remarks: what a user has to know of it.
    """

    scene: Path
    program: str
    photos: int
    left_out: tuple[str, ...]
    tie_points: int
    metric: bool
    z_up: bool
    origin: tuple[float, float, float]
    remarks: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class SceneOrigin:
    """What ``import.json`` tells of a scene folder."""

    program: str
    metric: bool
    z_up: bool


def read_origin(folder: Path) -> SceneOrigin | None:
    """Where an imported scene folder is from; None for one that was not imported.

    Raises
    ------
    SceneError
        ``import.json`` is damaged.
    """
    path = folder / ORIGIN_FILE
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        return SceneOrigin(program=str(values["program"]), metric=values["metric"] is True, z_up=values["z_up"] is True)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, KeyError) as error:
        msg = (
            f"{path} is damaged ({error}); delete the folder {folder} and run fsinfer depth on the original scene again"
        )
        raise SceneError(msg) from error


def write_scene(
    foreign: ForeignScene, out: Path, *, settings: ImportSettings | None = None, progress: Progress = silent
) -> ImportedScene:
    """Write ``out`` as a scene folder; ``import.json`` comes last.

    Images without distortion are copied, others resampled to the largest pinhole image without a black border. Source
    views and depth ranges come from tie points where the format has them, else from where the cameras stand.

    Raises
    ------
    SceneError
        A photograph does not fit its camera, or nothing can be seen from two places.
    ImageError
        A photograph cannot be read.
    OutputError
        ``out`` cannot be written.
    """
    settings = settings or ImportSettings()
    fitted = [(photo, *_fit(photo)) for photo in foreign.photos]
    pinholes = {photo.name: pinhole_of(lens) for photo, lens, _ in fitted}
    cameras, tie_points = _cameras(foreign, pinholes, settings)
    maps: tuple[Lens, tuple[NDArray[np.float32], NDArray[np.float32]]] | None = None
    for done, (photo, lens, upright) in enumerate(fitted):
        progress(done, len(fitted), "undistorting")
        if lens.is_pinhole:
            _copy(photo.path, out / "images" / photo.name, upright=upright, quality=settings.jpeg_quality)
            continue
        if maps is None or maps[0] != lens:
            maps = (lens, undistortion_maps(lens, pinholes[photo.name]))
        pixels = undistort(read_image(photo.path, upright=upright), maps[1])
        exif = _exif(photo.path, upright=upright)
        write_image(out / "images" / f"{photo.name}.jpg", pixels, quality=settings.jpeg_quality, exif=exif)
    names = sorted(cameras)
    for name in names:
        write_camera(out / "cams" / f"{name}_cam.txt", cameras[name])
    write_pairs(out / "pair.txt", _sources(foreign.sparse if tie_points else None, cameras, pinholes, settings))
    progress(len(fitted), len(fitted), "undistorting")
    result = ImportedScene(
        scene=out,
        program=foreign.program,
        photos=len(fitted),
        left_out=foreign.left_out,
        tie_points=tie_points,
        metric=foreign.metric,
        z_up=foreign.z_up,
        origin=foreign.origin,
        remarks=foreign.remarks,
    )
    record = {
        "program": result.program,
        "photos": result.photos,
        "left_out": list(result.left_out),
        "tie_points": result.tie_points,
        "metric": result.metric,
        "z_up": result.z_up,
        "origin": list(result.origin),
        "remarks": list(result.remarks),
    }
    write_text(out / ORIGIN_FILE, json.dumps(record, indent=1, ensure_ascii=False) + "\n")
    return result


def _fit(photo: ForeignPhoto) -> tuple[Lens, bool]:
    """The lens for the pixels of the file, and whether these are meant upright."""
    stored, turned = (image_size(photo.path, upright=upright) for upright in (False, True))
    lens = photo.lens
    # Other programs calibrate what the sensor saw, whatever the tag says of how to hold it; some turn it first.
    for size, upright in ((stored, False), (turned, True)):
        if size == (lens.width, lens.height):
            return lens, upright
    try:
        return lens.of_size(*stored), False
    except SceneError as error:
        msg = f"{photo.path}: {error}; give the folder of the photographs that were registered with --images"
        raise SceneError(msg) from error


def _copy(source: Path, target: Path, *, upright: bool, quality: int) -> None:
    if is_upright_jpeg_or_png(source) and source.suffix in IMAGE_SUFFIXES:
        # A photograph that is cut short is told by the name that its owner knows, not by that of the copy, which comes
        # back after it was deleted. Decoded as small as may be, this takes half of the time.
        read_image(source, upright=upright, at_least_px=1)
        copy_file(source, target.with_name(f"{target.name}{source.suffix.lower()}"))
    else:
        pixels = read_image(source, upright=upright)
        exif = _exif(source, upright=upright)
        write_image(target.with_name(f"{target.name}.jpg"), pixels, quality=quality, exif=exif)


def _exif(photo: Path, *, upright: bool) -> bytes | None:
    """What tells where down is in the picture: without it the cloud of photographs held upright lies on its side."""
    return gravity_exif(photo) if upright else sensor_exif(photo)


def _cameras(
    foreign: ForeignScene, pinholes: dict[str, Lens], settings: ImportSettings
) -> tuple[dict[str, Camera], int]:
    """The cameras with their depth ranges, and how many tie points decided these."""
    sparse = foreign.sparse
    seen = {} if sparse is None else {name: np.unique(ranks) for name, ranks in sparse.observations.items()}
    used = sparse is not None and len(sparse.points) >= settings.least_points
    fallback: tuple[float, float] | None = None
    ranges: dict[str, tuple[float, float]] = {}
    if sparse is not None and used:
        for photo in foreign.photos:
            lens = pinholes[photo.name]
            size = (lens.width, lens.height)
            ranks = seen.get(photo.name, np.zeros(0, np.int64))
            found = depth_range(sparse, ranks, lens.intrinsic, photo.cam_from_world, size, settings=settings.selection)
            if found is not None and np.isfinite(found).all() and found[0] > 0:
                ranges[photo.name] = found
        if ranges:
            # A view that sees no tie point: between what its neighbours see nearest and farthest, in the middle.
            near, far = (float(np.median([ends[end] for ends in ranges.values()])) for end in (0, 1))
            fallback = (near, far)
    if fallback is None:
        used = False
        fallback = range_without_points(centers_of(foreign.photos), metric=foreign.metric, settings=settings.geometry)
    cameras = {}
    for photo in foreign.photos:
        near, far = ranges.get(photo.name, fallback)
        cameras[photo.name] = Camera(
            intrinsic=pinholes[photo.name].intrinsic,
            cam_from_world=photo.cam_from_world,
            depth_min=near,
            depth_max=far,
        )
    return cameras, len(sparse.points) if sparse is not None and used else 0


def _sources(
    sparse: SparseModel | None, cameras: dict[str, Camera], pinholes: dict[str, Lens], settings: ImportSettings
) -> dict[int, list[tuple[int, float]]]:
    names = sorted(cameras)
    if sparse is not None:
        chosen = select_views(sparse, cameras, settings.sources, settings=settings.selection)
        if all(chosen.values()):
            return chosen
    else:
        chosen = {view: [] for view in range(len(names))}
    sizes = [(pinholes[name].width, pinholes[name].height) for name in names]
    scores: Floats = scores_without_points([cameras[name] for name in names], sizes, settings.geometry)
    by_place = choose_sources(scores, settings.sources)
    return {view: chosen[view] or by_place[view] for view in range(len(names))}


def told(imported: ImportedScene) -> list[str]:
    """What to tell the user of an import, a sentence each."""
    sentences = [f"{imported.program}: {remark}" for remark in imported.remarks]
    if imported.left_out:
        names = ", ".join(imported.left_out[:_NAMES_TOLD]) + (", ..." if len(imported.left_out) > _NAMES_TOLD else "")
        many = counted(len(imported.left_out), "photograph has", "photographs have")
        which = noun(len(imported.left_out), "is", "are")
        sentences.append(f"{many} no pose or no file and {which} left out: {names}")
    if not imported.tie_points:
        sentences.append(
            f"{imported.program} gives no tie points: depth ranges and source views are taken from where the cameras "
            "stand"
        )
    return sentences

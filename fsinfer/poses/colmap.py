"""COLMAP's SIFT features, and its mapping, on the CPU.

Features are looked for in small batches, so that progress can be told, a key press can stop it, and a repetition after
a kill goes on from the database.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fsinfer.errors import PosesError
from fsinfer.poses.colmap_calls import SEED, ColmapError, call, copy_for_mapping, open_database, require_pycolmap
from fsinfer.poses.enlarged import find_in_enlarged
from fsinfer.poses.settings import DOUBLED, PoseSettings
from fsinfer.progress import Progress

#: Photos handed to COLMAP at a time. Source: numerics.
_PHOTOS_PER_BATCH = 16
#: All photos are adjusted together when so many times more have come, not at every tenth (COLMAP: 1.1). Source:
#: numerics; renders only, docs/trials-speed.md: with what follows two walks of 200 photos were mapped in half of the
#: time of 1.6 and COLMAP's own ends, all photos placed and as exactly.
_ADJUST_GROWTH = 2.5
#: While photos are placed an adjustment ends where a step gains less than this share of its error: of a photo and its
#: neighbours, and of all. The model is adjusted with more care afterwards. Source: as above.
_ENOUGH_OF_NEIGHBOURS, _ENOUGH_OF_ALL = 1e-3, 1e-4
#: All are adjusted and filtered so many times at most while something changes (COLMAP: 5), neighbours so many (COLMAP:
#: 2). Source: numerics; renders only, docs/trials-speed.md.
_ROUNDS_OF_ALL, _ROUNDS_OF_NEIGHBOURS = 2, 1
#: What mapping is called while it goes on.
PLACING = "placing photos"
#: A model from a pair to begin with that was given is enough with this share of the photos. Source: judgement.
_ENOUGH_PLACED = 0.5
#: Parts that the mapper begins at most, of which the largest counts. Source: numerics.
_MOST_PARTS = 5


@contextmanager
def colmap_errors(what: str, work: Path) -> Iterator[None]:
    """Keep COLMAP from writing on the terminal, and turn its own failures into :class:`PosesError`.

    What our code raises between its calls and in its callbacks passes: it is a fault of ours and looks like one.
    """
    require_pycolmap()
    import pycolmap

    levels = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    except ColmapError as error:
        msg = f"{what} failed in COLMAP ({error}); delete {work} and run the same command again"
        raise PosesError(msg) from error
    finally:
        pycolmap.logging.minloglevel = levels


def extract_features(
    database: Path,
    images: Path,
    cameras: Mapping[str, Sequence[str]],
    settings: PoseSettings,
    progress: Progress,
    *,
    step: str = "finding features",
) -> None:
    """Find SIFT features in every photo that the database has none of yet.

    Parameters
    ----------
    database: made when missing.
    images: folder of the files named in ``cameras``.
    cameras: ``{camera: file names}``; the photos of one camera share one calibration.
    """
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = settings.thread_count
    total = sum(len(names) for names in cameras.values())
    done = 0
    for names in cameras.values():
        camera_id = _enter(database, images, names, settings)
        small = camera_id is not None and _longer_side_px(database, camera_id, settings) < settings.enlarge_below_px
        copied = small and settings.enlargement != DOUBLED
        options.max_image_size = round(settings.max_image_size * (settings.enlargement if copied else 1))
        options.sift.first_octave = -1 if small and not copied else 0
        options.sift.max_num_features = settings.max_enlarged_features if small else settings.max_features
        for start in range(0, len(names), _PHOTOS_PER_BATCH):
            batch = list(names[start : start + _PHOTOS_PER_BATCH])
            progress(done, total, step)
            missing = _without_features(database, batch)
            if missing and copied:
                find_in_enlarged(database, images, missing, settings.enlargement, options, settings.thread_count)
            elif missing:
                reader = _reader(settings)
                if camera_id is not None:
                    reader.existing_camera_id = camera_id
                call(
                    pycolmap.extract_features,
                    database,
                    images,
                    image_names=missing,
                    camera_mode=pycolmap.CameraMode.SINGLE,
                    reader_options=reader,
                    extraction_options=options,
                    device=pycolmap.Device.cpu,
                )
            done += len(batch)
    progress(total, total, step)


def _enter(database: Path, images: Path, names: Sequence[str], settings: PoseSettings) -> int | None:
    """Enter those photos of one camera into the database, in their order, that it does not have; the camera's number.

    COLMAP numbers photos in the order in which its threads finish them, and everything after depends on the numbers:
    entered in order first, two runs on one machine are alike. It decodes each one for what only the first has to tell.
    """
    import pycolmap

    for name in names:
        if _has_any(database, names):
            break
        call(
            pycolmap.import_images,
            database,
            images,
            camera_mode=pycolmap.CameraMode.SINGLE,
            image_names=[name],  # one that COLMAP cannot read enters nothing
            options=_reader(settings),
        )
    with open_database(database) as opened:
        entered = [image for name in names if (image := opened.read_image_with_name(name)) is not None]
        if not entered:
            return None  # whoever looks for features says so
        first, there = entered[0], {image.name for image in entered}
        rig_id = opened.read_frame(first.frame_id).rig_id
        # A photo without its frame, where the program was ended between the two, could never be mapped.
        with pycolmap.DatabaseTransaction(opened.itself):
            for name in names:
                if name in there:
                    continue
                image = pycolmap.Image(name=name, camera_id=first.camera_id)
                image.image_id = opened.write_image(image)
                frame = pycolmap.Frame()
                frame.rig_id = rig_id
                frame.add_data_id(image.data_id)
                opened.write_frame(frame)
        return int(first.camera_id)


def _reader(settings: PoseSettings) -> Any:
    import pycolmap

    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    reader.default_focal_length_factor = settings.default_focal_factor
    return reader


def _has_any(database: Path, names: Sequence[str]) -> bool:
    with open_database(database) as opened:
        return any(opened.read_image_with_name(name) is not None for name in names)


def _longer_side_px(database: Path, camera_id: int, settings: PoseSettings) -> int:
    """Of the photos as features are looked for in them."""
    with open_database(database) as opened:
        camera = opened.read_camera(camera_id)
    return min(max(int(camera.width), int(camera.height)), settings.max_image_size)


def _without_features(database: Path, names: Sequence[str]) -> list[str]:
    def has_features(name: str) -> bool:
        image = opened.read_image_with_name(name)
        return (
            image is not None and opened.exists_keypoints(image.image_id) and opened.exists_descriptors(image.image_id)
        )

    with open_database(database) as opened:
        return [name for name in names if not has_features(name)]


def reconstruct(
    database: Path,
    images: Path,
    out: Path,
    settings: PoseSettings,
    progress: Progress,
    start: Any = None,
    only: Sequence[str] = (),
    known_cameras: Sequence[int] = (),
    beginnings: Sequence[tuple[int, int]] = (),
    least_points: int | None = None,
    step: str = PLACING,
) -> list[Any]:
    """Map the photos; returns the ``pycolmap.Reconstruction`` of each connected part, the largest first.

    With a model to ``start`` from, the incremental mapper goes on with the photos that it has not placed. ``only``:
    the files of the photos that are to be mapped; none = all. ``known_cameras``: ids of those whose calibration in the
    database stands. ``beginnings``: pairs, by COLMAP's numbers, to begin with, the best first; where none is given, or
    the first that makes a model makes one of less than half of the photos, COLMAP looks for one. ``least_points``: that
    must agree on the place of a photo; None: COLMAP's.
    """
    import pycolmap

    out.mkdir(parents=True, exist_ok=True)
    total = 0
    with open_database(database) as opened:
        total = int(opened.num_images())
        if opened.num_verified_image_pairs() == 0:
            return []
    progress(0, total, step)
    if settings.mapper == "global":
        options = pycolmap.GlobalPipelineOptions()
        options.num_threads = settings.thread_count
        options.random_seed = SEED
        models = call(pycolmap.global_mapping, database, images, out, options=options)
    elif settings.mapper == "incremental":
        before = placed = 0 if start is None else int(start.num_reg_images())

        def next_photo() -> None:
            nonlocal placed
            placed = min(placed + 1, total)
            progress(placed, total, step)

        known = out / "start"
        if start is not None:
            known.mkdir(exist_ok=True)
            call(start.write_binary, known)

        def mapped(beginning: tuple[int, int] | None = None) -> Any:
            options = _incremental(settings, only, known_cameras)
            if least_points is not None:
                options.mapper.abs_pose_min_num_inliers = least_points
            options.multiple_models = start is None and beginning is None
            if beginning is not None:
                options.init_image_id1, options.init_image_id2 = beginning
                # A pair that COLMAP does not like is not tried two hundred times.
                options.init_num_trials = 1
            return call(
                pycolmap.incremental_mapping,
                database,
                images,
                out,
                options=options,
                input_path="" if start is None else known,
                next_image_callback=next_photo,
            )

        models = next(filter(None, map(mapped, beginnings if start is None else ())), {})
        if max((model.num_reg_images() for model in models.values()), default=0) < _ENOUGH_PLACED * total:
            placed = before
            models = mapped()
    else:
        msg = f"there is no mapper {settings.mapper!r}; choose incremental or global"
        raise PosesError(msg)
    progress(total, total, step)
    return sorted(models.values(), key=lambda model: (-model.num_reg_images(), -model.num_points3D()))


def _incremental(settings: PoseSettings, only: Sequence[str], known_cameras: Sequence[int]) -> Any:
    import pycolmap

    incremental = pycolmap.IncrementalPipelineOptions()
    # With several threads sums come out in another order now and then, another model with them (on 23 photos every
    # fifth time, cameras 0.007 % apart), and a run that was stopped would not end as one that was not. 300 photos
    # take 74 processor seconds, 67 s with two threads.
    incremental.num_threads = 1
    incremental.random_seed = SEED
    incremental.min_model_size = settings.min_registered
    incremental.max_num_models = _MOST_PARTS
    # Without points that add nothing; the model is refined once more at the end.
    incremental.ba_global_frames_ratio = incremental.ba_global_points_ratio = _ADJUST_GROWTH
    incremental.ba_local_function_tolerance = _ENOUGH_OF_NEIGHBOURS
    incremental.ba_global_function_tolerance = _ENOUGH_OF_ALL
    incremental.ba_global_max_refinements = _ROUNDS_OF_ALL
    incremental.ba_local_max_refinements = _ROUNDS_OF_NEIGHBOURS
    incremental.mapper.ba_global_ignore_redundant_points3D = True
    # Colours are taken from the photographs at fusion.
    incremental.extract_colors = False
    incremental.image_names = list(only)
    incremental.constant_cameras = incremental.mapper.constant_cameras = set(known_cameras)
    return incremental


def with_calibration(database: Path, cameras: Sequence[Any], copy: Path) -> Path:
    """A copy of the database in which these ``pycolmap.Camera`` have their calibration; returns its path."""
    import pycolmap

    copy_for_mapping(database, copy)
    with open_database(copy) as opened:
        for camera in cameras:
            calibrated = pycolmap.Camera(camera.todict())
            calibrated.has_prior_focal_length = True
            opened.update_camera(calibrated)
    return copy


def triangulate(model: Any, database: Path, images: Path, out: Path) -> Any:
    """``model`` (a ``pycolmap.Reconstruction``) with the points that all matches of its photos give at their places."""
    import pycolmap

    out.mkdir(parents=True, exist_ok=True)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = SEED
    options.extract_colors = False
    return call(
        pycolmap.triangulate_points,
        model,
        database,
        images,
        out,
        clear_points=False,
        options=options,
        refine_intrinsics=True,
    )

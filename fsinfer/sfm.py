"""Structure from motion with COLMAP's SIFT on the CPU: features, matches, mapping.

Everything is done in small batches, so that progress can be told, a key press can stop it, and a repetition after a
kill goes on from the database.
"""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from fsinfer.errors import PosesError
from fsinfer.progress import Progress

_log = logging.getLogger(__name__)

# COLMAP draws random samples; a fixed seed makes two runs on one machine alike.
SEED = 1


@dataclass(frozen=True, kw_only=True)
class PoseSettings:
    """How poses are found.

    Attributes
    ----------
    max_image_size: longer side at which features are found, pixels. 23 photos of 2016x1512 at 1600: all registered.
    first_octave: -1 doubles the photo before looking for features (COLMAP's default), 0 does not.
    max_features: per photo; COLMAP's default is 8192, and matching time grows with its square.
    exhaustive_up_to: with at most this many photos every pair is matched; above, photos are taken to be in the order
        of walking (names).
    overlap: above that, each photo is matched with this many next ones, and with those 2, 4, 8, ... further on.
    loop_stride: and every so many-th photo with every other such photo, so that a walk round a tree or plot closes.
    default_focal_factor: focal length over longer side where the photo does not tell; 0.9 is a phone's main camera
        (26-28 mm equivalent is 0.72-0.78, video is cropped). It is refined from the photos.
    mapper: ``incremental`` (robust) or ``global`` (GLOMAP; as good and as fast on 23 photos).
    min_registered: fewer photos than this in the largest model are no result.
    min_inliers: matches that a pair needs after the geometric check (COLMAP's default is 15).
    sources: at most this many source views in ``pair.txt`` (MVSNet writes 10).
    jpeg_quality: of the undistorted images.
    threads: 0 for one per core.
    """

    max_image_size: int = 1600
    first_octave: int = -1
    max_features: int = 6000
    exhaustive_up_to: int = 60
    overlap: int = 12
    loop_stride: int = 5
    default_focal_factor: float = 0.9
    mapper: str = "incremental"
    min_registered: int = 3
    min_inliers: int = 15
    sources: int = 10
    jpeg_quality: int = 95
    threads: int = 0

    @property
    def thread_count(self) -> int:
        """Threads really used."""
        return self.threads if self.threads > 0 else (os.cpu_count() or 1)


# Pairs and photos handed to COLMAP at a time: large enough that its indices are built once for many pairs.
_PHOTOS_PER_BATCH = 8
_PAIRS_PER_BATCH = 120
# Pairs that close loops, for each photo at most: their number must not grow with the square of the photos. At the
# default stride of 5 this is reached with 200 photos.
_LOOPS_PER_PHOTO = 4.0


@contextmanager
def colmap_errors(what: str, work: Path) -> Iterator[None]:
    """Keep COLMAP from writing on the terminal, and turn its exceptions into :class:`PosesError`."""
    import pycolmap

    levels = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    except (RuntimeError, ValueError, IndexError) as error:
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
    options.max_image_size = settings.max_image_size
    options.sift.max_num_features = settings.max_features
    options.sift.first_octave = settings.first_octave
    total = sum(len(names) for names in cameras.values())
    done = 0
    for names in cameras.values():
        if _camera_of(database, names) is None:
            # COLMAP numbers photos in the order in which its threads finish them, and everything after depends on the
            # numbers: entered in order first, two runs on one machine are alike.
            with pycolmap.Database.open(database):
                pass  # makes the file
            pycolmap.import_images(
                database,
                images,
                camera_mode=pycolmap.CameraMode.SINGLE,
                image_names=list(names),
                options=_reader(settings),
            )
        for start in range(0, len(names), _PHOTOS_PER_BATCH):
            batch = list(names[start : start + _PHOTOS_PER_BATCH])
            progress(done, total, "finding features")
            camera_id = _camera_of(database, names)
            missing = [name for name in batch if not _has_features(database, name)]
            if missing:
                reader = _reader(settings)
                if camera_id is not None:
                    reader.existing_camera_id = camera_id
                pycolmap.extract_features(
                    database,
                    images,
                    image_names=missing,
                    camera_mode=pycolmap.CameraMode.SINGLE,
                    reader_options=reader,
                    extraction_options=options,
                    device=pycolmap.Device.cpu,
                )
            done += len(batch)
    progress(total, total, "finding features")


def _reader(settings: PoseSettings) -> Any:
    import pycolmap

    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    reader.default_focal_length_factor = settings.default_focal_factor
    return reader


def _camera_of(database: Path, names: Sequence[str]) -> int | None:
    import pycolmap

    if not database.exists():
        return None
    with pycolmap.Database.open(database) as opened:
        for name in names:
            image = opened.read_image_with_name(name)
            if image is not None:
                return int(image.camera_id)
    return None


def _has_features(database: Path, name: str) -> bool:
    import pycolmap

    if not database.exists():
        return False
    with pycolmap.Database.open(database) as opened:
        image = opened.read_image_with_name(name)
        if image is None:
            return False
        return bool(opened.exists_keypoints(image.image_id) and opened.exists_descriptors(image.image_id))


def choose_pairs(count: int, settings: PoseSettings) -> list[tuple[int, int]]:
    """Pairs of photos (by rank of the name) to be matched, each ``first < second``, sorted.

    All of them for few photos; otherwise neighbours in the walk, neighbours at distances 2, 4, 8, ... and all pairs
    among every ``loop_stride``-th photo (farther apart above 200 photos), which close loops without a vocabulary to
    download. The number of pairs grows with n log n.
    """
    if count <= settings.exhaustive_up_to:
        return list(combinations(range(count), 2))
    stride = max(settings.loop_stride, math.ceil(math.sqrt(count / (2 * _LOOPS_PER_PHOTO))))
    pairs = set(combinations(range(0, count, stride), 2))
    for first in range(count):
        steps = set(range(1, settings.overlap + 1)) | {2**power for power in range(count.bit_length())}
        pairs |= {(first, first + step) for step in steps if first + step < count}
    return sorted(pairs)


def match_features(
    database: Path, names: Sequence[str], pairs: Sequence[tuple[int, int]], settings: PoseSettings, progress: Progress
) -> None:
    """Match and check geometrically the pairs that the database has not; ``names`` must hold no spaces."""
    import pycolmap

    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = settings.thread_count
    verification = pycolmap.TwoViewGeometryOptions()
    verification.min_num_inliers = settings.min_inliers
    verification.ransac.random_seed = SEED
    listed = database.parent / "pairs.txt"
    for start in range(0, len(pairs), _PAIRS_PER_BATCH):
        progress(start, len(pairs), "matching photos")
        batch = pairs[start : start + _PAIRS_PER_BATCH]
        listed.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in batch), encoding="utf-8")
        pairing = pycolmap.ImportedPairingOptions()
        pairing.match_list_path = listed
        pycolmap.match_image_pairs(
            database,
            matching_options=options,
            pairing_options=pairing,
            verification_options=verification,
            device=pycolmap.Device.cpu,
        )
    progress(len(pairs), len(pairs), "matching photos")


def reconstruct(database: Path, images: Path, out: Path, settings: PoseSettings, progress: Progress) -> list[Any]:
    """Map the photos; returns the ``pycolmap.Reconstruction`` of each connected part, the largest first."""
    import pycolmap

    out.mkdir(parents=True, exist_ok=True)
    total = 0
    with pycolmap.Database.open(database) as opened:
        total = int(opened.num_images())
        if opened.num_verified_image_pairs() == 0:
            return []
    progress(0, total, "placing photos")
    if settings.mapper == "global":
        options = pycolmap.GlobalPipelineOptions()
        options.num_threads = settings.thread_count
        options.random_seed = SEED
        models = pycolmap.global_mapping(database, images, out, options=options)
    elif settings.mapper == "incremental":
        placed = 0

        def step() -> None:
            nonlocal placed
            placed = min(placed + 1, total)
            progress(placed, total, "placing photos")

        incremental = pycolmap.IncrementalPipelineOptions()
        incremental.num_threads = settings.thread_count
        incremental.random_seed = SEED
        incremental.min_model_size = settings.min_registered
        incremental.max_num_models = 5
        # Colours are taken from the photographs at fusion.
        incremental.extract_colors = False
        models = pycolmap.incremental_mapping(database, images, out, options=incremental, next_image_callback=step)
    else:
        msg = f"there is no mapper {settings.mapper!r}; choose incremental or global"
        raise PosesError(msg)
    progress(total, total, "placing photos")
    return sorted(models.values(), key=lambda model: (-model.num_reg_images(), -model.num_points3D()))

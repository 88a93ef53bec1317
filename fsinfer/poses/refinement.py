"""The adjustment of a finished map: a lens that fits, and points that are worth keeping.

Phone cameras straighten their pictures themselves and leave a wavy rest that one radial coefficient cannot follow:
on 23 photos of a phone a rational model took the median reprojection error from 0.73 to 0.60 pixels. A model with
many coefficients bends where nothing was seen, though, so that it is only taken where it pays and stays monotone.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from fsinfer.poses.colmap_calls import call
from fsinfer.progress import Progress

_log = logging.getLogger(__name__)

#: An adjustment of all photos ends where a step gains less than this share; COLMAP goes on to its limit of steps.
#: Source: numerics; three adjustments of 300 photos take 36 instead of 85 s, to the same places.
_ENOUGH = 1e-5
#: One after which observations are only judged, and the lens chosen, ends at this share already. Source: numerics; it
#: takes 300 photos from 20 to 16 s, and moves their cameras by 0.0003 of a step.
_ENOUGH_TO_JUDGE = 1e-4
#: Longer side at which features are found and errors are told, pixels. Source: docs/trials-speed.md; 23 phone photos of
#: 2016x1512 have 5,800 features at it instead of 9,000 at 1600, and their cameras differ by no more than two such
#: solutions do.
FEATURE_SIZE_PX = 1280


@dataclass(frozen=True, kw_only=True)
class RefinementSettings:
    """Constants of the last adjustment.

    Attributes
    ----------
    min_photos: a camera with fewer registered photos keeps the simple lens of the mapper. Source: judgement.
    min_gain: the mean error must fall by this share for the richer lens. Source: judgement, on 23 phone photos, where
        it falls by a sixth.
    max_error_px: observations further off are dropped before the last round, in photos no larger than those that
        features are looked for in; in larger ones they may be more off. Source:
        judgement, on 23 phone photos, where the median error is 0.6 pixels.
    min_angle_deg: points whose rays meet at less than this are dropped. Source: COLMAP's mapper (1.5).
    """

    min_photos: int = 8
    min_gain: float = 0.04
    max_error_px: float = 2.5
    min_angle_deg: float = 1.5


#: Steps of an adjustment at most. Source: numerics.
_MOST_STEPS = 40
#: Share of the half diagonal out to which a lens must be monotone, radii and directions looked at. Source: numerics.
_OUT_TO, _RADII, _DIRECTIONS = 1.05, 200, 8
#: Growth of the image radius over that of a pinhole, and of that over it, at most. Source: phone lenses after the
#: camera's own correction stay within a few per cent; this is generous.
_MOST_GROWTH = 2.0


def refine(model: Any, settings: RefinementSettings, progress: Progress) -> Any:
    """Return a copy of a ``pycolmap.Reconstruction`` whose cameras are SIMPLE_RADIAL, with a lens that fits.

    It is adjusted, its points are those worth keeping, and it is yet to be adjusted to them: by :func:`settle`, or by
    what follows. In one thread, so that two runs give the same to the last bit: 32 instead of 23 s for 300 photos on
    two cores.
    """
    import copy

    import pycolmap

    progress(0, 2, "adjusting")
    best = copy.deepcopy(model)
    _enrich(best, "RADIAL", settings)
    adjust_to_judge(best)
    progress(1, 2, "adjusting")
    rich = copy.deepcopy(best)
    if _enrich(rich, "FULL_OPENCV", settings):
        adjust_to_judge(rich)
        gain = 1 - rich.compute_mean_reprojection_error() / best.compute_mean_reprojection_error()
        _log.info("rational lens: mean error falls by %.1f %%", 100 * gain)
        if gain >= settings.min_gain and all(is_monotone(camera) for camera in rich.cameras.values()):
            best = rich
    progress(2, 2, "adjusting")
    manager = pycolmap.ObservationManager(best)
    manager.filter_all_points3D(settings.max_error_px * larger_than_usual(best), settings.min_angle_deg)
    return best


def settle(model: Any) -> None:
    """Adjust a model of :func:`refine` to the points that were kept; in place, and in one thread as well."""
    _adjust(model)


def adjust_to_judge(model: Any) -> None:
    """Adjust a model so well that its observations and its lens can be judged; in place, and in one thread as well."""
    _adjust(model, _ENOUGH_TO_JUDGE)


def larger_than_usual(model: Any) -> float:
    """How many times the longer side of a model's largest photo is that at which features are found; 1 or more."""
    longest = max(max(camera.width, camera.height) for camera in model.cameras.values())
    return float(max(longest, FEATURE_SIZE_PX) / FEATURE_SIZE_PX)


def _enrich(model: Any, lens: str, settings: RefinementSettings) -> bool:
    """Give cameras with enough photos the lens model ``lens``, equal in effect to what they have."""
    import pycolmap

    photos: dict[int, int] = {}
    for image_id in model.reg_image_ids():
        camera_id = model.images[image_id].camera_id
        photos[camera_id] = photos.get(camera_id, 0) + 1
    changed = False
    for camera_id, camera in model.cameras.items():
        if photos.get(camera_id, 0) < settings.min_photos:
            continue
        focal, center_x, center_y, *radial = (float(value) for value in camera.params)
        k1, k2 = (*radial, 0.0, 0.0)[:2]
        if lens == "RADIAL":
            params = [focal, center_x, center_y, k1, k2]
        else:
            params = [focal, focal, center_x, center_y, k1, k2, *[0.0] * 6]
        camera.model = pycolmap.CameraModelId.__members__[lens]
        camera.params = params
        changed = True
    return changed


def _adjust(model: Any, enough: float = _ENOUGH) -> None:
    import pycolmap

    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.max_num_iterations = _MOST_STEPS
    options.ceres.solver_options.function_tolerance = enough
    # Leaves move: a robust loss keeps the wrong matches that passed the mapper from pulling.
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in model.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    call(call(pycolmap.create_default_bundle_adjuster, options, config, model).solve)
    model.update_point_3d_errors()


def is_monotone(camera: Any) -> bool:
    """Whether the lens maps ever wider rays to ever larger image radii, out to the corners of the image."""
    focal = camera.mean_focal_length()
    corner = _OUT_TO * float(np.hypot(camera.width, camera.height)) / 2 / focal
    radius = np.linspace(0, corner, _RADII)
    for direction in np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False):
        rays = np.stack([radius * np.cos(direction), radius * np.sin(direction), np.ones_like(radius)], axis=1)
        pixels = camera.img_from_cam(rays)
        distance = np.linalg.norm(pixels - pixels[0], axis=1)
        growth = np.diff(distance) / (focal * (radius[1] - radius[0]))
        if not (np.isfinite(growth).all() and growth.min() > 1 / _MOST_GROWTH and growth.max() < _MOST_GROWTH):
            return False
    return True

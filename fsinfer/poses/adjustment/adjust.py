"""The adjustment photo by photo: what the photos bear out, for a ``pycolmap.Reconstruction``."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.poses.adjustment.evidence import Trial
from fsinfer.poses.adjustment.last_fit import Sought, found_with, weighting_of
from fsinfer.poses.adjustment.photo_effects import PhotoEffects, effects_of
from fsinfer.poses.adjustment.precision import CameraPrecision
from fsinfer.poses.adjustment.problem import (
    Group,
    Numbers,
    Observations,
    Unknowns,
    from_model,
    is_known,
    params_of,
)
from fsinfer.poses.adjustment.projection import FOCAL, OWN, PRINCIPAL, Floats, project
from fsinfer.poses.adjustment.rematch import photos_of
from fsinfer.poses.adjustment.settings import AdjustmentSettings
from fsinfer.poses.refinement import settle
from fsinfer.progress import Progress, silent


@dataclass(frozen=True, kw_only=True)
class PhotoAdjustment:
    """What changed from photo to photo.

    Attributes
    ----------
    effects: by COLMAP's image number; empty where nothing was borne out.
    precisions: by COLMAP's image number, how well each camera is known; empty for models of few photos.
    groups: names of the groups of unknowns that were kept.
    trials: what each did to points held out; empty where there was nothing to try it with.
    patches: observations by which the cameras were placed at last that are patches; 0 where features alone were.
    rolling_shutter_px: median over the photos of how far their points move from the first row's time to the last's;
        None where it was not borne out.
    focal_std_percent: of the focal length from photo to photo. principal_std_px: of the principal point, on one axis.
    """

    effects: Mapping[int, PhotoEffects] = field(default_factory=dict)
    precisions: Mapping[int, CameraPrecision] = field(default_factory=dict)
    groups: tuple[str, ...] = ()
    trials: tuple[Trial, ...] = ()
    patches: int = 0
    rolling_shutter_px: float | None = None
    focal_std_percent: float | None = None
    principal_std_px: float | None = None

    def record(self, names: Mapping[int, str] | None = None) -> dict[str, Any]:
        """For ``poses.json``; ``names`` of the views by COLMAP's image numbers."""
        return {
            "adjusted_photo_by_photo": list(self.groups),
            "patches": self.patches,
            "rolling_shutter_px": _rounded(self.rolling_shutter_px),
            "focal_std_percent": _rounded(self.focal_std_percent),
            "principal_std_px": _rounded(self.principal_std_px),
            "held_out_error_falls_percent": {
                trial.group.name: round(100 * trial.gain, 1) for trial in self.trials if np.isfinite(trial.gain)
            },
            "camera_std": {
                name: {
                    "center": float(f"{self.precisions[number].center_std:.4g}"),
                    "direction_rad": float(f"{self.precisions[number].direction_std_rad:.4g}"),
                }
                for number, name in sorted((names or {}).items())
                if number in self.precisions
            },
        }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def adjust_photos(
    model: Any,
    settings: AdjustmentSettings,
    larger: float = 1.0,
    progress: Progress = silent,
    *,
    images: Path | None = None,
    threads: int = 1,
) -> tuple[Any, PhotoAdjustment]:
    """Adjust a model with what its photos have of their own, where points held out are predicted better by it.

    Parameters
    ----------
    model: a ``pycolmap.Reconstruction`` of :func:`fsinfer.poses.refinement.refine`.
    larger: how many times more pixels the longer side of the photos has than that at which features are found, 1 or
        more; losses widen with it.
    images: folder of the photos, in which points are looked for once more by their patches (:mod:`~fsinfer.poses.
        adjustment.rematch`); None: features alone.
    threads: with two or more, fits that do not hang on each other are done at the same time, one by another process.

    Returns
    -------
    The model: the one given, settled, where there is nothing to adjust or nothing to adjust by. Else a copy, whose
    poses are those of the middle row's time, and whose observations lie where the camera's shared lens would have shown
    them, standing still.
    """
    progress(0, 2, "adjusting photo by photo")
    if model.num_reg_images() < settings.min_photos or not all(is_known(camera) for camera in model.cameras.values()):
        settle(model)
        return model, PhotoAdjustment()
    seen, start, numbers = from_model(model)
    weighting = weighting_of(model, seen, start, numbers, settings, larger)
    photos = None if images is None else photos_of(model, numbers, images, larger)
    sought = Sought(seen=seen, start=start, photos=photos, settings=settings)
    found = found_with(sought, weighting, progress, threads=threads)
    groups, trials = found.evidence.groups, found.evidence.trials
    if not groups and not found.patches:
        settle(model)
        seen, start, numbers = from_model(model)
        found = replace(sought, seen=seen, start=start, photos=None).fitted(found.evidence)
    figures = PhotoAdjustment(
        precisions=dict(zip(numbers.images, found.precisions, strict=True)), trials=trials, patches=found.patches
    )
    if not groups and not found.patches:
        return model, figures
    adjusted = copy.deepcopy(model)
    effects = _write(adjusted, seen, found.unknowns, numbers)
    progress(2, 2, "adjusting photo by photo")
    if not groups:
        return adjusted, figures
    return adjusted, replace(_with_sizes(figures, seen, found.unknowns, groups), effects=effects)


def _write(model: Any, seen: Observations, found: Unknowns, numbers: Numbers) -> dict[int, PhotoEffects]:
    """Put poses, lenses, points and moved observations into the model; returns what each photo has of its own."""
    import pycolmap

    for number, lens in zip(numbers.cameras, found.lenses, strict=True):
        camera = model.cameras[number]
        camera.params = params_of(camera, lens)
    for number, xyz in zip(numbers.points, found.points, strict=True):
        model.points3D[number].xyz = xyz
    inside = found.in_cameras(seen)
    lenses = found.lenses[seen.camera[seen.photo]]
    still = project(inside, seen.tau, lenses, np.zeros((len(inside), OWN)))
    shifts = still - project(inside, seen.tau, lenses, found.own[seen.photo])
    effects = {}
    for photo, image_id in enumerate(numbers.images):
        image = model.images[image_id]
        pose = np.column_stack([found.rotations[photo], found.translations[photo]])
        image.frame.set_cam_from_world(image.camera_id, pycolmap.Rigid3d(pose))
        rows = np.flatnonzero(seen.photo == photo)
        for feature, xy in zip(numbers.features[rows].tolist(), (seen.xy + shifts)[rows], strict=True):
            image.points2D[feature].xy = xy
        before = rows[inside[rows, 2] > 0]
        camera = model.cameras[image.camera_id]
        effects[image_id] = effects_of(
            found.own[photo], seen.xy[before], inside[before, 2], int(camera.width), int(camera.height)
        )
    model.update_point_3d_errors()
    return effects


def _with_sizes(
    figures: PhotoAdjustment, seen: Observations, found: Unknowns, groups: Sequence[Group]
) -> PhotoAdjustment:
    """How large each effect is."""
    shutter = focal = principal = None
    if Group.turn in groups or Group.drift in groups:
        shutter = float(np.median(shutter_px(seen, found)))
    if Group.focal in groups:
        focal = 100 * float(np.exp(found.own[:, FOCAL]).std())
    if Group.principal in groups:
        principal = float(np.sqrt(found.own[:, PRINCIPAL].var(axis=0).mean()))
    return replace(
        figures,
        groups=tuple(group.name for group in groups),
        rolling_shutter_px=shutter,
        focal_std_percent=focal,
        principal_std_px=principal,
    )


def shutter_px(seen: Observations, found: Unknowns) -> Floats:
    """(N,) median way of each photo's points from the first row's time to the last's, pixels."""
    inside, lens = found.in_cameras(seen), found.lenses[seen.camera[seen.photo]]
    own, half = found.own[seen.photo], np.full(len(inside), 0.5)
    way = np.linalg.norm(project(inside, half, lens, own) - project(inside, -half, lens, own), axis=1)
    return np.array([np.median(way[seen.photo == i]) if (seen.photo == i).any() else 0 for i in range(len(found.own))])

"""The adjustment photo by photo: what the photos bear out, for a ``pycolmap.Reconstruction``."""

from __future__ import annotations

import copy
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from fsinfer.geometry.similarity import apply, fit_similarity, rotation_of, scale_of
from fsinfer.poses.adjustment.evidence import Evidence, Trial, confirmed, tried_in_turn
from fsinfer.poses.adjustment.fit import Weighting, fit, noise_of, with_points_fitted
from fsinfer.poses.adjustment.photo_effects import PhotoEffects, effects_of
from fsinfer.poses.adjustment.precision import CameraPrecision, camera_precisions
from fsinfer.poses.adjustment.problem import (
    Group,
    Numbers,
    Observations,
    Unknowns,
    free_directions,
    from_model,
    is_known,
    params_of,
)
from fsinfer.poses.adjustment.projection import DRIFT, FOCAL, LENS, OWN, PRINCIPAL, TURN, Floats, project, rows_axis
from fsinfer.poses.adjustment.reduced_system import Structure
from fsinfer.poses.adjustment.settings import AdjustmentSettings
from fsinfer.poses.refinement import settle
from fsinfer.processes import hand_back, has_workers, shared_out, worker_processes
from fsinfer.progress import Progress, silent
from fsinfer.threads import beside

_log = logging.getLogger(__name__)

#: Observations from which on they save more than it takes to start them. Source: numerics.
_SHARED_FROM = 30_000


@dataclass(frozen=True, kw_only=True)
class PhotoAdjustment:
    """What changed from photo to photo.

    Attributes
    ----------
    effects: by COLMAP's image number; empty where nothing was borne out.
    precisions: by COLMAP's image number, how well each camera is known; empty for models of few photos.
    groups: names of the groups of unknowns that were kept.
    trials: what each did to points held out; empty where there was nothing to try it with.
    rolling_shutter_px: median over the photos of how far their points move from the first row's time to the last's;
        None where it was not borne out.
    focal_std_percent: of the focal length from photo to photo. principal_std_px: of the principal point, on one axis.
    """

    effects: Mapping[int, PhotoEffects] = field(default_factory=dict)
    precisions: Mapping[int, CameraPrecision] = field(default_factory=dict)
    groups: tuple[str, ...] = ()
    trials: tuple[Trial, ...] = ()
    rolling_shutter_px: float | None = None
    focal_std_percent: float | None = None
    principal_std_px: float | None = None

    def record(self, names: Mapping[int, str] | None = None) -> dict[str, Any]:
        """For ``poses.json``; ``names`` of the views by COLMAP's image numbers."""
        return {
            "adjusted_photo_by_photo": list(self.groups),
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
    threads: int = 1,
) -> tuple[Any, PhotoAdjustment]:
    """Adjust a model with what its photos have of their own, where points held out are predicted better by it.

    Parameters
    ----------
    model: a ``pycolmap.Reconstruction`` of :func:`fsinfer.poses.refinement.refine`.
    larger: how many times more pixels the longer side of the photos has than that at which features are found, 1 or
        more; losses widen with it.
    threads: with two or more, fits that do not hang on each other are done at the same time, one by another process.

    Returns
    -------
    The model: the one given, settled, where nothing is borne out. Else a copy, whose poses are those of the middle
    row's time, and whose observations lie where the camera's shared lens would have shown them, standing still.
    """
    progress(0, 2, "adjusting photo by photo")
    if model.num_reg_images() < settings.min_photos or not all(is_known(camera) for camera in model.cameras.values()):
        settle(model)
        return model, PhotoAdjustment()
    seen, start, numbers = from_model(model)
    weighting = weighting_of(model, seen, start, numbers, settings, larger)
    found = _found(seen, start, weighting, settings, progress, threads=threads)
    groups, trials = found.evidence.groups, found.evidence.trials
    if not groups:
        settle(model)
        seen, start, numbers = from_model(model)
        found = _fitted(seen, start, found.evidence)
    precisions = dict(zip(numbers.images, found.precisions, strict=True))
    if not groups:
        return model, PhotoAdjustment(precisions=precisions, trials=trials)
    adjusted = copy.deepcopy(model)
    effects = _write(adjusted, seen, found.unknowns, numbers)
    progress(2, 2, "adjusting photo by photo")
    figures = _figures(seen, found.unknowns, groups)
    return adjusted, replace(figures, effects=effects, precisions=precisions, trials=trials)


@dataclass(frozen=True, kw_only=True)
class _Found:
    """What the last fit found, with the groups of ``evidence``; how well each photo's camera is known."""

    evidence: Evidence
    unknowns: Unknowns
    precisions: Sequence[CameraPrecision]


def _found(
    seen: Observations,
    start: Unknowns,
    weighting: Weighting,
    settings: AdjustmentSettings,
    progress: Progress,
    *,
    threads: int,
) -> _Found:
    """Which groups are borne out, and the last fit with them; the one beside the other where there are threads."""
    hand_back()  # what mapping held
    # The last fit takes as long as all the trials beside it together, so that one process more is enough.
    count = 1 if threads > 1 and len(seen.photo) >= _SHARED_FROM else 0
    with worker_processes([__name__], count=count, beside=True):
        in_turn = tried_in_turn(seen, start, weighting, settings)
        progress(1, 2, "adjusting photo by photo")
        if in_turn is None:
            nothing = Evidence(groups=(), trials=(), weighting=weighting, cameras=start)
            return _Found(evidence=nothing, unknowns=start, precisions=())
        usual = in_turn.evidence
        if not usual.groups:
            return _Found(evidence=usual, unknowns=start, precisions=())
        if not has_workers():
            return _fitted(seen, start, confirmed(in_turn, settings))
        hand_back()  # what the trials held
        # Hardly ever does a group go when it is tried once more, so that the last fit need not wait for that.
        with beside(lambda _: next(shared_out(partial(_fitted, seen, start), [usual], threads=1))) as fitted:
            evidence = confirmed(in_turn, settings)
            if evidence.groups == usual.groups:
                return replace(fitted(), evidence=evidence)
        return _fitted(seen, start, evidence)


def _fitted(seen: Observations, start: Unknowns, evidence: Evidence) -> _Found:
    """The fit of everything with the groups of ``evidence``; without any, ``start`` as it is."""
    structure = Structure(seen, len(start.points))
    found, weighting = start, evidence.weighting
    if evidence.groups:
        # The cameras are nearly where they belong, and the points come after.
        near = with_points_fitted(seen, evidence.cameras, weighting.loss_px)
        found = like(fit(structure, near, evidence.groups, weighting), start)
    precisions = camera_precisions(structure, found, evidence.groups, weighting)
    return _Found(evidence=evidence, unknowns=found, precisions=precisions)


def weighting_of(
    model: Any, seen: Observations, start: Unknowns, numbers: Numbers, settings: AdjustmentSettings, larger: float
) -> Weighting:
    """The priors in units of this model."""
    photos = np.bincount(seen.camera, minlength=len(numbers.cameras))
    step = usual_step(start)
    own_std = np.empty((len(numbers.images), OWN))
    own_std[:, FOCAL], own_std[:, TURN] = settings.focal_std, settings.turn_std_rad
    cameras = [model.cameras[i] for i in numbers.cameras]
    sides = np.array([max(camera.width, camera.height) for camera in cameras], dtype=np.float64)
    own_std[:, PRINCIPAL] = settings.principal_std * sides[seen.camera][:, None]
    own_std[:, DRIFT] = settings.drift_std * step
    # Of upright photos nobody can tell the mean turning about their rows from an upright stretch of the world.
    mean_std = np.full_like(own_std, np.inf)
    for photo, camera in enumerate(seen.camera):
        along = rows_axis(int(cameras[camera].width), int(cameras[camera].height))
        mean_std[photo, TURN.start + along] = settings.mean_turn_std_rad
        mean_std[photo, DRIFT.start + 1 - along] = settings.mean_drift_std * step
    # As in the adjustment before, a lens that few photos share is not asked for more.
    free = [
        free_directions(camera) if count >= settings.min_photos else np.zeros((LENS, 0))
        for camera, count in zip(cameras, photos, strict=True)
    ]
    noise = noise_of(start.residuals(seen))
    return Weighting(
        loss_px=settings.loss_px * larger, noise_px=noise, own_std=own_std, mean_std=mean_std, lens_free=free
    )


def usual_step(unknowns: Unknowns) -> float:
    """Median distance from a photo to the next, model units; photos are in the order of walking."""
    return float(np.median(np.linalg.norm(np.diff(unknowns.centers, axis=0), axis=1)))


def like(found: Unknowns, start: Unknowns) -> Unknowns:
    """``found``, turned, moved and scaled so that its camera centres lie on those of ``start`` as well as they can."""
    start_from_found = fit_similarity(found.centers, start.centers)
    if start_from_found is None:
        return found  # centres in one line fix no turn
    rotations = found.rotations @ rotation_of(start_from_found).T
    own = found.own.copy()
    own[:, DRIFT] *= scale_of(start_from_found)
    return replace(
        found,
        rotations=rotations,
        translations=-np.einsum("nij,nj->ni", rotations, apply(start_from_found, found.centers)),
        own=own,
        points=apply(start_from_found, found.points),
    )


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


def _figures(seen: Observations, found: Unknowns, groups: Sequence[Group]) -> PhotoAdjustment:
    shutter = focal = principal = None
    if Group.turn in groups or Group.drift in groups:
        shutter = float(np.median(shutter_px(seen, found)))
    if Group.focal in groups:
        focal = 100 * float(np.exp(found.own[:, FOCAL]).std())
    if Group.principal in groups:
        principal = float(np.sqrt(found.own[:, PRINCIPAL].var(axis=0).mean()))
    return PhotoAdjustment(
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

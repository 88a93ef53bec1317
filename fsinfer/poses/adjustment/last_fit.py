"""The last fit: what the photos bear out, and where their cameras are by it.

What changes from photo to photo is decided by the features (:mod:`fsinfer.poses.adjustment.evidence`). The cameras are
then placed by patches where photos are at hand (:mod:`fsinfer.poses.adjustment.rematch`), else by all features.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fsinfer.geometry.similarity import apply, fit_similarity, rotation_of, scale_of
from fsinfer.poses.adjustment.evidence import Evidence, confirmed, tried_in_turn
from fsinfer.poses.adjustment.fit import Weighting, fit, noise_of, with_points_fitted
from fsinfer.poses.adjustment.precision import CameraPrecision, camera_precisions
from fsinfer.poses.adjustment.problem import Numbers, Observations, Unknowns, free_directions
from fsinfer.poses.adjustment.projection import DRIFT, FOCAL, LENS, OWN, PRINCIPAL, TURN, rows_axis
from fsinfer.poses.adjustment.reduced_system import Structure
from fsinfer.poses.adjustment.rematch import Photos, rematched
from fsinfer.poses.adjustment.settings import AdjustmentSettings
from fsinfer.processes import hand_back, has_workers, shared_out, worker_processes
from fsinfer.progress import Progress
from fsinfer.threads import beside

_log = logging.getLogger(__name__)

#: Observations from which on they save more than it takes to start them. Source: numerics.
_SHARED_FROM = 30_000
#: A fit to patches ends where a step gains less than this share of its cost. Source: numerics; with a twentieth of it
#: cameras of 90 photos moved by 0.1 mm or less, in twice the time.
_ENOUGH = 2e-3


@dataclass(frozen=True, kw_only=True)
class Found:
    """What the last fit found, with the groups of ``evidence``; how well each photo's camera is known.

    ``patches``: how many observations of it were patches.
    """

    evidence: Evidence
    unknowns: Unknowns
    precisions: Sequence[CameraPrecision]
    patches: int = 0


@dataclass(frozen=True, kw_only=True)
class Sought:
    """What the last fit begins with.

    Attributes
    ----------
    seen, start: features, and where cameras and points are.
    photos: in which patches are looked for, None for none.
    """

    seen: Observations
    start: Unknowns
    photos: Photos | None
    settings: AdjustmentSettings

    def fitted(self, evidence: Evidence) -> Found:
        """The fit of everything with the groups of ``evidence``: by patches, or by features."""
        by_patches = None if self.photos is None else self._by_patches(evidence, self.photos)
        return by_patches or self._by_features(evidence)

    def _by_features(self, evidence: Evidence) -> Found:
        """Without any group ``start`` as it is."""
        structure = Structure(self.seen, len(self.start.points))
        found = self.start
        if evidence.groups:
            found = like(fit(structure, self._near(evidence), evidence.groups, evidence.weighting), self.start)
        precisions = camera_precisions(structure, found, evidence.groups, evidence.weighting)
        return Found(evidence=evidence, unknowns=found, precisions=precisions)

    def _near(self, evidence: Evidence) -> Unknowns:
        """The cameras are nearly where they belong, and the points come after."""
        return with_points_fitted(self.seen, evidence.cameras, evidence.weighting.loss_px)

    def _by_patches(self, evidence: Evidence, photos: Photos) -> Found | None:
        """None where features contradict what the patches say, or there are hardly any."""
        settings, near = self.settings.rematch, self._near(evidence)
        there = rematched(self.seen, near, photos, settings)
        patches = int((there.weight == 1).sum())
        if patches < settings.min_patches * len(near.rotations):
            _log.info("%d patches are too few", patches)
            return None
        seen, used = there.of_points_seen(len(near.points))
        loss_px = settings.loss_px * photos.step_px
        start = with_points_fitted(seen, replace(near, points=near.points[used]), loss_px)
        weighting = replace(evidence.weighting, loss_px=loss_px, noise_px=noise_of(start.residuals(seen)))
        structure = Structure(seen, len(used))
        placed = fit(structure, start, evidence.groups, weighting, enough=_ENOUGH)
        weighting = replace(weighting, noise_px=noise_of(placed.residuals(seen)))
        # Points are those of the features, all of them.
        found = with_points_fitted(self.seen, replace(placed, points=near.points), evidence.weighting.loss_px)
        before, after = (evidence.weighting.losses(at.residuals(self.seen)).mean() for at in (near, found))
        _log.info("patches: loss of the features %.4f, %.4f before", after, before)
        if after > settings.max_loss_of_features * before:
            return None
        precisions = camera_precisions(structure, placed, evidence.groups, weighting)
        return Found(evidence=evidence, unknowns=like(found, self.start), precisions=precisions, patches=patches)


def found_with(sought: Sought, weighting: Weighting, progress: Progress, *, threads: int) -> Found:
    """Which groups are borne out, and the last fit with them; the one beside the other where there are threads."""
    hand_back()  # what mapping held
    # The last fit takes as long as all the trials beside it together, so that one process more is enough.
    count = 1 if threads > 1 and len(sought.seen.photo) >= _SHARED_FROM else 0
    with worker_processes([__name__], count=count, beside=True):
        in_turn = tried_in_turn(sought.seen, sought.start, weighting, sought.settings)
        progress(1, 2, "adjusting photo by photo")
        if in_turn is None:
            nothing = Evidence(groups=(), trials=(), weighting=weighting, cameras=sought.start)
            return Found(evidence=nothing, unknowns=sought.start, precisions=())
        usual = in_turn.evidence
        if not usual.groups and sought.photos is None:
            return Found(evidence=usual, unknowns=sought.start, precisions=())
        if not has_workers():
            return sought.fitted(confirmed(in_turn, sought.settings))
        hand_back()  # what the trials held
        # Hardly ever does a group go when it is tried once more, so that the last fit need not wait for that.
        with beside(lambda _: next(shared_out(sought.fitted, [usual], threads=1))) as fitted:
            evidence = confirmed(in_turn, sought.settings)
            if evidence.groups == usual.groups:
                return replace(fitted(), evidence=evidence)
        return sought.fitted(evidence)


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

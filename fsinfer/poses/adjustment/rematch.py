"""Points looked for once more, by their patches: more exactly than features are found, and in more photos.

A feature lies where a blob of a photo is roundest, and is off by a quarter of a pixel and more; a patch about it is
found in another photo to less than a tenth. So the last fit takes the feature of one photo for the point, and for what
the others observe of it where they show the patch about it.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from fsinfer.io.images import luminance, read_image
from fsinfer.poses.adjustment.patches import PATCH_SIDE, Floats32, Matches, align, patches_at, smoothed
from fsinfer.poses.adjustment.problem import Ints, Numbers, Observations, Unknowns
from fsinfer.poses.adjustment.projection import FOCAL, Floats, project, read_at_of
from fsinfer.poses.adjustment.settings import RematchSettings

_log = logging.getLogger(__name__)

#: Rounds in which the row of a point is found, on which its own place depends. Source: numerics.
_ROUNDS = 3
#: Pixels from the edge of a photo within which no patch is laid, in its steps. Source: half a patch and what it may
#: move.
_BORDER = 12.0


@dataclass(frozen=True, kw_only=True)
class Photos:
    """The photos of an adjustment, in its order.

    Attributes
    ----------
    files: N paths.
    sizes: (N, 2) int64, width and height, pixels.
    step_px: from a sample of a patch to the next: how many times larger they are than those features are found in.
    """

    files: Sequence[Path]
    sizes: Ints
    step_px: float

    def smooth(self, number: int) -> Floats32:
        """One of them, as patches are taken from and laid over it."""
        return smoothed(luminance(read_image(self.files[number])), self.step_px)


def photos_of(model: Any, numbers: Numbers, images: Path, larger: float) -> Photos:
    """Those of a ``pycolmap.Reconstruction`` in the folder ``images``; ``larger`` becomes ``step_px``."""
    cameras = [model.cameras[model.images[number].camera_id] for number in numbers.images]
    return Photos(
        files=[images / model.images[number].name for number in numbers.images],
        sizes=np.array([(int(camera.width), int(camera.height)) for camera in cameras]),
        step_px=larger,
    )


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """Points and photos in which they are to be looked for.

    ``point``, ``photo`` (m,); ``xy`` (m, 2) where they are expected, and ``affine`` (m, 2, 2) from pixels about the
    point in the photo of its patch to those there.
    """

    point: Ints
    photo: Ints
    xy: Floats
    affine: Floats


def rematched(seen: Observations, at: Unknowns, photos: Photos, settings: RematchSettings) -> Observations:
    """Observations of some of the points, as many as each photo needs, by their patches where they are found.

    Parameters
    ----------
    seen, at: features and where cameras and points are, to a few pixels.

    Returns
    -------
    Those of the patches, of weight 1, and the features that no patch was found for, of ``settings.feature_weight``.
    """
    inside = at.in_cameras(seen)
    chosen = spread(seen, photos.sizes, len(at.points), settings)
    reference = np.where(chosen, references(seen, inside, len(at.points)), -1)
    pairs = pairs_to_look_for(seen, at, reference, photos, settings)
    good, xy = _matched(seen, reference, pairs, photos, settings)
    found = np.bincount(pairs.point[good], minlength=len(chosen)) > 0
    of_patch = np.flatnonzero(chosen & found)
    rows = reference[of_patch]
    rest = chosen[seen.point]
    point = np.concatenate([pairs.point[good], of_patch, seen.point[rest]])
    photo = np.concatenate([pairs.photo[good], seen.photo[rows], seen.photo[rest]])
    places = np.concatenate([xy[good], seen.xy[rows], seen.xy[rest]])
    weight = np.repeat([1.0, 1.0, settings.feature_weight], [good.sum(), len(rows), rest.sum()])
    # Where a patch was found, or taken, the feature counts no more; and the order is that of the photos.
    _, first = np.unique(photo * len(chosen) + point, return_index=True)
    photo = photo[first]
    _log.info("%d of %d patches found, of %d points", good.sum(), len(good), chosen.sum())
    return Observations(
        photo=photo,
        point=point[first],
        xy=places[first],
        tau=read_at_of(places[first], photos.sizes[photo]),
        weight=weight[first],
        camera=seen.camera,
    )


def references(seen: Observations, inside: Floats, points: int) -> Ints:
    """(P,) which observation of each point has the middle one of its depths; -1 where there is none."""
    order = np.lexsort((inside[:, 2], seen.point))
    counts = np.bincount(seen.point, minlength=points)
    found = np.full(points, -1)
    some = counts > 0
    found[some] = order[(np.cumsum(counts) - counts + counts // 2)[some]]
    return found


def pairs_to_look_for(
    seen: Observations, at: Unknowns, reference: Ints, photos: Photos, settings: RematchSettings
) -> Pairs:
    """In which photos a point may be found: those that see it, and that share points with the one of its patch.

    ``reference`` (P,) is the observation about which the patch of each point is; -1 where it has none.
    """
    points, count = len(at.points), len(at.rotations)
    sees = csr_matrix((np.ones(len(seen.photo), np.float32), (seen.point, seen.photo)), shape=(points, count))
    near = (sees.T @ sees).toarray() >= settings.min_shared
    patches = seen.of(reference[reference >= 0])
    found = [_pairs_of(part, sees[part.point].toarray() > 0, near, at, photos, settings) for _, part in patches.parts()]
    return Pairs(**{name: np.concatenate([getattr(one, name) for one in found]) for name in Pairs.__dataclass_fields__})


def _pairs_of(
    patches: Observations,
    has_feature: NDArray[np.bool_],
    near: NDArray[np.bool_],
    at: Unknowns,
    photos: Photos,
    settings: RematchSettings,
) -> Pairs:
    """Of some patches' points: in which photos they have a feature (n, N), and which photos share enough (N, N)."""
    reach = near[patches.photo] | has_feature
    reach[np.arange(len(patches.photo)), patches.photo] = False
    row, photo = np.nonzero(reach)
    points, focal = at.points[patches.point], at.lenses[patches.camera, 0] * np.exp(at.own[:, FOCAL][:, 0])
    inside = at.in_cameras(patches)
    there = (at.rotations[photo] @ points[row][:, :, None])[:, :, 0] + at.translations[photo]
    to_photo, to_own = at.centers[photo] - points[row], (at.centers[patches.photo] - points)[row]
    lengths = np.linalg.norm(to_photo, axis=1) * np.linalg.norm(to_own, axis=1)
    cosine = (to_photo * to_own).sum(1) / np.maximum(lengths, np.finfo(float).tiny)
    own = patches.photo[row]
    larger = np.where(there[:, 2] > 0, focal[photo] * inside[row, 2] / (focal[own] * np.abs(there[:, 2])), 0)
    kept = cosine > np.cos(np.radians(settings.max_angle_deg))
    kept &= (larger < settings.max_ratio) & (larger > 1 / settings.max_ratio)
    row, photo, there, larger, cosine = (values[kept] for values in (row, photo, there, larger, cosine))
    lens, effects, size = at.lenses[patches.camera[photo]], at.own[photo], photos.sizes[photo]
    tau = np.zeros(len(row))
    for _ in range(_ROUNDS):
        xy = project(there, tau, lens, effects)
        tau = np.clip(read_at_of(xy, size), -0.5, 0.5)
    border = _BORDER * photos.step_px
    kept = ((xy > border) & (xy < size - border)).all(axis=1)
    # Those that have the feature first, then those that look most alike.
    order = np.lexsort((-cosine - 2 * has_feature[row, photo], ~kept, row))
    rank = np.arange(len(row)) - np.searchsorted(row[order], row[order])
    kept[order[rank >= settings.most_photos]] = False
    row, photo, larger, xy = (values[kept] for values in (row, photo, larger, xy))
    affine = _turned(at, photo, patches.photo[row]) * larger[:, None, None]
    # The feature of the patch's photo is the point, and lies beside where it is expected, too.
    expected = project(inside, patches.tau, at.lenses[patches.camera[patches.photo]], at.own[patches.photo])
    xy = xy + (affine @ (patches.xy - expected)[row][:, :, None])[:, :, 0]
    return Pairs(point=patches.point[row], photo=photo, xy=xy, affine=affine)


def _turned(at: Unknowns, photo: Ints, own: Ints) -> Floats:
    """(m, 2, 2) the turns about the line of sight from photos ``own`` to ``photo``."""
    turned = np.einsum("nij,nkj->nik", at.rotations[photo][:, :2], at.rotations[own][:, :2])
    along, across = turned[:, 0, 0] + turned[:, 1, 1], turned[:, 1, 0] - turned[:, 0, 1]
    length = np.maximum(np.hypot(along, across), np.finfo(float).tiny)
    return np.asarray(np.stack([along, -across, across, along], axis=1).reshape(-1, 2, 2) / length[:, None, None])


def spread(seen: Observations, sizes: Ints, points: int, settings: RematchSettings) -> NDArray[np.bool_]:
    """(P,) mask of points: of the longest tracks first, as many as each cell of each photo needs.

    A point is taken as long as a photo has fewer than ``settings.per_cell`` in the cell in which it shows it.
    """
    cells = settings.cells
    side = sizes.max(axis=1)[seen.photo, None] / cells
    column, row = np.clip(seen.xy // side, 0, cells - 1).astype(np.int64).T
    places = ((seen.photo * cells + row) * cells + column)[np.argsort(seen.point, kind="stable")]
    lengths = np.bincount(seen.point, minlength=points)
    ends = np.cumsum(lengths)
    filled = np.zeros(len(sizes) * cells * cells, dtype=np.int64)
    chosen = np.zeros(points, dtype=bool)
    for point in np.argsort(-lengths, kind="stable"):
        where = places[ends[point] - lengths[point] : ends[point]]
        if (filled[where] < settings.per_cell).any():
            chosen[point] = True
            filled[where] += 1
    return chosen


def _matched(
    seen: Observations, reference: Ints, pairs: Pairs, photos: Photos, settings: RematchSettings
) -> tuple[NDArray[np.bool_], Floats]:
    """Which pairs were found, and (m, 2) where."""
    step = photos.step_px
    with_patch = np.flatnonzero(reference >= 0)
    owner = seen.photo[reference[with_patch]]
    values = np.empty((len(with_patch), PATCH_SIDE, PATCH_SIDE), np.float32)
    place = np.empty(len(reference), np.int64)
    place[with_patch] = np.arange(len(with_patch))

    for photo in range(len(photos.files)):
        rows = np.flatnonzero(owner == photo)
        if len(rows):
            values[rows] = patches_at(photos.smooth(photo), seen.xy[reference[with_patch[rows]]], step)
    good, xy = np.zeros(len(pairs.point), dtype=bool), np.array(pairs.xy)
    order = np.argsort(pairs.photo, kind="stable")
    for rows in np.split(order, np.searchsorted(pairs.photo[order], np.arange(1, len(photos.files)))):
        if len(rows):
            patches = values[place[pairs.point[rows]]]
            image = photos.smooth(int(pairs.photo[rows[0]]))
            found = align(patches, image, pairs.xy[rows], pairs.affine[rows], step)
            good[rows] = _is_good(found, pairs.xy[rows], step, settings)
            xy[rows] = found.xy
    return good, xy


def _is_good(found: Matches, expected: Floats, step_px: float, settings: RematchSettings) -> NDArray[np.bool_]:
    moved = np.linalg.norm(found.xy - expected, axis=1)
    return np.asarray(
        (found.correlation > settings.min_correlation)
        & found.at_rest
        & (moved < settings.max_move_px * step_px)
        & (found.std < settings.max_std_px * step_px)
    )

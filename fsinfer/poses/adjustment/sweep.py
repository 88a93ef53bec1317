"""Corners of a photo, and how far off they are: laid over its neighbours at many depths (a plane sweep of patches).

For each corner alone, not for every pixel, and only to within a pixel or two: least-squares matching goes on from there
(Collins 1996, "A space-sweep approach to true multi-image matching"). The lines on which a neighbour shows a corner are
those of a pinhole; what lens, focusing, stabiliser and read-out add changes so little along one that it is found at
three depths and interpolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.adjustment.patches import Floats32
from fsinfer.poses.adjustment.problem import Ints, Unknowns
from fsinfer.poses.adjustment.projection import DRIFT, FOCAL, PRINCIPAL, Floats, project, read_at_of

#: A picture of a thousand photos that are held at once: a quarter of what they take as float32.
Bytes = NDArray[np.uint8]

#: How many times smaller the pictures are in which corners are swept. Source: judgement; least-squares matching comes
#: to rest from three pixels off.
SMALLER = 2
#: Smoothing of those, in their pixels. Source: judgement; they were averaged over four pixels already.
_SMOOTHING = 0.5
#: Samples along a side of a swept patch. Source: judgement; half a patch of least-squares matching to either side.
_SIDE = 7
#: Half the side of the window of a corner's structure. Source: judgement.
_WINDOW = 5
#: Pixels of the small picture from its edge within which there is no corner, and no place for one. Source: half a
#: patch of least-squares matching and what it may move.
_BORDER = 8
#: Rounds in which the ray of a pixel, and the row that shows a point, are found. Source: numerics.
_ROUNDS = 3
#: Depths at most, and at least. Source: numerics; 128 steps of two pixels reach across a fifth of a photo.
_MOST_DEPTHS, _LEAST_DEPTHS = 128, 16
#: A neighbour shows the thing so many times larger or smaller at most. Source: judgement.
_MOST_RATIO = 1.6
#: What lens and motion add to a pinhole's place is held within so many pixels: behind a camera it has no meaning.
#: Source: numerics.
_MOST_BENT = 100.0
#: Standard deviation of grey values that stands for none. Source: judgement; a tenth of a step of eight bits.
_LEAST_CONTRAST = 0.1
#: Patches sampled together. Source: OpenCV's remap takes pictures of up to 32,767 rows.
_TOGETHER = 16384


@dataclass(frozen=True, kw_only=True)
class Swept:
    """Corners, and the depth at which most of a photo's neighbours show the same.

    Attributes
    ----------
    points: (n, 3) world. likeness: (n,) mean normalised correlation with the two neighbours that are most alike.
    """

    points: Floats
    likeness: Floats


def small_picture(grey: NDArray[np.uint8], step_px: float) -> Bytes:
    """A photo in which corners are found and swept; ``step_px`` as in :class:`~.rematch.Photos`."""
    size = [max(round(side / (SMALLER * step_px)), 1) for side in grey.shape[::-1]]
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (0, 0), _SMOOTHING), dtype=np.uint8)


def corners(picture: Bytes, count: int) -> Floats:
    """(n, 2) one corner in each of about ``count`` parts of a small picture; pixels of it, COLMAP's origin."""
    height, width = picture.shape
    columns = max(int(np.sqrt(count * width / height)), 1)
    rows = max(count // columns, 1)
    across = np.linspace(_BORDER, width - _BORDER, columns + 1).astype(int)
    down = np.linspace(_BORDER, height - _BORDER, rows + 1).astype(int)
    if min(np.diff(across).min(), np.diff(down).min()) < 1:
        return np.empty((0, 2))
    structure = cv2.cornerMinEigenVal(picture, _WINDOW)
    found = []
    for top, bottom in pairwise(down):
        for left, right in pairwise(across):
            part = structure[top:bottom, left:right]
            y, x = divmod(int(part.argmax()), part.shape[1])
            if part[y, x] > 0:
                found.append((left + x + 0.5, top + y + 0.5))
    return np.array(found, dtype=np.float64).reshape(-1, 2)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Photos in which corners are swept.

    Attributes
    ----------
    pictures: :func:`small_picture` of each. sizes: (N, 2) of the photos, pixels. camera: (N,) which lens each has.
    at: where the cameras are, to a pixel.
    """

    pictures: Sequence[Bytes]
    sizes: Ints
    camera: Ints
    at: Unknowns

    def of(self, photo: int, xy: Floats, near: float, far: float, neighbours: Ints) -> Swept:
        """(n, 2) corners of a photo, its pixels, between two depths, laid over some neighbours."""
        rays = self._rays(photo, xy)
        reach = max(float(np.linalg.norm(self.at.centers[other] - self.at.centers[photo])) for other in neighbours)
        widest = reach * self._focal(photo) * (1 / near - 1 / far) / self.scale(photo)
        inverse = np.linspace(1 / far, 1 / near, int(np.clip(widest, _LEAST_DEPTHS, _MOST_DEPTHS)))
        around = (xy / self.scale(photo) - 0.5).astype(np.float32)[:, None] + _SIDE_GRID
        own = _normalised(_sampled(self.pictures[photo], around))
        likeness = np.stack([self._likeness(photo, other, rays, inverse, own) for other in neighbours])
        likeness = np.sort(likeness, axis=0)[-2:].mean(axis=0)
        best = likeness.argmax(axis=1)
        inside = rays / inverse[best, None]
        return Swept(
            points=(inside - self.at.translations[photo]) @ self.at.rotations[photo],
            likeness=likeness[np.arange(len(xy)), best].astype(np.float64),
        )

    def scale(self, photo: int) -> float:
        """Pixels of a photo that one of its small picture is wide."""
        return float(self.sizes[photo, 0] / self.pictures[photo].shape[1])

    def _focal(self, photo: int) -> float:
        return float(self.at.lenses[self.camera[photo], 0] * np.exp(self.at.own[photo, FOCAL][0]))

    def _rays(self, photo: int, xy: Floats) -> Floats:
        """(n, 3) in the camera, z = 1, of pixels of a photo; what it moved during the read-out is left out."""
        lens, own = self._of_photo(photo, len(xy))
        own[:, DRIFT] = 0
        tau = read_at_of(xy, self.sizes[[photo]].repeat(len(xy), axis=0))
        rays = np.ones((len(xy), 3))
        rays[:, :2] = (xy - lens[:, 2:4]) / lens[:, :2]
        for _ in range(_ROUNDS):
            rays[:, :2] -= (project(rays, tau, lens, own) - xy) / lens[:, :2]
        return rays

    def _of_photo(self, photo: int, count: int) -> tuple[Floats, Floats]:
        lens = self.at.lenses[[self.camera[photo]]].repeat(count, axis=0)
        return lens, self.at.own[[photo]].repeat(count, axis=0)

    def _likeness(self, photo: int, other: int, rays: Floats, inverse: Floats, own: Floats32) -> Floats32:
        """(n, depths) normalised correlation of each corner's patch with what ``other`` shows there; -1 outside."""
        turn = self.at.rotations[other] @ self.at.rotations[photo].T
        shift = self.at.translations[other] - turn @ self.at.translations[photo]
        at_infinity = rays @ turn.T
        # A point in the other camera, times its inverse depth in the photo.
        there = at_infinity[:, None].astype(np.float32) + (inverse[:, None] * shift).astype(np.float32)
        depth = there[:, :, 2]
        scale = self.scale(other)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.float32(self._focal(other) / self._focal(photo)) / depth
            place = there[:, :, :2] / depth[:, :, None] * np.float32(self._focal(other))
        middle = self.at.lenses[self.camera[other], 2:4] + self.at.own[other, PRINCIPAL]
        place += middle.astype(np.float32) + self._bent(other, at_infinity, shift, inverse, middle)
        size = self.sizes[other]
        border = np.float32(_BORDER * scale)
        seen = (depth > 0) & (ratio < _MOST_RATIO) & (ratio > 1 / _MOST_RATIO)
        seen &= ((place > border) & (place < size.astype(np.float32) - border)).all(axis=2)
        found = np.full(seen.shape, -1, np.float32)
        row, column = np.nonzero(seen)
        if len(row) == 0:
            return found
        # From pixels about the corner in its own small picture to those there.
        map_there = _turn_about_sight(turn) * self.scale(photo) / scale
        grid = (_SIDE_GRID.astype(np.float64) @ map_there.T).astype(np.float32)
        values = np.empty(len(row), np.float32)
        for first in range(0, len(row), _TOGETHER):
            part = slice(first, first + _TOGETHER)
            r, c = row[part], column[part]
            at = ratio[r, c][:, None, None] * grid + (place[r, c] / np.float32(scale) - np.float32(0.5))[:, None]
            patches = _sampled(self.pictures[other], at)
            values[part] = _correlation(patches, own[r])
        found[row, column] = values
        return found

    def _bent(self, other: int, at_infinity: Floats, shift: Floats, inverse: Floats, middle: Floats) -> Floats32:
        """(n, depths, 2) pixels that lens and read-out add to the places of a pinhole."""
        count, lens = len(at_infinity), self.at.lenses[self.camera[other]]
        nodes = np.linspace(inverse[0], inverse[-1], 3)
        inside = ((at_infinity[:, None] + nodes[:, None] * shift) / nodes[:, None]).reshape(-1, 3)
        inside[:, 2] = np.maximum(inside[:, 2], np.finfo(np.float32).eps)
        lenses, own = self._of_photo(other, len(inside))
        sizes = self.sizes[[other]].repeat(len(inside), axis=0)
        tau = np.zeros(len(inside))
        for _ in range(_ROUNDS):
            pixels = project(inside, tau, lenses, own)
            tau = np.clip(read_at_of(pixels, sizes), -0.5, 0.5)
        plain = inside[:, :2] / inside[:, 2:] * (lens[:2] * np.exp(self.at.own[other, FOCAL])) + middle
        added = np.clip(pixels - plain, -_MOST_BENT, _MOST_BENT).reshape(count, 3, 2).astype(np.float32)
        share = np.linspace(0, 2, len(inverse), dtype=np.float32)
        weights = np.maximum(0, 1 - np.abs(share[:, None] - np.arange(3, dtype=np.float32)))
        return np.asarray(np.einsum("dj,njk->ndk", weights, added))


def _turn_about_sight(turn: Floats) -> Floats:
    """(2, 2) of a rotation from one camera to another, the turn about the line of sight."""
    along, across = turn[0, 0] + turn[1, 1], turn[1, 0] - turn[0, 1]
    length = max(float(np.hypot(along, across)), np.finfo(float).tiny)
    return np.array([[along, -across], [across, along]]) / length


def _sampled(picture: Bytes, at: Floats32) -> Floats32:
    """(n, k) values of a picture at (n, k, 2) pixels whose centres are whole numbers."""
    x, y = np.ascontiguousarray(at[:, :, 0], np.float32), np.ascontiguousarray(at[:, :, 1], np.float32)
    return cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).astype(np.float32)


def _normalised(values: Floats32) -> Floats32:
    """(n, k) of mean zero and length one."""
    values = values - values.mean(axis=1, keepdims=True)
    return np.asarray(values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), _LEAST_CONTRAST))


def _correlation(values: Floats32, own: Floats32) -> Floats32:
    """(n,) of (n, k) values with (n, k) normalised ones."""
    spread = np.einsum("nk,nk->n", values, values) - values.sum(axis=1) ** 2 / values.shape[1]
    return np.asarray(np.einsum("nk,nk->n", values, own) / np.sqrt(np.maximum(spread, _LEAST_CONTRAST**2)))


def _grid() -> Floats32:
    along = np.arange(_SIDE, dtype=np.float32) - _SIDE // 2
    y, x = np.meshgrid(along, along, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)


#: (k, 2) x and y of a swept patch's samples. Source: arithmetic.
_SIDE_GRID = _grid()

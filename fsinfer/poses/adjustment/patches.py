"""Least-squares matching: where a photo shows a small patch of another, to a tenth of a pixel.

A patch of the one is laid over the other by an affine map, brightness and contrast free, until their differences are
least (Gruen 1985, "Adaptive least squares correlation"; Foerstner 1982). The derivatives are those of the patch, which
does not change from step to step (the inverse compositional algorithm, Baker and Matthews 2004), and brightness and
contrast are taken out of them beforehand, so that a step is one product of a matrix and the pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

#: Half the side of a patch, in its steps: it has 15 x 15 samples. Source: judgement; a feature's blob and its rim.
_HALF = 7
#: Samples along a side of a patch with those for its derivatives. Source: arithmetic.
PATCH_SIDE = 2 * _HALF + 3
#: Standard deviation of the weight that falls off from its middle, in steps. Source: judgement; three fifths of that.
_WEIGHT_STD = 4.0
#: The photos are smoothed so much, in steps, before patches are taken from them: bilinear interpolation is far from the
#: truth on what a single pixel shows. Source: docs/trials-accuracy.md; simulated pictures.
_SMOOTHING = 0.7
#: Steps at most; the shift, in steps of the patch, after which no other follows, and below which the last one may be of
#: a patch that has come to rest. Source: numerics.
_STEPS, _AT_REST, _NEARLY_AT_REST = 10, 0.01, 0.05
#: Patches worked on together. Source: numerics; their derivatives stay in a core's cache.
_TOGETHER = 192
#: Standard deviation of grey values that stands for none. Source: judgement; a tenth of a step of eight bits.
_LEAST_CONTRAST = 0.1
#: Share of the mean of a patch's normal matrix that is added to its diagonal: of a patch without structure in one
#: direction nothing is asked in it. Source: numerics.
_DAMPING = 1e-5
#: A patch whose area shrinks by more in a step has gone astray. Source: numerics.
_LEAST_AREA = 0.2


@dataclass(frozen=True, kw_only=True)
class Matches:
    """Where patches were found.

    Attributes
    ----------
    xy: (n, 2) pixels, COLMAP's origin, of the patches' middles. affine: (n, 2, 2) from pixels about the middle of the
        patch in its own photo to those in the other.
    correlation: (n,) normalised, weighted; 1 is alike.
    at_rest: (n,) bool, whether it stayed where it was at the last step.
    std: (n,) pixels, of a coordinate, from the differences that are left and how sharp the patch is.
    """

    xy: Floats
    affine: Floats
    correlation: Floats
    at_rest: NDArray[np.bool_]
    std: Floats


def smoothed(grey: NDArray[np.uint8], step_px: float) -> Floats32:
    """A photo as patches are taken from and laid over it."""
    return np.asarray(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTHING * step_px))


def patches_at(image: Floats32, xy: Floats, step_px: float) -> Floats32:
    """(n, PATCH_SIDE, PATCH_SIDE) values, a step apart, about (n, 2) pixels, COLMAP's origin, of a smoothed photo."""
    grid = _grid(_HALF + 1) * step_px
    values = np.empty((len(xy), PATCH_SIDE * PATCH_SIDE), np.float32)
    for rows in _parts(len(xy)):
        at = (xy[rows, None] + grid).astype(np.float32)
        values[rows] = _sampled(image, at[:, :, 0], at[:, :, 1])
    return values.reshape(-1, PATCH_SIDE, PATCH_SIDE)


def align(patches: Floats32, image: Floats32, xy: Floats, affine: Floats, step_px: float) -> Matches:
    """Lay patches of :func:`patches_at` over a smoothed photo, from (n, 2) pixels and (n, 2, 2) affine maps on."""
    found = Matches(
        xy=np.array(xy, dtype=np.float64),
        affine=np.array(affine, dtype=np.float64),
        correlation=np.zeros(len(xy)),
        at_rest=np.zeros(len(xy), dtype=bool),
        std=np.full(len(xy), np.inf),
    )
    for rows in _parts(len(xy)):
        _align(patches[rows], image, found, rows, step_px)
    return found


def _align(patches: Floats32, image: Floats32, found: Matches, rows: slice, step: float) -> None:
    """Part of :func:`align`; what is in ``found`` is where it begins, and what it finds is put there."""
    basis, shifts_of = _basis(patches)
    squares = _weights()
    grid = _grid(_HALF).astype(np.float32)
    xy, affine = found.xy[rows], found.affine[rows]
    begin = xy.copy()
    at_rest, correlation = found.at_rest[rows], found.correlation[rows]
    active = np.arange(len(xy))
    for _ in range(_STEPS):
        values = _laid(image, xy[active], affine[active] * step, grid)
        seen = (basis[active] @ values[:, :, None])[:, :, 0].astype(np.float64)
        spread = np.sqrt(np.maximum((values * values) @ squares - seen[:, 7] ** 2, _LEAST_CONTRAST**2))
        correlation[active] = seen[:, 6] / spread
        change = (shifts_of[active] @ (seen[:, :6] / spread[:, None])[:, :, None])[:, :, 0]
        turned = np.eye(2) + change[:, 2:].reshape(-1, 2, 2)
        determinant = turned[:, 0, 0] * turned[:, 1, 1] - turned[:, 0, 1] * turned[:, 1, 0]
        sane = determinant > _LEAST_AREA
        turned[~sane] = np.eye(2)
        back = np.linalg.inv(turned)
        shift = -((affine[active] @ back) @ change[:, :2, None])[:, :, 0] * step
        xy[active] += shift
        affine[active] = affine[active] @ back
        moved = np.linalg.norm(shift, axis=1) / step
        astray = ~sane | (np.abs(xy[active] - begin[active]).max(axis=1) > _HALF * step)
        at_rest[active] = (moved < _NEARLY_AT_REST) & ~astray
        active = active[(moved > _AT_REST) & ~astray]
        if len(active) == 0:
            break
    # Of the differences between two patches of one scene half are each one's own; in the photo a step is so long:
    stretch = np.sqrt(np.abs(affine[:, 0, 0] * affine[:, 1, 1] - affine[:, 0, 1] * affine[:, 1, 0])) * step
    noise = np.maximum(2 * (1 - correlation), 1e-3)
    worst = np.maximum(shifts_of[:, 0, 0], shifts_of[:, 1, 1])
    found.std[rows] = np.sqrt(noise * worst * float((squares**2).sum())) * stretch


def _basis(values: Floats32) -> tuple[Floats32, Floats]:
    """What the pixels laid under patches are multiplied with, and what turns that into the next step.

    Returns
    -------
    basis: (n, 8, k). Six rows are the weighted derivatives by the affine map, the mean and the patch taken out of them;
        one is the patch, its mean taken out; the last gives the mean. All are of unit contrast.
    shifts_of: (n, 6, 6): the six products to a change of the map, in steps.
    """
    count = len(values)
    squares = _weights()
    inner = np.ascontiguousarray(values[:, 1:-1, 1:-1]).reshape(count, -1)
    by_x = (0.5 * (values[:, 1:-1, 2:] - values[:, 1:-1, :-2])).reshape(count, -1)
    by_y = (0.5 * (values[:, 2:, 1:-1] - values[:, :-2, 1:-1])).reshape(count, -1)
    x, y = _grid(_HALF).astype(np.float32).T
    basis = np.empty((count, 8, len(squares)), np.float32)
    basis[:, 0], basis[:, 1] = by_x, by_y
    np.multiply(by_x, x, out=basis[:, 2])
    np.multiply(by_x, y, out=basis[:, 3])
    np.multiply(by_y, x, out=basis[:, 4])
    np.multiply(by_y, y, out=basis[:, 5])
    patch = inner - (inner @ squares)[:, None]
    # The derivatives are in units of the contrast as the patch is, and as what it is laid over will be.
    contrast = np.sqrt(np.maximum((patch * patch) @ squares, _LEAST_CONTRAST**2))
    patch /= contrast[:, None]
    derivatives = basis[:, :6]
    derivatives /= contrast[:, None, None]
    derivatives -= (derivatives @ squares)[:, :, None]
    along = (derivatives @ (patch * squares)[:, :, None])[:, :, 0]
    derivatives -= along[:, :, None] * patch[:, None]
    weighted = derivatives * squares
    normal = (weighted @ derivatives.transpose(0, 2, 1)).astype(np.float64)
    mean = np.trace(normal[:, :2, :2], axis1=1, axis2=2) / 2
    normal += np.eye(6) * (_DAMPING * mean + 1e-12)[:, None, None]
    basis[:, :6] = weighted
    basis[:, 6] = patch * squares
    basis[:, 7] = squares
    return basis, np.asarray(np.linalg.inv(normal), dtype=np.float64)


def _laid(image: Floats32, xy: Floats, affine: Floats, grid: Floats32) -> Floats32:
    """(n, k) values of a photo where (k, 2) ``grid`` lies in it."""
    matrix, middle = affine.astype(np.float32), xy.astype(np.float32)
    x = matrix[:, 0, 0, None] * grid[:, 0] + (matrix[:, 0, 1, None] * grid[:, 1] + middle[:, 0, None])
    y = matrix[:, 1, 0, None] * grid[:, 0] + (matrix[:, 1, 1, None] * grid[:, 1] + middle[:, 1, None])
    return _sampled(image, x, y)


def _sampled(image: Floats32, x: Floats32, y: Floats32) -> Floats32:
    """Values at pixels of COLMAP's origin; those outside are the nearest inside."""
    x = x - np.float32(0.5)
    y = y - np.float32(0.5)
    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _grid(half: int) -> Floats:
    """(k, 2) x and y of a patch's samples, row by row."""
    along = np.arange(-half, half + 1, dtype=np.float64)
    y, x = np.meshgrid(along, along, indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)


def _weights() -> Floats32:
    """(k,) weights of a patch's samples, which add up to one."""
    weights = np.exp(-0.5 * (_grid(_HALF) ** 2).sum(1) / _WEIGHT_STD**2)
    return np.asarray(weights / weights.sum(), dtype=np.float32)


def _parts(count: int) -> Iterator[slice]:
    for first in range(0, count, _TOGETHER):
        yield slice(first, min(first + _TOGETHER, count))

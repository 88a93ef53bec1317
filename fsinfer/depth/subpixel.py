"""The last tenth of a pixel: depth of the network set right by the photographs at their full size.

The network compares features at a quarter and at half of the resolution, and nobody looks at the full-size pixels
again. Here each pixel of the depth map keeps its surface as the network has it, and that is moved along the viewing
rays until the photographs round the pixel agree best: a few Gauss-Newton steps of least squares matching (Gruen,
South African Journal of Photogrammetry, Remote Sensing and Cartography 14, 1985), with the shift along the epipolar
lines as the only unknown of a window and all sources in one system, as in multiphoto matching (Baltsavias, Multiphoto
geometrically constrained matching, ETH Zurich 1991). With the locally normalised grey values I of the reference and
I_s of a source, warped by the depth map,

    shift = sum_s w_s (dI_s / dshift) (I - I_s)  /  (sum_s w_s (dI_s / dshift)^2 + damping),

sums over a Gaussian window. Where there is no texture along the lines the damping leaves the depth as it is; sources
that do not show the same place (hidden, beyond the border) lose their weight by their correlation with the reference.

A pixel of a depth map of stride k stands for k x k of the photograph, of which a step looks at every other one, like
the squares of one colour of a chessboard, and the next step at the others: neighbours tell much the same. What is
summed over a window is first summed over them, so that windows are looked through at the size of the map.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.blocks import over_blocks
from fsinfer.depth.photo_confidence import LEAST_SEEN, NO_MISFIT, LastStep
from fsinfer.depth.settings import SubpixelSettings
from fsinfer.depth.warping import Projection, relative_projection
from fsinfer.threads import in_order

Float16 = NDArray[np.float16]
Float32 = NDArray[np.float32]
#: Mean of values (h, w) about each pixel.
_Window = Callable[[Float32], Float32]

#: Pixels of the photograph at a time, of each thread: the fewer steps, the less threads wait for each other. Source:
#: numerics; a map of 640x352 in two blocks (docs/trials-speed.md).
BLOCK_PIXELS = 228_000
#: A Gaussian window ends at so many standard deviations. Source: numerics.
WINDOW_ENDS = 3.0
#: Keeps divisions finite. Source: numerics.
_TINY = np.float32(1e-9)


def normalised(image: NDArray[np.uint8], settings: SubpixelSettings | None = None) -> Float16:
    """Grey values (H, W) of an (H, W, 3) RGB image less their local mean, over their local standard deviation.

    Exposure, glare and shade drop out; noise in flat places stays small (``least_contrast``). In half precision, for
    the stage keeps those of many views.
    """
    s = settings or SubpixelSettings()
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    mean = np.asarray(cv2.GaussianBlur(grey, (0, 0), s.normalise_px), np.float32)
    spread = np.asarray(cv2.GaussianBlur(grey * grey, (0, 0), s.normalise_px), np.float32)
    grey -= mean
    mean *= mean
    spread -= mean
    np.maximum(spread, 0, out=spread)
    spread += np.float32(s.least_contrast**2)
    np.sqrt(spread, out=spread)
    # OpenCV divides and halves in one step, a fifth of NumPy's time for both.
    return np.asarray(cv2.divide(grey, spread, dtype=cv2.CV_16F), np.float16)


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """Depth map (h, w) in the units of the poses, 0 where nothing is known, and what the last step saw, if any."""

    depth: Float32
    last: LastStep | None


def refine_depth(
    depth: Float32,
    confidence: Float32,
    greys: Sequence[Float16],
    intrinsics: NDArray[np.float64],
    cam_from_world: NDArray[np.float64],
    *,
    settings: SubpixelSettings | None = None,
    threads: int = 1,
) -> Refinement:
    """Depth at a tenth of a pixel; 0 stays 0.

    Parameters
    ----------
    depth, confidence: (h, w) of the network, pixel (i, j) at image pixel (stride i, stride j), stride 1, 2 or 4.
    greys: N >= 2 maps (H, W) of :func:`normalised`; the first is the reference.
    intrinsics, cam_from_world: (N, 3, 3) pixels and (N, 4, 4).
    """
    s = settings or SubpixelSettings()
    if s.rounds == 0:
        return Refinement(depth=depth, last=None)
    images = list(in_order(_in_32_bits, greys, threads))
    stride = round(images[0].shape[1] / depth.shape[1])
    projections = [
        relative_projection(intrinsics[0], cam_from_world[0], intrinsics[i], cam_from_world[i], 1.0)
        for i in range(1, len(images))
    ]
    known = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=known)
    weight = np.where(known, confidence, 0).astype(np.float32)
    whole = _cut(images[0], stride, depth.shape)
    window = partial(_mean_about, kernel=_window_kernel(s.window_px, stride))
    for left in reversed(range(s.rounds)):
        before = inverse
        parts = whole.of_one_colour(left)
        moved, seen = _step(before, weight, parts, images[1:], projections, window, s, threads=threads)
        # Of a map at half size three pixels reach as far as five of the photograph.
        side = 2 * (s.median_px // 2 // min(stride, 2)) + 1
        inverse = np.asarray(cv2.medianBlur(moved, side), np.float32) if s.median_px else moved
    refined = np.divide(1.0, inverse, out=np.zeros_like(depth), where=known & (inverse > 0))
    return Refinement(depth=np.asarray(refined, np.float32), last=_last_step(seen, before, parts, window))


def _in_32_bits(grey: Float16) -> Float32:
    """OpenCV takes a third of NumPy's time."""
    return np.asarray(cv2.addWeighted(grey, 1.0, grey, 0.0, 0.0, dtype=cv2.CV_32F), np.float32)


@dataclass(frozen=True)
class _Parts:
    """The reference in ``stride`` x ``stride`` parts P, each of the depth map's shape; the first at its places.

    ``grey`` (P, h, w) are its pixels (stride i + down, stride j + right), NaN beyond its border; ``down``, ``right``
    (P,).
    """

    stride: int
    down: NDArray[np.int64]
    right: NDArray[np.int64]
    grey: Float32

    def of_one_colour(self, steps_left: int) -> _Parts:
        """Every other part, in turns; the last step has the first, at its place. One alone is looked at each time."""
        if self.stride == 1:
            return self
        chosen = (self.down + self.right + steps_left) % 2 == 0
        return _Parts(self.stride, self.down[chosen], self.right[chosen], self.grey[chosen])


def _cut(reference: Float32, stride: int, shape: tuple[int, int]) -> _Parts:
    height, width = shape
    whole = np.full((height * stride, width * stride), np.nan, np.float32)
    whole[: reference.shape[0], : reference.shape[1]] = reference
    grey = whole.reshape(height, stride, width, stride).transpose(1, 3, 0, 2).reshape(-1, height, width)
    return _Parts(stride, *np.divmod(np.arange(stride**2), stride), np.ascontiguousarray(grey))


@dataclass(frozen=True)
class _Sums:
    """Of each source, over the parts of each pixel of the depth map: (S, h, w).

    ``speed``: pixels of the source to a unit of inverse depth. ``squares``: of the differences of grey values.
    ``normal``, ``right``: of the least squares, slopes in grey values to two ``difference_px``, without the weights
    that all parts of a pixel share. ``seen``: 1 where the source shows the place.
    """

    speed: Float32
    squares: Float32
    normal: Float32
    right: Float32
    seen: Float32


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """What a step saw: of each source (S, h, w) the share that it shows and the misfit; the sums of the least squares,
    the shift and how fast the fastest source moves (h, w). All but the last are means in the window.
    """

    share: Float32
    misfit: Float32
    known: Float32
    sure: Float32
    shift: Float32
    fastest: Float32


def _step(
    inverse: Float32,
    weight: Float32,
    parts: _Parts,
    sources: Sequence[Float32],
    projections: Sequence[Projection],
    window: _Window,
    s: SubpixelSettings,
    *,
    threads: int,
) -> tuple[Float32, _Seen]:
    """One Gauss-Newton step: inverse depth (h, w), and what was seen before it."""
    height, width = inverse.shape
    sums = _Sums(*(np.empty((len(sources), height, width), np.float32) for _ in range(5)))
    fastest = np.empty_like(inverse)
    most_rows = max(1, BLOCK_PIXELS // (len(parts.grey) * width))
    block_rows = min(most_rows, math.ceil(height / threads))

    def fill(first: int) -> None:
        rows = slice(first, min(first + block_rows, height))
        surfaces = _surfaces(inverse, rows, parts)
        for i, (source, projection) in enumerate(zip(sources, projections, strict=True)):
            _sum_parts(sums, i, rows, surfaces, parts, source, projection, s)
        np.maximum(sums.speed[:, rows].max(axis=0), _TINY, out=fastest[rows])

    over_blocks(fill, height, block_rows, threads)
    each = np.float32(1 / len(parts.grey))
    normal, right = sums.normal, sums.right
    seen, misfit = sums.seen, sums.squares  # in their places

    def weigh(i: int) -> None:
        seen[i] = window(seen[i])
        # Of two signals of variance 1 the mean squared difference is 2 - 2 r, r their correlation.
        misfit[i] = np.float32(0.5) * each * window(sums.squares[i]) / (seen[i] + _TINY)
        correlation = 1 - misfit[i]
        agrees = np.clip((correlation - s.least_correlation) / (s.full_correlation - s.least_correlation), 0, 1) ** 2
        slower = sums.speed[i] / fastest * np.float32(0.5 / s.difference_px)
        part = each * agrees * weight * slower
        right[i] *= part
        part *= slower
        normal[i] *= part

    over_blocks(weigh, len(sources), 1, threads)
    maps: list[Callable[[], Float32]] = [partial(normal.sum, axis=0), lambda: weight, partial(right.sum, axis=0)]
    known, sure, shift = in_order(lambda make: window(make()), maps, threads)
    held = known + np.float32(s.damping) * sure
    shift /= held + _TINY
    np.clip(shift, -s.most_px, s.most_px, out=shift)
    moved = inverse + shift / fastest
    # Nothing is moved beyond infinity, and what has no depth keeps none.
    moved = np.where((moved > 0) & (inverse > 0), moved, inverse)
    return moved, _Seen(
        share=seen,
        misfit=misfit,
        known=known,
        sure=sure,
        shift=np.asarray(shift, np.float32),
        fastest=fastest,
    )


def _last_step(seen: _Seen, inverse: Float32, parts: _Parts, window: _Window) -> LastStep:
    """What is told of the last step, which was made from ``inverse`` (h, w)."""
    shown = seen.share > LEAST_SEEN
    squares = np.asarray((parts.grey**2).sum(axis=0), np.float32)
    cv2.patchNaNs(squares, 0.0)
    return LastStep(
        sources=np.count_nonzero(shown, axis=0).astype(np.float32),
        misfit=np.where(shown, seen.misfit, np.float32(NO_MISFIT)).min(axis=0),
        variance=window(squares / np.float32(len(parts.grey))),
        texture=seen.known / (seen.sure + _TINY),
        shift_px=seen.shift,
        px_per_percent=np.float32(0.01) * seen.fastest * inverse,
    )


def _mean_about(values: Float32, kernel: Float32) -> Float32:
    """Mean (h, w) of the ``values`` (h, w) about each pixel, weighted with ``kernel`` in both directions."""
    return np.asarray(cv2.sepFilter2D(values, -1, kernel, kernel, borderType=cv2.BORDER_REPLICATE), np.float32)


def _window_kernel(window_px: float, stride: int) -> Float32:
    """Gaussian of ``window_px`` at the pixels of the depth map round one: (n,), n odd, sum 1.

    A pixel of the map stands for ``stride`` of the photograph, the first at its place: their middle lies beside it, and
    they are a window themselves.
    """
    sigma = np.sqrt(window_px**2 - (stride**2 - 1) / 12) / stride
    half = int(np.ceil(WINDOW_ENDS * sigma))
    away = np.arange(-half, half + 1) + (stride - 1) / (2 * stride)
    kernel = np.exp(-0.5 * (away / sigma) ** 2)
    return np.asarray(kernel / kernel.sum(), np.float32)


def _sum_parts(
    sums: _Sums,
    index: int,
    rows: slice,
    surfaces: Float32,
    parts: _Parts,
    source: Float32,
    projection: Projection,
    s: SubpixelSettings,
) -> None:
    """Fill ``rows`` of the sums of one source. All parts at a time: the fewer steps, the less threads wait.

    ``surfaces`` (P, n, w) are the inverse depths of these rows.
    """
    u, v, scale = _places(projection, surfaces, rows, parts)
    # The other parts are less than ``stride`` pixels away: their lines run alike.
    along, sums.speed[index, rows] = _epipolar(projection, u[0], v[0], scale[0], s.difference_px)
    ahead = _looked_up(source, u + along[0], v + along[1])
    u -= along[0]
    v -= along[1]
    away = _looked_up(source, u, v)
    slope = ahead - away
    away += ahead
    away *= np.float32(-0.5)
    away += parts.grey[:, rows]
    np.isfinite(away[0], out=sums.seen[index, rows], casting="unsafe")
    _without_nans(away)
    _without_nans(slope)
    one = np.multiply(away, away, out=ahead)
    one.sum(axis=0, out=sums.squares[index, rows])
    robust = np.abs(away, out=one)
    np.maximum(robust, np.float32(s.outlier), out=robust)
    np.divide(np.float32(s.outlier), robust, out=robust)
    robust *= slope
    slope *= robust
    away *= robust
    slope.sum(axis=0, out=sums.normal[index, rows])
    away.sum(axis=0, out=sums.right[index, rows])


def _without_nans(values: Float32) -> None:
    """Zeros in their place."""
    cv2.patchNaNs(values.reshape(-1, values.shape[-1]), 0.0)


def _places(projection: Projection, inverse: Float32, rows: slice, parts: _Parts) -> tuple[Float32, Float32, Float32]:
    """Place (u, v) in the source of each pixel of the parts (P, h, w), and one over its depth there times its own.

    NaN behind it.
    """
    m, e = projection.matrix.astype(np.float32), projection.offset.astype(np.float32)
    x = np.arange(inverse.shape[2], dtype=np.float32) * np.float32(parts.stride) + parts.right[:, None]
    y = np.arange(rows.start, rows.stop, dtype=np.float32) * np.float32(parts.stride) + parts.down[:, None]
    x, y = (values.astype(np.float32) for values in (x[:, None], y[..., None]))

    def row_of_matrix(i: int) -> Float32:
        found: Float32 = inverse * e[i]
        found += m[i, 0] * x
        found += m[i, 1] * y + m[i, 2]
        return found

    scale, u, v = row_of_matrix(2), row_of_matrix(0), row_of_matrix(1)
    if scale.min() <= _TINY:
        scale[scale <= _TINY] = np.nan
    np.divide(np.float32(1), scale, out=scale)
    u *= scale
    v *= scale
    return u, v, scale


def _epipolar(
    projection: Projection, u: Float32, v: Float32, scale: Float32, length_px: float
) -> tuple[tuple[Float32, Float32], Float32]:
    """Steps of ``length_px`` along the epipolar lines, and pixels to a unit of inverse depth; 0 behind the source."""
    e = projection.offset.astype(np.float32)
    along_u, along_v = (e[0] - u * e[2]) * scale, (e[1] - v * e[2]) * scale
    speed = np.sqrt(along_u * along_u + along_v * along_v)
    np.nan_to_num(speed, copy=False, nan=0.0)
    unit = np.divide(np.float32(length_px), speed, out=np.zeros_like(speed), where=speed > 0)
    along_u *= unit
    along_v *= unit
    return (along_u, along_v), speed


def _looked_up(image: Float32, u: Float32, v: Float32) -> Float32:
    """(P, h, w) of ``image`` (H, W) at ``u``, ``v`` (P, h, w), bilinear; NaN beyond the border."""
    x, y = (values.reshape(-1, values.shape[-1]) for values in (u, v))
    found = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))
    return np.asarray(found, np.float32).reshape(u.shape)


def _surfaces(inverse: Float32, rows: slice, parts: _Parts) -> Float32:
    """Inverse depth (P, n, w) of each part of ``rows`` of a map (h, w).

    Between two surfaces it is that of neither, which their weights bear; staying on one brought nothing.
    """
    # The last row, and column, is followed by itself.
    above = inverse[rows]
    below = inverse[np.minimum(np.arange(rows.start + 1, rows.stop + 1), len(inverse) - 1)]
    found = np.empty((len(parts.grey), *above.shape), np.float32)
    for surface, down, right in zip(found, parts.down.tolist(), parts.right.tolist(), strict=True):
        np.copyto(surface, _between(above, below, down / parts.stride))
        if right:
            beside = np.concatenate([surface[:, 1:], surface[:, -1:]], axis=1)
            np.copyto(surface, _between(surface, beside, right / parts.stride))
    return found


def _between(one: Float32, other: Float32, share: float) -> Float32:
    """``share`` of the way from the one to the other."""
    return one if share == 0 else np.asarray(np.float32(1 - share) * one + np.float32(share) * other, np.float32)

"""Depth error figures that evaluation and the training log share."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError


@dataclass(frozen=True, kw_only=True)
class DepthErrors:
    """Errors of one depth map over the pixels with truth.

    Attributes
    ----------
    median_rel: median of |d - t| / t.  within_1pct: share of all pixels with truth whose error is below 1 %.
    within_1pct_sure: the same among the surer 70 %.  median_abs, median_abs_sure: in scene units.
    within_3cm_sure: share of the surer 70 % within 0.03 scene units.
    flying, flying_sure: share of the pixels at silhouettes that hang in the air (:func:`flying_pixels`), of all and of
        those among the surer 70 %; NaN where the view has no silhouette.
    """

    pixels: int
    median_rel: float
    within_1pct: float
    within_1pct_sure: float
    median_abs: float
    median_abs_sure: float
    within_3cm_sure: float
    flying: float
    flying_sure: float

    def to_dict(self) -> dict[str, float]:
        """Return the fields as plain values."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class PixelErrors:
    """The pixels with truth of one view, (n,) float32 each: confidence, absolute and relative error."""

    confidence: NDArray[np.float32]
    absolute: NDArray[np.float32]
    relative: NDArray[np.float32]

    @property
    def sure(self) -> NDArray[np.bool_]:
        """(n,) bool, the surer 70 % of them."""
        return np.asarray(self.confidence >= np.quantile(self.confidence, 0.3))


def known_pixels(truth: NDArray[np.float32], min_depth: float = 0.0, max_depth: float = np.inf) -> NDArray[np.bool_]:
    """Pixels whose true depth is known (not 0), from ``min_depth`` on and nearer than ``max_depth``."""
    return np.asarray((truth > 0) & (truth >= min_depth) & (truth < max_depth))


def pixel_errors(
    depth: NDArray[np.float32],
    confidence: NDArray[np.float32],
    truth: NDArray[np.float32],
    *,
    min_depth: float = 0.0,
    max_depth: float = np.inf,
) -> PixelErrors:
    """Errors of a depth map at the pixels with truth, all (h, w) on one grid; a missing estimate (0) is wrong."""
    known = known_pixels(truth, min_depth, max_depth)
    absolute = np.abs(depth[known] - truth[known])
    return PixelErrors(confidence=confidence[known], absolute=absolute, relative=absolute / truth[known])


def pool(pixels: list[PixelErrors]) -> PixelErrors:
    """All views' pixels in one; :class:`SceneError` where there are none."""
    if not any(len(part.relative) for part in pixels):
        msg = f"no pixel of {len(pixels)} views has a true depth in the range asked for; nothing to judge"
        raise SceneError(msg)
    return PixelErrors(
        confidence=np.concatenate([part.confidence for part in pixels]),
        absolute=np.concatenate([part.absolute for part in pixels]),
        relative=np.concatenate([part.relative for part in pixels]),
    )


def pooled_errors(pixels: PixelErrors) -> dict[str, float]:
    """The figures of :class:`DepthErrors` over all pixels of all views; the surer 70 % are those of the whole set."""
    sure = pixels.sure
    return {
        "median_rel": float(np.median(pixels.relative)),
        "within_1pct": float((pixels.relative < 0.01).mean()),
        "within_1pct_sure": float((pixels.relative[sure] < 0.01).mean()),
        "median_abs": float(np.median(pixels.absolute)),
        "median_abs_sure": float(np.median(pixels.absolute[sure])),
        "within_3cm_sure": float((pixels.absolute[sure] < 0.03).mean()),
    }


def depth_errors(
    depth: NDArray[np.float32],
    confidence: NDArray[np.float32],
    truth: NDArray[np.float32],
    *,
    min_depth: float = 0.0,
    max_depth: float = np.inf,
) -> DepthErrors | None:
    """Compare a depth map with the truth sampled on the same grid; pixels without truth (0) do not count.

    A missing estimate (0) counts as wrong. Returns ``None`` where no pixel has truth.
    """
    known = known_pixels(truth, min_depth, max_depth)
    if not known.any():
        return None
    pixels = pixel_errors(depth, confidence, truth, min_depth=min_depth, max_depth=max_depth)
    sure = pixels.sure
    silhouette, flies = (found[known] for found in flying_pixels(depth, truth))
    return DepthErrors(
        pixels=len(pixels.relative),
        **pooled_errors(pixels),
        flying=_share(flies, silhouette),
        flying_sure=_share(flies & sure, silhouette & sure),
    )


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    return float(part.sum() / whole.sum()) if whole.any() else float("nan")


def flying_pixels(
    depth: NDArray[np.float32],
    truth: NDArray[np.float32],
    *,
    radius_px: int = 3,
    min_step: float = 0.1,
    tolerance: float = 0.03,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Find pixels at silhouettes, and those of them whose depth lies between the surfaces but on none of them.

    A pixel is at a silhouette where the nearest and the farthest truth within ``radius_px`` differ by more than
    ``min_step`` of the nearest. It flies where its depth is between those two and differs from every true depth
    within ``radius_px`` by more than ``tolerance``. Both maps are (h, w) on the same grid; 0 is no truth.
    """
    window = np.ones((2 * radius_px + 1, 2 * radius_px + 1), np.uint8)
    near = np.minimum(cv2.erode(np.where(truth > 0, truth, np.float32(np.inf)), window), np.float32(1e9))
    far = cv2.dilate(truth, window)
    silhouette = (truth > 0) & (far > near * (1 + min_step))
    between = silhouette & (depth > near * (1 + tolerance)) & (depth < far * (1 - tolerance))
    rows, columns = np.nonzero(between)
    padded = np.pad(truth, radius_px)
    error = np.full(len(rows), np.inf, np.float32)
    for down in range(2 * radius_px + 1):
        for right in range(2 * radius_px + 1):
            surface = padded[rows + down, columns + right]
            known = surface > 0
            here = np.abs(depth[rows, columns][known] / surface[known] - 1)
            error[known] = np.minimum(error[known], here)
    flies = np.zeros_like(silhouette)
    flies[rows, columns] = error > tolerance
    return silhouette, flies


def mean_errors(rows: list[DepthErrors]) -> dict[str, float]:
    """Unweighted mean over views of every figure; views without a silhouette do not count for the flying pixels."""
    if not rows:
        return {}
    columns = {key: np.array([row.to_dict()[key] for row in rows]) for key in rows[0].to_dict()}
    return {
        key: float(np.nanmean(values)) if not np.isnan(values).all() else float("nan")
        for key, values in columns.items()
    }

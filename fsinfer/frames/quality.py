"""How sharp and how well exposed a photograph is, which of a set are unusable, and evening out brightness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ImageError
from fsinfer.io.images import luminance

# Longer side at which scores are taken, so that photos of 48 megapixels and video frames are judged alike.
SCORE_SIZE_PX = 1000
# Luminance at and beyond which a pixel says nothing, of 255 (the last levels are JPEG rounding).
DARK_LEVEL, BRIGHT_LEVEL = 5, 250
_THUMBNAIL = (64, 48)
EQUALIZERS = ("none", "clahe", "hist")


@dataclass(frozen=True, kw_only=True)
class FrameScore:
    """Scores of one photograph.

    Attributes
    ----------
    sharpness: variance of the Laplacian over the variance of the luminance, at 1000 pixels longer side. Dividing
        takes out contrast, so that fog and shade are not mistaken for blur.
    mean_luminance: 0 to 255.
    dark_share, bright_share: shares of pixels without detail, 0 to 1.
    thumbnail: (48, 64) float32 luminance, to find repetitions.
    """

    sharpness: float
    mean_luminance: float
    dark_share: float
    bright_share: float
    thumbnail: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class QualityLimits:
    """When a photograph is dropped.

    Attributes
    ----------
    min_relative_sharpness: share of the set's median sharpness.
    min_robust_z: and this many robust standard deviations (1.4826 MAD of the logarithm) below the median: photos of
        smooth bark beside photos of leaves differ by nature.
    max_blurred_share: at most this share of a set is dropped as blurred, the worst first. A person chose the photos,
        and a gap in the walk costs more than a soft photo.
    min_mean, max_mean: of the luminance, 0 to 255.
    max_dark_share, max_bright_share: a forest against the sky easily has 30 % of white.
    min_difference: mean difference of luminance thumbnails (0 to 255) from the last kept photo; less is a repetition.
        A change of the exposure alone, up to a stop each way, makes no difference.
    """

    min_relative_sharpness: float = 0.35
    min_robust_z: float = 3.0
    max_blurred_share: float = 0.2
    min_mean: float = 15.0
    max_mean: float = 240.0
    max_dark_share: float = 0.7
    max_bright_share: float = 0.7
    min_difference: float = 1.0


def score_frame(image: NDArray[np.uint8]) -> FrameScore:
    """Score an (H, W, 3) RGB uint8 photograph."""
    grey = luminance(image)
    scale = SCORE_SIZE_PX / max(grey.shape)
    if scale < 1:
        grey = np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    values = grey.astype(np.float32)
    # 5x5 Laplacian of Gaussian, roughly: single-pixel noise of a dark photo must not pass for sharpness.
    smooth = cv2.GaussianBlur(values, (0, 0), 0.8)
    response = cv2.Laplacian(smooth, cv2.CV_32F)
    return FrameScore(
        sharpness=float(response.var() / (values.var() + 1.0)),
        mean_luminance=float(values.mean()),
        dark_share=float((grey <= DARK_LEVEL).mean()),
        bright_share=float((grey >= BRIGHT_LEVEL).mean()),
        thumbnail=np.asarray(cv2.resize(values, _THUMBNAIL, interpolation=cv2.INTER_AREA), dtype=np.float32),
    )


def reasons_to_drop(scores: Sequence[FrameScore], limits: QualityLimits) -> list[str]:
    """For each photograph of a set, in order of capture, why it is dropped; empty text keeps it."""
    reasons = [_exposure_reason(score, limits) for score in scores]
    usable = [index for index, reason in enumerate(reasons) if not reason]
    if not usable:
        return reasons
    logs = np.log([max(scores[index].sharpness, 1e-9) for index in usable])
    median = float(np.median(logs))
    spread = 1.4826 * float(np.median(np.abs(logs - median)))
    limit = min(median + float(np.log(limits.min_relative_sharpness)), median - limits.min_robust_z * spread)
    blurred = [usable[rank] for rank in np.argsort(logs, kind="stable") if logs[rank] < limit]
    for index in blurred[: int(limits.max_blurred_share * len(usable))]:
        reasons[index] = "blurred"
    last: FrameScore | None = None
    for index, score in enumerate(scores):
        if reasons[index]:
            continue
        if last is not None and difference(score.thumbnail, last.thumbnail) < limits.min_difference:
            reasons[index] = "same as the one before"
        else:
            last = score
    return reasons


def difference(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Mean absolute difference of two luminance thumbnails after the exposure of the second is matched to the first."""
    gain = float(np.clip((first.mean() + 1) / (second.mean() + 1), 0.5, 2.0))
    return float(np.abs(first - gain * second).mean())


def _exposure_reason(score: FrameScore, limits: QualityLimits) -> str:
    if score.mean_luminance < limits.min_mean or score.dark_share > limits.max_dark_share:
        return "too dark"
    if score.mean_luminance > limits.max_mean or score.bright_share > limits.max_bright_share:
        return "too bright"
    return ""


def equalize(image: NDArray[np.uint8], method: str) -> NDArray[np.uint8]:
    """Even out the luminance of an (H, W, 3) RGB uint8 photograph; colours keep their tone.

    Parameters
    ----------
    method: ``none``; ``clahe`` (mild, in 8x8 tiles, clip limit 2); ``hist`` (over the whole image, as in the paper).

    Raises
    ------
    ImageError
        There is no such method.
    """
    if method == "none":
        return image
    if method not in EQUALIZERS:
        msg = f"there is no equalization {method!r}; choose one of {', '.join(EQUALIZERS)}"
        raise ImageError(msg)
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
    lightness = np.ascontiguousarray(lab[:, :, 0])
    if method == "clahe":
        lightness = np.asarray(cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(lightness), dtype=np.uint8)
    else:
        lightness = np.asarray(cv2.equalizeHist(lightness), dtype=np.uint8)
    lab[:, :, 0] = lightness
    return np.asarray(cv2.cvtColor(lab, cv2.COLOR_LAB2RGB), dtype=np.uint8)

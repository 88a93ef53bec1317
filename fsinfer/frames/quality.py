"""How sharp and how well exposed a photograph is, which of a set are unusable, and evening out brightness."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import ImageError
from fsinfer.frames.settings import Equalize, QualityLimits
from fsinfer.frames.small import small_copy
from fsinfer.io.images import luminance
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice

#: Longer side at which scores are taken, pixels, so that photos of 48 megapixels and video frames are judged alike.
#: Source: judgement.
SCORE_SIZE_PX = 1000
#: White, of a photo of 8 bits. Source: format.
_WHITE = 255
#: Luminance so near to black or white says nothing. Source: the last levels are JPEG rounding.
_BLANK_LEVELS = 5
#: Width of the Gaussian before the Laplacian, pixels: single-pixel noise of a dark photo must not pass for sharpness.
#: Source: about the 5x5 Laplacian of Gaussian.
_SMOOTH_PX = 0.8
#: Width and height of the thumbnails that repetitions are found by. Source: numerics.
_THUMBNAIL = (64, 48)
#: An exposure may change by this factor between two photos that are the same: a stop. Source: judgement.
_EXPOSURE_CHANGE = 2.0
#: Clip limit, and tiles a side. Source: the values of OpenCV's tutorial on CLAHE, a mild setting.
_CLAHE_CLIP, _CLAHE_TILES = 2.0, 8
#: Sharpness that stands for none where the logarithm is taken. Source: numerics.
_LEAST_SHARPNESS = 1e-9
#: Photographs of one camera that tell how sharp its others should be, at least. Source: judgement; the median of ten is
#: known to four tenths of their spread.
_FEWEST_OF_A_CAMERA = 10
#: Thumbnails of one picture, of which one was edited, correlate by so much. Source: judgement; the least of 36
#: photographs with more contrast and colour is 0.997, the most of neighbours of four walks, two of them real, 0.84.
_EDITED_CORRELATION = 0.95
#: Standard deviation over median absolute deviation of a normal distribution. Source: numerics.
_STD_OVER_MAD = 1.4826
EQUALIZERS = tuple(method.value for method in Equalize)


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


def score_frame(image: NDArray[np.uint8]) -> FrameScore:
    """Score an (H, W, 3) RGB uint8 photograph."""
    grey = small_copy(luminance(image), SCORE_SIZE_PX)
    values = grey.astype(np.float32)
    smooth = cv2.GaussianBlur(values, (0, 0), _SMOOTH_PX)
    response = cv2.Laplacian(smooth, cv2.CV_32F)
    return FrameScore(
        sharpness=float(response.var() / (values.var() + 1.0)),
        mean_luminance=float(values.mean()),
        dark_share=float((grey <= _BLANK_LEVELS).mean()),
        bright_share=float((grey >= _WHITE - _BLANK_LEVELS).mean()),
        thumbnail=np.asarray(cv2.resize(values, _THUMBNAIL, interpolation=cv2.INTER_AREA), dtype=np.float32),
    )


def reasons_to_drop(
    scores: Sequence[FrameScore], limits: QualityLimits, cameras: Sequence[Hashable] = ()
) -> list[Notice | None]:
    """For each photograph of a set, in order of capture, why it is dropped; None keeps it.

    Parameters
    ----------
    cameras: for each photograph what names its camera; empty where one camera took them all. Each camera's photographs
        are judged as blurred by their own sharpness, and those of a camera that took few by that of all.
    """
    reasons = [_exposure_reason(score, limits) for score in scores]
    usable = [index for index, reason in enumerate(reasons) if reason is None]
    if not usable:
        return reasons
    for index in _blurred(scores, usable, limits, cameras or [None] * len(scores)):
        reasons[index] = notice(CaptureCode.blurred)
    last: FrameScore | None = None
    for index, score in enumerate(scores):
        if reasons[index] is not None:
            continue
        if last is not None and difference(score.thumbnail, last.thumbnail) < limits.min_difference_levels:
            reasons[index] = notice(CaptureCode.repeated)
        else:
            last = score
    return reasons


def _blurred(
    scores: Sequence[FrameScore], usable: Sequence[int], limits: QualityLimits, cameras: Sequence[Hashable]
) -> set[int]:
    """Which of the ``usable`` photographs are blurred, each camera judged by itself where it took enough of them."""
    by_camera: dict[Hashable, list[int]] = {}
    for index in usable:
        by_camera.setdefault(cameras[index], []).append(index)
    found: set[int] = set()
    for own in by_camera.values():
        # One lens and one processing is softer than another, the same for all its photographs: that is no blur. Of a
        # few photographs the median says little, and they might all be blurred.
        set_of_it = own if len(own) >= _FEWEST_OF_A_CAMERA else usable
        found |= set(own) & set(_softest(scores, set_of_it, limits))
    return found


def _softest(scores: Sequence[FrameScore], members: Sequence[int], limits: QualityLimits) -> list[int]:
    """Those of ``members`` that are far less sharp than most of them, at most a share of them."""
    logs = np.log([max(scores[index].sharpness, _LEAST_SHARPNESS) for index in members])
    median = float(np.median(logs))
    spread = _STD_OVER_MAD * float(np.median(np.abs(logs - median)))
    limit = min(median + float(np.log(limits.min_relative_sharpness)), median - limits.min_robust_z * spread)
    blurred = [members[rank] for rank in np.argsort(logs, kind="stable") if logs[rank] < limit]
    return blurred[: int(limits.max_blurred_share * len(members))]


def difference(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Mean absolute difference of two luminance thumbnails after the exposure of the second is matched to the first."""
    gain = float(np.clip((first.mean() + 1) / (second.mean() + 1), 1 / _EXPOSURE_CHANGE, _EXPOSURE_CHANGE))
    return float(np.abs(first - gain * second).mean())


def is_edited_copy(first: NDArray[np.float32], second: NDArray[np.float32]) -> bool:
    """Whether two luminance thumbnails are of one picture, but for its brightness and contrast."""
    one, other = (values - float(values.mean()) for values in (first, second))
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return size > 0 and float((one * other).sum()) >= _EDITED_CORRELATION * size


def _exposure_reason(score: FrameScore, limits: QualityLimits) -> Notice | None:
    if score.mean_luminance < limits.blank_mean_levels or score.dark_share > limits.max_blank_share:
        return notice(CaptureCode.too_dark)
    if score.mean_luminance > _WHITE - limits.blank_mean_levels or score.bright_share > limits.max_blank_share:
        return notice(CaptureCode.too_bright)
    return None


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
    if method == Equalize.none:
        return image
    if method not in EQUALIZERS:
        msg = f"there is no equalization {method!r}; choose one of {', '.join(EQUALIZERS)}"
        raise ImageError(msg)
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB)
    lightness = np.ascontiguousarray(lab[:, :, 0])
    if method == Equalize.clahe:
        clahe = cv2.createCLAHE(clipLimit=_CLAHE_CLIP, tileGridSize=(_CLAHE_TILES, _CLAHE_TILES))
        lightness = np.asarray(clahe.apply(lightness), dtype=np.uint8)
    else:
        lightness = np.asarray(cv2.equalizeHist(lightness), dtype=np.uint8)
    lab[:, :, 0] = lightness
    return np.asarray(cv2.cvtColor(lab, cv2.COLOR_LAB2RGB), dtype=np.uint8)

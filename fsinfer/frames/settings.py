"""Settings of the choice of frames; light to import, for the command line shows their defaults."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from fsinfer.io.photo_size import PHOTO_SIZE_PX


class Equalize(StrEnum):
    """How the brightness of the frames is evened out."""

    none = "none"
    clahe = "clahe"
    hist = "hist"


@dataclass(frozen=True, kw_only=True)
class QualityLimits:
    """When a photograph is dropped.

    Attributes
    ----------
    min_relative_sharpness: share of the median sharpness of the photos of the same camera. Source: judgement.
    min_robust_z: and this many robust standard deviations (1.4826 MAD of the logarithm) below the median: photos of
        smooth bark beside photos of leaves differ by nature. Source: judgement; three standard deviations.
    max_blurred_share: at most this share of them is dropped as blurred, the worst first. A person chose the photos,
        and a gap in the walk costs more than a soft photo. Source: judgement.
    blank_mean_levels: the mean luminance of a photo may be so near to black or white, 0 and 255. Source: judgement.
    max_blank_share: share of pixels that are black, or that are white; a forest against the sky easily has 30 % of
        white. Source: judgement.
    min_difference_levels: mean difference of luminance thumbnails (0 to 255) from the last kept photo; less is a
        repetition. A change of the exposure alone, up to a stop each way, makes no difference. Source: judgement.
    """

    min_relative_sharpness: float = 0.35
    min_robust_z: float = 3.0
    max_blurred_share: float = 0.2
    blank_mean_levels: float = 15.0
    max_blank_share: float = 0.7
    min_difference_levels: float = 1.0


@dataclass(frozen=True, kw_only=True)
class VideoSettings:
    """When the next frame of a video is taken.

    Attributes
    ----------
    interval_s: after so many seconds at the latest. Source: option; FS-MVSNet, Forests 2025, 16, 927 (2 s).
    window_s: the sharpest frame within so many seconds is taken: of a walker's frames most are blurred by his steps.
        Source: a step of a walker takes about half a second.
    max_shift: sooner where the picture has moved by this share of its width (or height) since the last frame, as it
        does when a person turns or passes a near stem. The window opens at half of it. Source: photos must share two
        thirds of their view (usual in photogrammetry); seen on renders only.
    """

    interval_s: float = 2.0
    window_s: float = 0.5
    max_shift: float = 0.3


@dataclass(frozen=True, kw_only=True)
class FrameSettings(VideoSettings):
    """How frames are chosen: those of a video by :class:`VideoSettings`, and all of them by ``limits``.

    Attributes
    ----------
    equalize: one of :class:`Equalize`; ``hist`` is the paper's. None by default: SIFT and the depth network take out
        brightness and contrast themselves, upright photos that are not larger than ``longest_px`` are copied without
        coding them again, and the colours of the cloud stay those of the photos. Source: option; cameras of 40 photos
        of a rendered plot, 0.73 mm off as they are, 0.76 and 1.78 mm evened out; renders only.
    limits: when a frame is dropped.
    longest_px: larger photos and frames of a video are written reduced, pixels. Source: PHOTO_SIZE_PX.
    jpeg_quality: of frames that are written anew; upright JPEG photos that are not larger are copied as they are.
        Source: numerics; above 95 coding is not seen.
    """

    equalize: str = Equalize.none.value
    limits: QualityLimits = field(default_factory=QualityLimits)
    longest_px: int = PHOTO_SIZE_PX
    jpeg_quality: int = 97

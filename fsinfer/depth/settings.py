"""Settings of the depth stage; light to import, for the command line shows their defaults."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from fsinfer.errors import InputError


class Precision(StrEnum):
    """Numbers that depth is computed with."""

    auto = "auto"
    float32 = "float32"
    int8 = "int8"


@dataclass(frozen=True, kw_only=True)
class UnsureSettings:
    """Of the step in which unsure pixels follow their surroundings (:mod:`fsinfer.depth.median_filter`).

    Attributes
    ----------
    below: confidence of a pixel that follows; at 0.5 leaves lose more than walls gain.
    radius_px: half the side of the window, without its middle.
    power: of the confidence, the weight of a pixel.
    least_weight: added to it, so that a plain median is left where nobody is sure. Source: numerics.

    Notes
    -----
    Source of the rest: saharov32 and four kinds of rendered scenes, compared in docs/trials-accuracy.md; none of them
    is blind to it.
    """

    below: float = 0.35
    radius_px: int = 3
    power: float = 3.0
    least_weight: float = 1e-6


@dataclass(frozen=True, kw_only=True)
class SubpixelSettings:
    """Of the step to a tenth of a pixel (:mod:`fsinfer.depth.subpixel`); pixels are those of the image at full size.

    Attributes
    ----------
    rounds: Gauss-Newton steps; 0 leaves the network's depth.
    normalise_px: standard deviation of the window of the local mean and contrast.
    least_contrast: grey levels; contrast below it is noise.
    window_px: standard deviation of the window that moves as one.
    difference_px: to either side along the epipolar line, for the slope of the grey values.
    damping: squared slope that counts as much as none: places without texture stay where they are.
    outlier: normalised grey values by which two photographs may differ before they count less (Huber 1964).
    least_correlation: of a source with the reference, at which it has no weight.
    full_correlation: from which on it has all of it.
    most_px: a step moves a place no farther, in the source in which it moves most.
    median_px: side of the median filter behind each step, 3 or 5; 0 is none.

    Notes
    -----
    Source of the rest: saharov32, eight views, and seven views of a rendered plot (seed 900101), tables in
    docs/trials-accuracy.md; neither is blind to it.
    """

    rounds: int = 2
    normalise_px: float = 2.0
    least_contrast: float = 3.0
    window_px: float = 3.0
    difference_px: float = 0.5
    damping: float = 0.05
    outlier: float = 1.0
    least_correlation: float = 0.5
    full_correlation: float = 0.9
    most_px: float = 0.5
    median_px: int = 5


@dataclass(frozen=True, kw_only=True)
class DepthSettings:
    """Settings of the stage.

    Attributes
    ----------
    model: name of a shipped model or path of a manifest. Source: option; as accurate as ``field`` in two thirds of its
        time (models/README.md).
    source_views: sources for each reference view, best first; N of MVSNet is this plus one. Source: option; saharov32,
        on which seven sources gave 82.8 instead of 83.3 % within 1 %, and took half as long again.
    max_size_px: longer side of the image given to the network; larger photographs are reduced to it. Source: option;
        what a laptop computes in 1.5 s a view.
    min_far_over_near: the far bound is at least this many times the near one. Camera files often hold a range cut to
        the subject, and whatever stands behind it would be given a wrong depth; with planes uniform in 1/depth all that
        lies beyond seven times the near bound takes a seventh of them at most. Source: saharov32, whose median error
        fell from 0.27 to 0.11 %.
    max_far_over_near: the near bound is at least the far one divided by this. A leaf right before the lens would draw
        the planes to itself: from 0.2 m on they lie half a metre apart at 4 m. What is nearer is lost instead, so the
        bound must stay nearer than the trunks beside the path. Source: a rendered plot, on which 30 lost those within
        1.5 m of the camera and the RMSE of the DBH went from 0.45 to 1.71 cm; renders only.
    unsure: of the step in which unsure pixels follow their surroundings.
    unsure_after: of the same after the sub-pixel step, by what the photographs at full size say of each pixel. Source:
        docs/trials-accuracy.md, "Unsure pixels, twice".
    subpixel: of the step between them.
    threads: 0 uses every core. Source: option.
    memory_gb: limit of the resident memory, 1e9 bytes; fewer depth maps are computed at a time and fewer feature maps
        kept where it is tight, and depth is computed in tiles where a whole map does not fit. Source: option; leaves a
        laptop of 8 GB usable.
    provider: of onnxruntime, see :mod:`fsinfer.depth.session`. Source: option.
    precision: of the network, one of :class:`Precision`, see :mod:`fsinfer.depth.precision`. Source: option.
    trust_model: a model is used though its files are not those that its manifest names by their hash. Source: option.
    scheduler: address of a Dask scheduler, whose workers compute the maps; empty for this computer. Each stays within
        ``memory_gb``; ``threads`` = 0 is a worker's share of its computer's cores. Source: option.
    copy_photos: the photographs are sent to the workers, which see no disk of ours. Source: option.

    Raises
    ------
    InputError
        No source view, photographs of no size, or copying without a cluster.
    """

    model: str = "cascade"
    source_views: int = 4
    max_size_px: int = 1280
    min_far_over_near: float = 7.0
    max_far_over_near: float = 100.0
    unsure: UnsureSettings = field(default_factory=UnsureSettings)
    unsure_after: UnsureSettings = field(default_factory=lambda: UnsureSettings(below=0.2))
    subpixel: SubpixelSettings = field(default_factory=SubpixelSettings)
    threads: int = 0
    memory_gb: float = 3.0
    provider: str = "cpu"
    precision: str = Precision.auto.value
    trust_model: bool = False
    scheduler: str = ""
    copy_photos: bool = False

    def __post_init__(self) -> None:
        if self.source_views < 1 or self.max_size_px < 1:
            msg = (
                f"source_views is {self.source_views} and max_size_px {self.max_size_px}; depth takes at least one "
                "source view, and photographs of some hundred pixels"
            )
            raise InputError(msg)
        if self.copy_photos and not self.scheduler:
            msg = "--copy was given without --scheduler; on this computer the photos are where they are needed already"
            raise InputError(msg)

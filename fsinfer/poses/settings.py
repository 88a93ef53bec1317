"""Every setting of the poses stage."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

from fsinfer.poses.pairs import PairSettings
from fsinfer.poses.refinement import RefinementSettings
from fsinfer.poses.view_selection import SelectionSettings


@dataclass(frozen=True, kw_only=True)
class PoseSettings:
    """How poses are found.

    Attributes
    ----------
    max_image_size: longer side at which features are found, pixels. 23 photos of 2016x1512 at 1600: all registered.
    double_below_px: photos whose longer side is shorter are doubled before looking for features, as COLMAP does with
        all. Doubled photos of 1280x720 give four times the features, the smallest of them: matching takes 15 times as
        long, and the walk through a video of which most is blurred tore in two places, which it did not without.
    max_features: per photo, about; the smallest features go first. COLMAP's default is 8192.
    pairs: which photos are matched with which.
    default_focal_factor: focal length over longer side where the photo does not tell; 0.9 is a phone's main camera
        (26-28 mm equivalent is 0.72-0.78, video is cropped). It is refined from the photos.
    mapper: ``incremental`` (robust) or ``global`` (GLOMAP; as good and as fast on 23 photos).
    min_registered: fewer photos than this in the largest model are no result.
    min_inliers: matches that a pair needs after the geometric check (COLMAP's default is 15).
    refinement: of the last adjustment of the model.
    selection: of source views and depth ranges.
    sources: at most this many source views in ``pair.txt`` (MVSNet writes 10).
    jpeg_quality: of the undistorted images.
    threads: 0 for one per core.
    """

    max_image_size: int = 1600
    double_below_px: int = 1000
    max_features: int = 6000
    pairs: PairSettings = field(default_factory=PairSettings)
    default_focal_factor: float = 0.9
    mapper: str = "incremental"
    min_registered: int = 3
    min_inliers: int = 15
    refinement: RefinementSettings = field(default_factory=RefinementSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    sources: int = 10
    jpeg_quality: int = 95
    threads: int = 0

    @property
    def thread_count(self) -> int:
        """Threads really used."""
        return self.threads if self.threads > 0 else (os.cpu_count() or 1)

"""Every setting of the poses stage."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

from fsinfer.io.photo_size import PHOTO_SIZE_PX
from fsinfer.poses.adjustment.settings import AdjustmentSettings
from fsinfer.poses.pairs import PairSettings
from fsinfer.poses.refinement import FEATURE_SIZE_PX, RefinementSettings
from fsinfer.poses.view_selection import SelectionSettings
from fsinfer.scale.printed_boards import DICTIONARY
from fsinfer.threads import MOST_AT_ONCE

#: The enlargement of small photos that COLMAP does itself. Source: format.
DOUBLED = 2.0


@dataclass(frozen=True, kw_only=True)
class ThoroughSettings:
    """What is done where the walk tore.

    Attributes
    ----------
    min_share: of the photos that have a place; with fewer the others are looked at again. Source: judgement; a walk of
        200 photos may lose six at its ends.
    beside: so many photos before and after one without a place are looked at again with it. Source: as far as
        neighbours are matched.
    max_features: of the doubled photos, about. Source: COLMAP's default.
    overlap: each is matched with this many next ones. Source: with 12 COLMAP's defaults held walks that tore here.
    net_stride: every so many-th photo without a place is matched with every so many-th of all. Source: judgement.
    """

    min_share: float = 0.97
    beside: int = 8
    max_features: int = 8192
    overlap: int = 12
    net_stride: int = 6


@dataclass(frozen=True, kw_only=True)
class PoseSettings:
    """How poses are found.

    Attributes
    ----------
    longest_px: photos whose longer side is longer are reduced, pixels. Source: PHOTO_SIZE_PX.
    max_image_size: longer side at which features are found, pixels. Source: FEATURE_SIZE_PX.
    enlarge_below_px: photos whose longer side is shorter are enlarged before looking for features, as COLMAP does with
        all. Source: the rendered video of 1280x720; doubled, its photos give four times the features, the smallest of
        them, matching takes 15 times as long, and the walk tore in two places, which it did not without; renders only.
    enlargement: of these; with :data:`DOUBLED` COLMAP does it itself. Source: docs/trials-speed.md; 26 rendered photos
        of 960x540 in five cases: with 1.4 as many are placed as doubled, in two of the cases more, in two
        thirds of the time for features, cameras in some less exact; renders only.
    max_features: per photo, about; the smallest features go first. Source: judgement; COLMAP's default is
        8192, and matching grows with its square.
    max_enlarged_features: per photo that is enlarged, about. Source: judgement; those of the trials have 3,800 to 5,300
        on average, so that few lose any.
    pairs: which photos are matched with which.
    default_focal_factor: focal length over longer side where the photo does not tell; it is refined from the photos.
        Source: a phone's main camera of 26-28 mm equivalent has 0.72-0.78, and video is cropped.
    mapper: ``incremental`` (robust) or ``global`` (GLOMAP). Source: option; 200 photos of a rendered plot, of which it
        placed 188 within 5 cm and the global one 170; renders only.
    min_registered: fewer photos than this in the largest model are no result. Source: a third photo is the first that
        can contradict two.
    dictionary: of the markers whose corners tie the photos, as OpenCV names it. Source: what fsinfer marker prints.
    thorough: where the walk tore.
    refinement: of the last adjustment of the model.
    adjustment: of the one after it, with what changes from photo to photo.
    selection: of source views and depth ranges.
    sources: at most this many source views in ``pair.txt``. Source: MVSNet (Yao et al. 2018) writes 10.
    jpeg_quality: of the undistorted images. Source: numerics; the coding is not seen.
    threads: 0 for one per core. Source: option.
    """

    longest_px: int = PHOTO_SIZE_PX
    max_image_size: int = FEATURE_SIZE_PX
    enlarge_below_px: int = 1000
    enlargement: float = 1.45
    max_features: int = 6000
    max_enlarged_features: int = 4500
    pairs: PairSettings = field(default_factory=PairSettings)
    default_focal_factor: float = 0.9
    mapper: str = "incremental"
    min_registered: int = 3
    dictionary: str = DICTIONARY
    thorough: ThoroughSettings = field(default_factory=ThoroughSettings)
    refinement: RefinementSettings = field(default_factory=RefinementSettings)
    adjustment: AdjustmentSettings = field(default_factory=AdjustmentSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    sources: int = 10
    jpeg_quality: int = 95
    threads: int = 0

    @property
    def thread_count(self) -> int:
        """Threads really used."""
        return self.threads if self.threads > 0 else (os.cpu_count() or 1)

    @property
    def photo_threads(self) -> int:
        """Threads for what is done to photos one by one."""
        return min(self.thread_count, MOST_AT_ONCE)

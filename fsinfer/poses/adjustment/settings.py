"""Settings of the adjustment photo by photo."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class RematchSettings:
    """Points looked for once more by their patches: which, in which photos, and what counts as found.

    Attributes
    ----------
    cells: cells along the longer side of a photo in which points are counted. Source: judgement.
    per_cell: points of a cell from which on no others are looked for because of it. Source: docs/trials-accuracy.md;
        with five instead of eight the cameras of three walks were 2 to 16 % worse; renders only.
    min_shared: points that a photo must share with that of the patch, unless it has the feature. Source: judgement.
    most_photos: that one patch is looked for in. Source: docs/trials-accuracy.md; with six instead of twenty the
        cameras of three walks were up to a third worse; renders only.
    max_angle_deg: between the lines of sight of a patch's photo and another. Source: docs/trials-accuracy.md; with
        20 cameras were a tenth to a fifth worse, with 40 as good; renders only.
    max_ratio: of the sizes in which both show a thing. Source: judgement.
    min_correlation: of a patch and what it was laid over. Source: docs/trials-accuracy.md; 0.7 to 0.9 made
        a tenth of a difference at most; renders only.
    max_move_px: from where it was expected, in photos no larger than those that features are looked for in. Source:
        judgement; features that are farther off were dropped before.
    max_std_px: by its sharpness, likewise. Source: docs/trials-accuracy.md; half of it leaves a
        fifth to a quarter of the patches out, and the cameras of one walk were 4.9 instead of 3.4 mm off; renders only.
    min_patches: found in a photo on average, or features alone count. Source: judgement.
    max_loss_of_features: under the cameras placed by patches, of that under those before; beyond it the patches found
        something else than the features. Source: judgement; 0.95 and 0.98 on real photos, 1.03 on a render.
    feature_weight: of a feature that no patch was found for, beside those of patches. Source: their errors, 0.25 to 0.3
        and 0.07 to 0.1 pixels.
    loss_px: scale of the Cauchy loss. Source: docs/trials-accuracy.md; twice the errors of patches; renders only.
    """

    cells: int = 8
    per_cell: int = 8
    min_shared: int = 8
    most_photos: int = 20
    max_angle_deg: float = 35.0
    max_ratio: float = 1.7
    min_correlation: float = 0.85
    max_move_px: float = 3.0
    max_std_px: float = 0.12
    min_patches: int = 30
    max_loss_of_features: float = 1.1
    feature_weight: float = 0.25
    loss_px: float = 0.15


@dataclass(frozen=True, kw_only=True)
class AdjustmentSettings:
    """What may change from photo to photo, how much of it is expected, and when it is believed.

    Attributes
    ----------
    min_photos: models of fewer photos are left as they are. Source: judgement; held-out points need photos.
    focal_std: standard deviation of the focal length from photo to photo that is expected, relative. Source: focus
        breathing of phones, 0.05-0.2 %, twice the middle of it.
    principal_std: of the principal point, as a share of the photo's longer side. Source: stabilisers shift by up to a
        per cent; photographs of a hand held still move by 2 pixels of 1280.
    turn_std_rad: of the rotation while a photo is read out, radians. Source: a hand's tremor and a walker's turning of
        0.06-0.1 rad/s over 25 ms.
    mean_turn_std_rad: of the mean over all photos of the rotation about their rows. It is all but held at zero: of
        photos held upright it cannot be told from an upright stretch of the world (Albl, Sugimoto and Pajdla 2016).
        Source: a hand's tremor has no mean; where it was free, a rendered ring of 60 photos was stretched by 0.8 %;
        renders only.
    drift_std: of the way while a photo is read out, as a share of the step to the next photo. Source: 0.4-1 m/s over
        25 ms are 1-2.5 cm, photos are half a metre to a metre apart; a rendered ring of 60 photos, where 0.01 bent the
        world less than 0.03; renders only.
    mean_drift_std: of the mean over all photos of the way across the rows, as a share of the step; held at zero as the
        turning is, as it looks like it where all is equally far. Source: who walks goes neither up nor down.
    held_out: every so many-th point is kept out of the fit, and says whether it predicts better. Source: judgement.
    min_gain: the mean robust error of the points held out must fall by this share for a group of unknowns to be kept.
        Source: judgement; 36 photos of a render without such effects: 1.4 % at most, below zero for most groups;
        a rendered phone: 4 to 28 %; renders only.
    min_gain_beside: and by this share beside all groups that were kept after it, or it goes again. Source: judgement;
        the way during the read-out of a rendered phone: 1.1 %, and neighbouring cameras at 1.3 instead of 1.7 mm;
        renders only.
    min_surety: and by so many standard errors of that fall, points counted one by one. Source: three sigma.
    decide_with: observations a photo with which groups are tried, the longest tracks first; the last fit has all.
        Source: numerics; there are at most 15 unknowns a photo.
    loss_px: scale of the Cauchy loss, pixels, in photos no larger than those that features are looked for in. Source:
        COLMAP's.
    told_px: rolling shutter, or a change of the principal point, whose size is told as a warning, pixels of a photo as
        large as features are looked for in, or smaller. Source: judgement; the stems' edges are measured to a few
        tenths of a pixel.
    told_focal: change of the focal length that is told, relative. Source: judgement; a pixel at the edge of a photo.
    told_lenses: a change that focusing does not make: photos of two lenses, or of two zooms. Source: judgement; ten
        times what phones breathe; the demo's photos, half of them enlarged by a quarter, 4 %.
    rematch: of points looked for once more by their patches.
    """

    min_photos: int = 8
    focal_std: float = 0.0025
    principal_std: float = 0.002
    turn_std_rad: float = 0.0025
    mean_turn_std_rad: float = 1e-5
    drift_std: float = 0.01
    mean_drift_std: float = 1e-4
    held_out: int = 8
    min_gain: float = 0.02
    min_gain_beside: float = 0.005
    min_surety: float = 3.0
    decide_with: int = 250
    loss_px: float = 1.0
    told_px: float = 1.0
    told_focal: float = 0.002
    told_lenses: float = 0.02
    rematch: RematchSettings = field(default_factory=RematchSettings)

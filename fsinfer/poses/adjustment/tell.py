"""What is said of effects that change from photo to photo."""

from __future__ import annotations

from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import Notice, notice
from fsinfer.poses.adjustment.adjust import PhotoAdjustment
from fsinfer.poses.adjustment.settings import AdjustmentSettings


def told(adjustment: PhotoAdjustment, settings: AdjustmentSettings, larger: float = 1.0) -> list[Notice]:
    """Notices of effects that are large; ``larger`` as for :func:`fsinfer.poses.adjustment.adjust.adjust_photos`."""
    found = []
    shutter, focal, principal = (
        adjustment.rolling_shutter_px,
        adjustment.focal_std_percent,
        adjustment.principal_std_px,
    )
    if shutter is not None and shutter >= settings.told_px * larger:
        found.append(notice(CaptureCode.rolling_shutter, median_px=round(shutter, 1)))
    if focal is not None and focal >= 100 * settings.told_focal:
        mixed = focal >= 100 * settings.told_lenses
        code = CaptureCode.lenses_mixed if mixed else CaptureCode.focal_length_changes
        found.append(notice(code, percent=round(focal, 2)))
    if principal is not None and principal >= settings.told_px * larger:
        found.append(notice(CaptureCode.picture_shifts, shift_px=round(principal, 1)))
    return found

"""From which directions, and from how far, each stem was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.check.settings import CoverageSettings
from fsinfer.check.visible_stems import VisibleStem
from fsinfer.geometry.hull import in_hull

Floats = NDArray[np.float64]


#: A stem was hardly seen by fewer photos than this, however few there are; and it is far that no five are near. Source:
#: judgement.
_FEWEST_PHOTOS, _NEAR_PHOTOS = 4, 5
#: A walk that is no wider than this, and longer than that, metres, is a line: nobody walks straight, and what so narrow
#: a strip encloses is the walker. Source: judgement; photos within a metre of a path are on it.
_LINE_WIDTH_M, _LINE_LENGTH_M = 2.0, 5.0


@dataclass(frozen=True, kw_only=True)
class StemCoverage:
    """One stem and how it was seen.

    Attributes
    ----------
    number: counted in the order in which the walk passes the stems.
    stem: position and radius.
    views: (V,) int64, indices of the photos that see it.
    azimuths_deg: (V,) directions from the stem to these photos, counter-clockwise from the x axis of the plan.
    distances_m: (V,) plan distances.
    gap_deg: widest fan of directions without a photo; 360 where none sees it.
    gap_center_deg: its middle: where to stand next time.
    nearest: index of the photo that stands nearest to the stem, whether it sees it or not.
    one_sided: whether the gap is as wide as that of a stem seen from one side, however few photos say so.
    inside: whether the stem stands within the walk, or near it.
    verdict: ``good``, ``one side``, ``far``, ``hardly seen``, ``outside``, or ``beyond`` for one outside that a walk
        with an open side may have been meant to pass.
    """

    number: int
    stem: VisibleStem
    views: NDArray[np.int64]
    azimuths_deg: Floats
    distances_m: Floats
    gap_deg: float
    gap_center_deg: float
    nearest: int
    one_sided: bool
    inside: bool
    verdict: str


def judge_stems(
    stems: Sequence[VisibleStem],
    seen: NDArray[np.bool_],
    cameras: Floats,
    inside: NDArray[np.bool_],
    *,
    settings: CoverageSettings | None = None,
) -> list[StemCoverage]:
    """Judge every stem; the result is in the order of walking.

    Parameters
    ----------
    seen: (K, P) bool, which photo, in the order of walking, sees which stem.
    cameras: (P, 2) plan positions of the photos, metres.
    inside: (K,) bool, whether the stem stands within the walk.
    """
    settings = settings or CoverageSettings()
    found = []
    for stem, by, within in zip(stems, seen, inside, strict=True):
        offsets = cameras - stem.center
        azimuths = np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0]))
        distances = np.linalg.norm(offsets, axis=1)
        views = np.flatnonzero(by)
        gap_deg, middle_deg = widest_gap(azimuths[views])
        few = min(settings.few_photos, max(_FEWEST_PHOTOS, round(settings.few_share * len(cameras))))
        if not within:
            verdict = "outside"
        elif len(views) < few:
            verdict = "hardly seen"
        elif gap_deg >= settings.one_sided_deg:
            verdict = "one side"
        elif np.sort(distances[views])[min(_NEAR_PHOTOS, len(views)) - 1] > settings.far_m:
            verdict = "far"
        else:
            verdict = "good"
        found.append(
            StemCoverage(
                number=0,
                stem=stem,
                views=views,
                azimuths_deg=azimuths[views],
                distances_m=distances[views],
                gap_deg=gap_deg,
                gap_center_deg=middle_deg,
                nearest=int(distances.argmin()),
                one_sided=gap_deg >= settings.one_sided_deg,
                inside=bool(within),
                verdict=verdict,
            )
        )
    # People look for "the tree after this one" on their way; those outside come last.
    found.sort(key=lambda entry: (not entry.inside, entry.nearest, -len(entry.views)))
    return [replace(entry, number=rank + 1) for rank, entry in enumerate(found)]


def within_walk(cameras: Floats, places: Floats, *, settings: CoverageSettings | None = None) -> NDArray[np.bool_]:
    """Whether places (K, 2) are enclosed by the walk of the photos (P, 2), or so near to it that they are judged, (K,).

    A walk along a line has no inside: what is beside it, and not far, can be walked round as well.
    """
    settings = settings or CoverageSettings()
    if not len(cameras) or not len(places) or not _is_line(cameras):
        return in_hull(cameras, places, settings.margin_m)
    apart = np.linalg.norm(places[:, None] - cameras[None], axis=2).min(axis=1)
    return np.asarray(apart <= max(settings.far_m, settings.margin_m))


def _is_line(cameras: Floats) -> bool:
    """Whether the strip that holds all of the walk is narrow and long."""
    directions = np.radians(np.arange(0.0, 180.0))
    across = np.stack([-np.sin(directions), np.cos(directions)])
    widths = np.ptp(cameras @ across, axis=0)
    return bool(widths.min() <= _LINE_WIDTH_M and widths.max() >= _LINE_LENGTH_M)


def widest_gap(azimuths_deg: Floats) -> tuple[float, float]:
    """Width and middle (0 to 360) of the widest fan without a direction, degrees."""
    if len(azimuths_deg) == 0:
        return 360.0, 0.0
    ordered = np.sort(np.asarray(azimuths_deg) % 360)
    widths = np.diff(np.append(ordered, ordered[0] + 360))
    widest = int(widths.argmax())
    return float(widths[widest]), float((ordered[widest] + widths[widest] / 2) % 360)

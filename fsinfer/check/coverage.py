"""From which directions and how far each stem was seen, by the photos that truly share points on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.check.sparse_stems import SparseStem

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CoverageSettings:
    """When a direction counts as seen, and when a stem is named.

    Attributes
    ----------
    min_shared: points on the stem that a photo must share; two are rarely an accident.
    support_deg, min_support: photos within this angle must share so many points together (each counts at most
        ``max_support``), so that one stray match does not hide a whole unseen side.
    one_sided_deg: a stem is called seen from one side where no photo sees it in so wide a fan of directions. On two
        rendered plots, walked all round, the widest fans were 161 and 147 degrees (both stems of 10 cm, in a corner
        of the plot), the next 130; a half-plane has 180.
    far_m: a stem that no five photos are nearer to is called far.
    few_photos, few_share: with fewer photos than this number and this share of all, a stem was hardly seen, and its
        directions mean little.
    """

    min_shared: int = 2
    support_deg: float = 12.0
    min_support: int = 5
    max_support: int = 5
    one_sided_deg: float = 165.0
    far_m: float = 9.0
    few_photos: int = 10
    few_share: float = 0.08


@dataclass(frozen=True, kw_only=True)
class StemCoverage:
    """One stem and how it was seen.

    Attributes
    ----------
    number: counted in the order in which the walk passes the stems.
    stem: position, radius, points.
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
    stem: SparseStem
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
    stems: Sequence[SparseStem],
    observations: Sequence[NDArray[np.int64]],
    cameras: Floats,
    inside: NDArray[np.bool_],
    *,
    settings: CoverageSettings | None = None,
) -> list[StemCoverage]:
    """Judge every stem; the result is in the order of walking.

    Parameters
    ----------
    observations: for each photo, in the order of walking, the sorted indices of the points that it shares.
    cameras: (P, 2) plan positions of the photos, metres.
    inside: for each stem, whether it stands within the walk.
    """
    settings = settings or CoverageSettings()
    found = []
    for stem, within in zip(stems, inside, strict=True):
        shared = np.array([np.isin(stem.members, seen, assume_unique=True).sum() for seen in observations])
        offsets = cameras - stem.center
        azimuths = np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0]))
        distances = np.linalg.norm(offsets, axis=1)
        views = _supported(shared, azimuths, settings)
        gap_deg, middle_deg = widest_gap(azimuths[views])
        few = min(settings.few_photos, max(4, round(settings.few_share * len(cameras))))
        if not within:
            verdict = "outside"
        elif len(views) < few:
            verdict = "hardly seen"
        elif gap_deg >= settings.one_sided_deg:
            verdict = "one side"
        elif np.sort(distances[views])[min(4, len(views) - 1)] > settings.far_m:
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
    found.sort(key=lambda entry: (not entry.inside, entry.nearest, -len(entry.stem.members)))
    return [replace(entry, number=rank + 1) for rank, entry in enumerate(found)]


def widest_gap(azimuths_deg: Floats) -> tuple[float, float]:
    """Width and middle (0 to 360) of the widest fan without a direction, degrees."""
    if len(azimuths_deg) == 0:
        return 360.0, 0.0
    ordered = np.sort(np.asarray(azimuths_deg) % 360)
    widths = np.diff(np.append(ordered, ordered[0] + 360))
    widest = int(widths.argmax())
    return float(widths[widest]), float((ordered[widest] + widths[widest] / 2) % 360)


def _supported(shared: NDArray[np.int64], azimuths: Floats, settings: CoverageSettings) -> NDArray[np.int64]:
    """Photos that see the stem, without those that hang on a stray match."""
    seeing = np.flatnonzero(shared >= settings.min_shared)
    between = np.abs((azimuths[seeing, None] - azimuths[None, seeing] + 180) % 360 - 180)
    weight = np.minimum(shared[seeing], settings.max_support)
    support = ((between <= settings.support_deg) * weight[None]).sum(axis=1)
    return np.asarray(seeing[support >= settings.min_support])

"""Stems that all lean the same way: a stand may do that, or the cloud does not stand upright.

Trees lean for reasons of their own, each its own way, so that the mean of their leans, taken as vectors, is small. A
scan that was levelled badly, or a model whose way up was guessed, adds the same lean to all of them. Heights are then
too short and breast height is counted along the wrong direction, and no single stem shows it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.tree import Tree


@dataclass(frozen=True, kw_only=True)
class CommonLeanSettings:
    """Limits of :func:`common_lean`.

    Attributes
    ----------
    min_stems: measured beyond doubt; fewer may lean the same way by chance. Source: statistics, with the next.
    min_deg: of the mean lean. Source: four rendered plots of trees that each lean their own way have 0.5 to 0.7
        degrees (seeds 955007 to 955009 and the one of 1,000 photographs), standing real plots 0.5 to 1.6
        (docs/trials-accuracy.md); at 4 degrees breast height is off by 1 cm in the plane of a 15 cm radius.
    min_std: standard errors from none. Source: statistics, 99.7 %.
    """

    min_stems: int = 5
    min_deg: float = 4.0
    min_std: float = 3.0


def common_lean(
    trees: Sequence[Tree], sections: Sequence[Section], *, settings: CommonLeanSettings | None = None
) -> tuple[Notice, ...]:
    """What to say where all stems lean the same way; empty where they do not, or are too few to tell."""
    s = settings or CommonLeanSettings()
    sure = [section.slope for tree, section in zip(trees, sections, strict=True) if tree.status == "ok"]
    if len(sure) < s.min_stems:
        return ()
    slopes = np.array(sure)
    mean = slopes.mean(axis=0)
    error = float(np.linalg.norm(slopes.std(axis=0, ddof=1))) / np.sqrt(len(sure))
    lean_deg = float(np.degrees(np.arctan(np.linalg.norm(mean))))
    if lean_deg < s.min_deg or float(np.linalg.norm(mean)) < s.min_std * error:
        return ()
    return (notice(StemCode.lean_alike, stems=len(sure), lean_deg=lean_deg),)

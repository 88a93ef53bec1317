"""One radius from two sources: the points of the cloud and the edges in the photographs.

Where both agree, the mean by precision. Where they contradict each other (Cochran's test of homogeneity at about 5 %),
one of them is wrong by more than it says: the excess E = d^2 - s_p^2 - s_e^2 of their difference d is the variance of
an unknown error between them (DerSimonian & Laird, Controlled Clinical Trials 7, 1986, for two sources), and it goes
into the interval. The two do not share it evenly, as they would in a random-effects mean of alike sources: a depth map
fattens a hazy side by centimetres, an edge is where it is. Its share for each is that of the variances that both had
where the truth was known. The edges' radius stays, with their share of E on top.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class CombineSettings:
    """Constants of :func:`combine`.

    Attributes
    ----------
    gate: standard deviations between the two beyond which they contradict each other. Source: statistics, 95 %.
    points_factor: the points' radius is off by so many times what their scatter says: neighbouring depth maps err
        alike. It sets their weight in the mean; whether the two contradict each other is asked without it, so that
        a doubt is told rather too soon. Source: renders only, three plots photographed by a phone (seeds 953001 to
        953003): 2.6, 2.2 and 1.5 times (docs/trials-accuracy.md).
    edges_factor: the edges' radius is off by so many times what their fit says, which takes the bands and photographs
        of a side for more alike than they are; what sides unseen leave open is not in it, and it is used where
        ``points_factor`` is. Source: renders only, 226 stems of eight development plots (seeds 900101, 955013 to
        955017, 955019, 955020): 0.71 times (rms; 0.58 to 0.80 in each of five classes of what the fit says), and 99 %
        of the intervals held the truth (docs/trials-accuracy.md).
    fuller_factor: the same of a half-seen stem with single edges or sharp faces in its fit
        (:func:`fsinfer.silhouettes.one_look.fuller_look`). Source: renders only, 74 half-seen stems of six plots: 0.94
        times (docs/trials-accuracy.md, "Sharp faces").
    points_over_edges: variance of the points' unknown error over that of the edges'. Source: renders only, 41 stems of
        five plots photographed by a phone (docs/trials-accuracy.md): the edges' errors are 0.28 of half their 95 %
        intervals (rms; 0.22 at 16, and 0.51 were right), and 40 intervals hold the truth.
    points_over_edges_hazy: the same where the points lie in a haze. Source: renders only, 27 stems of nine plots
        photographed by a phone (docs/trials-accuracy.md, "Trees found without a DBH"): 0.25 of half their 95 %
        intervals (0.19 at 36), and all intervals hold the truth.
    points_over_edges_oval: the same of a section far from round, of which edges that miss a side know little. Source:
        judgement; one stem of a development plot (955016), 40 by 30 cm, seen in 14 photographs along its longer side.
    """

    gate: float = 2.0
    points_factor: float = 2.0
    edges_factor: float = 0.7
    fuller_factor: float = 1.0
    points_over_edges: float = 36.0
    points_over_edges_hazy: float = 100.0
    points_over_edges_oval: float = 1.0

    def factor(self, *, fuller: bool) -> float:
        """By how much the edges' radius is off, in what their fit says."""
        return self.fuller_factor if fuller else self.edges_factor


@dataclass(frozen=True, kw_only=True)
class Combined:
    """Radius, the points' ``weight`` in it, and the standard deviations that the two sources bring into it; metres.

    ``disagreement_m`` is what their contradiction adds, 0 where there is none.
    """

    radius_m: float
    weight: float
    edges_std_m: float
    points_std_m: float
    disagreement_m: float

    @property
    def contradict(self) -> bool:
        """Whether the two cannot both be right."""
        return self.disagreement_m > 0.0


def combine(
    points_m: float | None,
    points_std_m: float,
    edges_m: float,
    edges_std_m: float,
    *,
    points_doubt_m: float = 0.0,
    edges_doubt_m: float = 0.0,
    oval: bool = False,
    hazy: bool = False,
    counted: bool = False,
    fuller: bool = False,
    settings: CombineSettings | None = None,
) -> Combined:
    """Combine radii with their standard deviations, metres; ``points_m`` is None where the points gave none.

    ``points_doubt_m`` is what the section's shape adds to the points' standard deviation. It counts in their weight;
    whether the two contradict each other is asked without it, or a stem that is oval would never be doubted.
    ``edges_doubt_m`` is what sides that the edges miss add to theirs, in both questions. ``oval`` says
    that the points have the section far from round, and that the edges miss sides of it, ``hazy`` that the points
    scatter as bark does not; ``counted`` that the edges'
    radius has points of the cloud in it already, so that they get no weight once more; ``fuller`` that single edges or
    points are in it.
    """
    s = settings or CombineSettings()
    said_m = float(np.hypot(edges_std_m, edges_doubt_m))
    edges_std_m = float(np.hypot(s.factor(fuller=fuller) * edges_std_m, edges_doubt_m))
    if points_m is None:
        return Combined(radius_m=edges_m, weight=0.0, edges_std_m=edges_std_m, points_std_m=0.0, disagreement_m=0.0)
    apart, both = points_m - edges_m, float(np.hypot(points_std_m, said_m))
    points_std_m = float(np.hypot(s.points_factor * points_std_m, points_doubt_m))
    contradict = abs(apart) > s.gate * both
    excess = apart**2 - both**2 if contradict else 0.0
    over = s.points_over_edges_hazy if hazy else s.points_over_edges
    if oval:
        over = s.points_over_edges_oval
    weight = 0.0 if contradict or counted else edges_std_m**2 / (points_std_m**2 + edges_std_m**2)
    return Combined(
        radius_m=edges_m + weight * apart,
        weight=weight,
        edges_std_m=(1.0 - weight) * edges_std_m,
        points_std_m=weight * points_std_m,
        disagreement_m=float(np.sqrt(excess / (1.0 + over))),
    )

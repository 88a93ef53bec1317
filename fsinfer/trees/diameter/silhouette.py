"""The diameter of a stem from the edges at which photographs see it end against what lies behind.

A ray that grazes a convex section at outward normal angle t is at distance p(t) from the stem's axis: p is the
section's support function, and the girth of the section's hull is the integral of p over all t (Cauchy). What a
diameter tape reads is thus twice the mean of p. With the axis's place and slope, the taper and the harmonics 2 to 4 of
the section as unknowns, every edge is one linear equation:

    p = r + taper h + (a + u h) cos t + (b + v h) sin t + sum_k (c_k cos kt + s_k sin kt)

Cameras are placed with errors of their own: a photograph that stands a centimetre aside sees both edges of a stem a
centimetre aside. That is an unknown of each photograph, which moves its two sides the same way and leaves the stem's
width alone; most are millimetres, so that its prior is Cauchy's, which lets a few be large.

Depth maps blur a stem seen from 10 m by centimetres; its edges in the photographs are as sharp there as a pixel, 1 cm.
Which of the edges belong to the stem is found with its size (:mod:`fsinfer.trees.diameter.edge_problem`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.diameter.budget import LEAST_DOF, effective_dof, total_std
from fsinfer.trees.diameter.edge_problem import EdgeProblem, Solution
from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.faces import Faces, SupportFunction, sector_of_angle
from fsinfer.trees.diameter.roundness import left_open
from fsinfer.trees.diameter.sides import NOISE_SECTORS
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


#: An oval is believed where it is so much more likely than what began as a circle. The cloud's radius, where there is
#: one, counts up to so many standard deviations. Source: two more unknowns for some hundred pairs of photograph and
#: side cost about 5 (Schwarz 1978); on three development plots stems that are oval gained 10 to 149 by their edges, one
#: that is not 11, and the points parted these; renders only.
OVAL_GAIN, OVAL_POINTS_STD = 5.0, 3.0
#: Edges that stand out by no more than this, :attr:`SilhouetteFit.contrast`, may be others than the stem's. Source:
#: renders only, eleven runs of seven plots: of 558 diameters four `ok` ones were wrong by 3.5 cm and more, or those of
#: a second entry beside a stem, and had 1.23 to 1.37; the least of a right one is 1.38, the next 1.41.
FAINT_CONTRAST = 1.4
#: Fits whose radii are nearer than this, metres, stand on the same summit. Source: numerics, the vote's step.
SUMMIT_M = 0.001


@dataclass(frozen=True, kw_only=True)
class SilhouetteFit:
    """What the edges say of one stem, at the height about which ``Edges.height_m`` counts; metres.

    ``radius_m`` is the girth over 2 pi with its standard deviation ``std_m`` and the degrees of freedom ``dof`` of that
    (:mod:`fsinfer.trees.diameter.budget`); ``one_sided_m`` is the part of it that comes from sides unseen,
    ``left_open_m`` what the priors of the shape leave open in it, ``common_m`` the part that has one cause in all stems
    of a plot;
    ``shift_m`` (2,) and ``slope`` (2,) what the axis is moved and turned by; ``shape_m`` cosine and sine of the
    harmonics of the support function; ``rays`` how many rays carry the stem's edge and ``share`` their part of all;
    ``photos`` how many photographs they come from; ``sectors`` the part of the directions round the stem that they
    cover; ``noise_m`` the scatter of an edge.
    ``weight`` (N,) is each candidate's probability of being the stem's edge, ``gain`` (N,) how far the radius goes with
    its support (zero for a fit that was made by hand). ``faces`` is the number of sharp faces that the fit had beside
    the edges, ``faces_misfit`` the mean square of what they are off by, in standard deviations; ``sectors`` has them
    too. ``fuller`` says that it has more than photographs of both edges.
    """

    radius_m: float
    std_m: float
    shift_m: Floats
    slope: Floats
    taper: float
    shape_m: Floats
    rays: float
    share: float
    photos: int
    sectors: float
    noise_m: float
    contrast: float
    weight: Floats
    one_sided_m: float = 0.0
    left_open_m: float = 0.0
    common_m: float = 0.0
    dof: float = float("inf")
    gain: Floats = field(default_factory=lambda: np.zeros(0))
    faces: int = 0
    faces_misfit: float = 0.0
    fuller: bool = False

    @property
    def section(self) -> SupportFunction:
        """The section with its place, slope and taper."""
        return SupportFunction(
            radius_m=self.radius_m, taper=self.taper, shift_m=self.shift_m, slope=self.slope, shape_m=self.shape_m
        )

    def support(self, angle_rad: Floats, height_m: Floats | float = 0.0) -> Floats:
        """Return the support function at normal angles (N,) and heights about the axis of the cloud's fit."""
        return self.section.at(angle_rad, np.broadcast_to(np.asarray(height_m, np.float64), np.shape(angle_rad)))


def fit_silhouette(
    edges: Edges,
    radius_m: float,
    *,
    taper: float,
    settings: SilhouetteSettings | None = None,
    points: tuple[float, float] | None = None,
    faces: Faces | None = None,
) -> SilhouetteFit | None:
    """Fit the support function of a stem whose radius is roughly ``radius_m``; None where the edges do not agree.

    ``points`` are the cloud's radius and its standard deviation, metres, where it has one: the fit is begun there, too,
    and where the edges allow a round stem and an oval one it tells which. ``faces`` is its surface where no edge is
    seen.
    """
    s = settings or SilhouetteSettings()
    if len(np.unique(edges.ray)) < s.min_edges:
        return None
    problem = EdgeProblem(edges, radius_m, taper, s, faces)
    starts, contrast = problem.vote()
    if contrast < s.min_contrast:
        return None
    # An EM ends where it began near. From the vote's peaks alone a stem of 69 cm ended 4 cm beside, less likely than
    # where the axis that was asked for leads, or the points' radius.
    # At the first look both are mostly the same, and a fit from there is made once.
    asked = dict.fromkeys([radius_m] if points is None else [radius_m, points[0]])
    starts += [np.array([radius, 0.0, 0.0]) for radius in asked]
    circles = [problem.refine(start, np.zeros(2)) for start in starts]
    best_start = max(range(len(starts)), key=lambda k: circles[k].log_posterior)
    circle = circles[best_start]
    ovals = [problem.refine(*begun) for begun in problem.ovals(starts[best_start])]
    oval = max(ovals, key=lambda found: found.log_posterior)
    best = _surer(circle, oval, points)
    weight, used = best.weight, best.weight > 0.5
    if used.sum() < s.min_edges or weight.sum() < s.min_share * problem.rays:
        return None
    # Edges seen under about the same angle err together: bark is no smooth curve.
    sector, own = sector_of_angle(edges.angle_rad[used]), problem.own_design(best)
    scores = own * (best.precision * best.residual)[:, None]
    covariance = np.asarray(np.linalg.inv(best.information), np.float64)
    by_faces = np.zeros_like(covariance) if faces is None else problem.face_information
    variance, dof = _clustered_variance(covariance, scores[used], sector, problem.prior, by_faces)
    x = best.x
    sectors = len(np.unique(sector if faces is None else np.r_[sector, faces.sector])) / NOISE_SECTORS
    parts = {
        "edges": float(np.sqrt(variance)),
        "common": s.common_px * float(np.median(edges.pixel_m[used])),
        "shape": s.common_std * float(x[0]),
        "other fits": _spread_of_fits(best, [*circles, *ovals]),
        "one sided": s.one_sided_std * float(x[0]) * max(1.0 - sectors / s.sides_enough, 0.0),
    }
    return SilhouetteFit(
        radius_m=float(x[0]),
        std_m=total_std(parts),
        shift_m=x[2:4],
        slope=x[4:6],
        taper=float(x[1]),
        shape_m=x[problem.shape],
        rays=float(weight.sum()),
        share=float(weight.sum()) / problem.rays,
        photos=len(np.unique(edges.photo[used])),
        sectors=sectors,
        noise_m=best.noise_m,
        contrast=contrast,
        weight=weight,
        one_sided_m=parts["one sided"],
        left_open_m=left_open(covariance[0, problem.shape], problem.prior[problem.shape]),
        common_m=float(np.hypot(np.hypot(parts["common"], parts["shape"]), problem.shared_by_faces(covariance[0]))),
        dof=effective_dof(parts, {"edges": dof}),
        gain=np.asarray(np.linalg.solve(best.information, (own * best.precision[:, None]).T)[0]),
        faces=0 if faces is None else len(faces.angle_rad),
        faces_misfit=problem.misfit_of_faces(x),
    )


def edge_contrast(edges: Edges, radius_m: float, *, taper: float, settings: SilhouetteSettings | None = None) -> float:
    """How much better the edges agree on one radius than on any: 1.4 to 1.9 for stems, below 1.1 where there is none.

    NaN without edges.
    """
    if len(edges.ray) == 0:
        return float("nan")
    return EdgeProblem(edges, radius_m, taper, settings or SilhouetteSettings()).vote()[1]


def _surer(circle: Solution, oval: Solution, points: tuple[float, float] | None) -> Solution:
    """The oval where edges and points (radius and its standard deviation, metres) speak for it together."""

    def score(found: Solution) -> float:
        away = 0.0 if points is None else min(abs(float(found.x[0]) - points[0]) / points[1], OVAL_POINTS_STD)
        return found.log_posterior - 0.5 * away**2

    return oval if score(oval) > score(circle) + OVAL_GAIN else circle


def _spread_of_fits(best: Solution, found: Sequence[Solution]) -> float:
    """Standard deviation of the radius, metres, between fits that the edges make about as likely as the ``best``.

    An EM tells how sharp one summit is, not whether there is another. Of fits on the same summit the likeliest counts.
    """
    likeliest: dict[int, float] = {}
    for one in found:
        summit = round(float(one.x[0]) / SUMMIT_M)
        likeliest[summit] = max(likeliest.get(summit, -np.inf), one.log_posterior)
    radius = np.array([SUMMIT_M * summit for summit in likeliest])
    chance = np.exp(np.minimum(np.array(list(likeliest.values())) - best.log_posterior, 0.0))
    away = np.maximum(np.abs(radius - float(best.x[0])) - SUMMIT_M, 0.0)
    return float(np.sqrt((chance * away**2).sum() / max(float(chance.sum()), 1.0)))


def _clustered_variance(
    covariance: Floats, scores: Floats, sector: Ints, prior: Floats, by_faces: Floats
) -> tuple[float, float]:
    """Variance of the radius where edges of one sector err together (Liang & Zeger 1986), or the model's if larger.

    Also its degrees of freedom: the sectors beyond the three that radius and place use up, for that part of it which
    the sectors tell; what the priors leave open is known, and so is what the faces bring by ``by_faces`` (K, K), their
    part of the information.
    """
    names, cluster = np.unique(sector, return_inverse=True)
    sums = np.zeros((len(names), scores.shape[1]))
    np.add.at(sums, cluster, scores)
    few = len(names) / max(len(names) - 3.0, 1.0)  # radius and place are taken from the sectors
    told = float(covariance[0] @ (few * sums.T @ sums) @ covariance[0])
    variance = told + left_open(covariance[0], prior) ** 2 + float(covariance[0] @ by_faces @ covariance[0])
    if variance < covariance[0, 0]:
        return float(covariance[0, 0]), float("inf")
    return variance, max(len(names) - 3.0, LEAST_DOF) / max(told / variance, 1e-9) ** 2

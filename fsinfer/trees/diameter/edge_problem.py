"""The unknowns of a stem's silhouette, and how they are found from edges of which nobody knows whose they are.

The true stem is where the edges of many photographs agree: a vote over radius and place starts the fit,
expectation-maximisation (Dempster, Laird and Rubin 1977) with a background class refines it. Each edge is one linear
equation in the unknowns (:mod:`fsinfer.trees.diameter.silhouette`), and so is every sharp face of the cloud
(:mod:`fsinfer.trees.diameter.faces`); each photograph's offset is taken out of the system before it is solved (Schur's
complement).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.cylinder.axis import AxisSettings
from fsinfer.trees.diameter.edge_set import Edges, chosen_edges, sides_in_photos
from fsinfer.trees.diameter.faces import Faces, sector_of_angle
from fsinfer.trees.diameter.sides import NOISE_SECTORS
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: Steps of the vote over radius and place, metres. Source: numerics.
RADIUS_STEP_M, PLACE_STEP_M = 0.004, 0.01
#: Unknowns before those of the shape: radius, taper, place and slope. Source: mathematics.
AXIS = 6
#: Peaks of the vote that are followed up. Source: numerics.
STARTS = 3
#: Rounds of a fit; tolerance of the vote and of the first ones, metres, after which it is what was found, and how
#: much tighter harmonics are held in them: they would bend a wrong circle through a few edges. Source: numerics.
ROUNDS, TOLERANCES_M, ROUND_FIRST = 12, (0.012, 0.008, 0.006, 0.005, 0.004), 10.0
#: Ovals that a fit is begun with beside the circle: second harmonics, shares of the radius, and directions. Source:
#: renders only; on four development plots one stem of 106 is not reached from 0.06, another not from 0.10
#: (docs/trials-accuracy.md).
OVALS, OVAL_TURNS = (0.06, 0.10), 6
#: The edges' log likelihood counts as that of one band in so many, because the bands of a side err together. Source:
#: the strip's length over a band's.
BANDS_TOGETHER = 6.0
#: Standard deviation of the photographs' offsets in the first round, metres, before any is known. Source: numerics.
OFFSET_FIRST_M = 0.005
#: An edge is never surer, metres. Source: numerics.
LEAST_NOISE_M = 0.001
#: Logarithm of the least share of a vote. Source: numerics; numbers below the least normal one cost five times as much.
LEAST_LOG = np.float32(-50.0)
#: What is less likely to be the stem's edge, as a share of the likeliest, counts as none in the equations of a round.
#: Source: numerics; two thirds of the candidates.
LEAST_WEIGHT = 1e-9


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Unknowns ``x`` (K,); of each edge (N,), as given, its probability ``weight``, ``precision`` and ``residual``.

    ``by_offsets`` (P, K) is what the photographs' offsets take up of the design (:meth:`EdgeProblem.own_design`).
    """

    x: Floats
    by_offsets: Floats
    weight: Floats
    residual: Floats
    information: Floats
    noise_m: float
    log_likelihood: float
    log_prior: float
    precision: Floats

    @property
    def log_posterior(self) -> float:
        """The bands of a side err together, so that the edges count as those of one; priors count as they are."""
        return self.log_likelihood / BANDS_TOGETHER + self.log_prior


class EdgeProblem:
    """The edges of one stem with what both steps of the fit need of them.

    Its own arrays are sorted by photograph and ray, so that sums over either are taken of rows in one piece; what a
    solution tells of each edge is in the order that was given.
    """

    def __init__(
        self,
        edges: Edges,
        radius_m: float,
        taper: float,
        settings: SilhouetteSettings,
        faces: Faces | None = None,
    ) -> None:
        s = self.s = settings
        self.order = np.lexsort((edges.ray, edges.photo))
        edges = chosen_edges(edges, self.order)
        self.edges, self.radius_m, self.taper = edges, radius_m, taper
        begins = _begins(edges.ray)
        self.ray, self.first_of_ray = np.cumsum(begins) - 1, np.flatnonzero(begins)
        self.rays = len(self.first_of_ray)
        self.log_strength = np.log(np.maximum(edges.strength, 1.0))
        self.pixel = s.edge_std_px * edges.pixel_m
        names, self.photo = np.unique(edges.photo, return_inverse=True)
        self.photos = len(names)
        self.side = sides_in_photos(edges)
        shape_std = s.hull_of_rough_bark * np.array(AxisSettings().shape_std)
        self.shape = slice(AXIS, AXIS + 2 * len(shape_std))
        self.of_sectors = slice(self.shape.stop, self.shape.stop + NOISE_SECTORS)
        self.sector = sector_of_angle(edges.angle_rad)
        own_sector = np.eye(NOISE_SECTORS)[self.sector]
        self.support, self.sided_support = edges.support_m, self.side * edges.support_m
        self.design = np.hstack([design_matrix(edges.angle_rad, edges.height_m, len(shape_std)), own_sector])
        self.sided = self.side[:, None] * self.design
        shape = np.repeat(shape_std * radius_m, 2)
        sectors = np.full(NOISE_SECTORS, s.sector_m)
        self.prior = 1.0 / np.r_[np.inf, s.taper_std, [s.place_std_m] * 2, [s.slope_std] * 2, shape, sectors] ** 2
        self.prior_mean = np.zeros(len(self.prior))
        self.prior_mean[1] = taper
        self.faces = faces
        if faces is not None:
            self._add_faces(faces)

    def _add_faces(self, faces: Faces) -> None:
        """Add the equations of ``faces``, whose common errors are unknowns that edges do not have."""
        s = self.s.faces
        count, common = len(faces.angle_rad), len(s.alike_std_m)
        of_stem = design_matrix(faces.angle_rad, np.zeros(count), (self.shape.stop - AXIS) // 2)
        alike = [np.ones(count)]
        for k in range(1, common // 2 + 1):
            alike += [np.cos(k * faces.angle_rad), np.sin(k * faces.angle_rad)]
        self.face_design = np.hstack([of_stem, np.zeros((count, NOISE_SECTORS)), np.column_stack(alike)])
        self.design = np.hstack([self.design, np.zeros((len(self.design), common))])
        self.sided = self.side[:, None] * self.design
        self.prior = np.r_[self.prior, np.array(s.alike_std_m) ** -2.0]
        self.prior_mean = np.r_[self.prior_mean, -s.hull_share * self.radius_m, np.zeros(common - 1)]
        weighed = self.face_design / faces.std_m[:, None] ** 2
        self.face_information, self.face_sum = weighed.T @ self.face_design, weighed.T @ faces.support_m

    def shared_by_faces(self, covariance: Floats) -> float:
        """Standard deviation of the radius, metres, by what all faces of a plot err outwards together.

        ``covariance`` (K,) is that of the radius with all unknowns.
        """
        first = self.of_sectors.stop
        return 0.0 if self.faces is None else float(abs(covariance[first]) * np.sqrt(self.prior[first]))

    def misfit_of_faces(self, x: Floats) -> float:
        """Mean square, for each face, of what they are off by in standard deviations, alike and each by itself."""
        if self.faces is None:
            return 0.0
        common = slice(self.of_sectors.stop, None)
        alike = self.prior[common] * (x - self.prior_mean)[common] ** 2
        return float((alike.sum() + self._squares_of_faces(x)) / len(self.faces.angle_rad))

    def _squares_of_faces(self, x: Floats) -> float:
        if self.faces is None:
            return 0.0
        return float((((self.faces.support_m - self.face_design @ x) / self.faces.std_m) ** 2).sum())

    def vote(
        self, *, place_step_m: float = PLACE_STEP_M, radius_step_m: float = RADIUS_STEP_M
    ) -> tuple[list[Floats], float]:
        """Radius and place (3,) where the most rays have a strong edge: the best few radii, each at its best place.

        Also the votes of the first over those of a typical radius. Places are ``place_step_m`` apart, radii
        ``radius_step_m``.
        """
        s, edges = self.s, self.edges
        by_rank, ends = self._ranked()
        level = (edges.support_m - self.taper * edges.height_m)[by_rank].astype(np.float32)
        narrow = (-0.5 / (TOLERANCES_M[0] ** 2 + self.pixel[by_rank] ** 2)).astype(np.float32)
        cosine, sine = (part(edges.angle_rad[by_rank]).astype(np.float32) for part in (np.cos, np.sin))
        strength = self.log_strength[by_rank].astype(np.float32)
        shifts = np.arange(-s.place_range_m, s.place_range_m + 1e-9, place_step_m, dtype=np.float32)
        low, high = s.radius_range
        most = max(high * self.radius_m, self.radius_m + s.beyond_m)
        radii = np.arange(low * self.radius_m, most + 5 * radius_step_m, radius_step_m, dtype=np.float32)
        tops, places = np.zeros(len(radii)), np.zeros((len(radii), 2))
        beside = shifts[:, None] * sine
        for i, radius in enumerate(radii):
            away = level - radius
            for a in shifts:
                # (len(shifts), N): all places along the second axis at once
                score = np.square((away - a * cosine) - beside)
                score *= narrow
                np.maximum(score, LEAST_LOG, out=score)
                np.exp(score, out=score)
                score *= strength
                best = score[:, : ends[0]]
                for begin, end in pairwise(ends):
                    of_these = best[:, : end - begin]
                    np.maximum(of_these, score[:, begin:end], out=of_these)
                votes = best.sum(axis=1)
                if votes.max() > tops[i]:
                    tops[i], places[i] = votes.max(), (a, shifts[votes.argmax()])
        peaks = [i for i in range(len(radii)) if tops[i] >= max(tops[max(i - 1, 0) : i + 2])]
        peaks = sorted(peaks, key=lambda i: -tops[i])[:STARTS]
        contrast = float(tops.max()) / max(float(np.median(tops)), 1e-9)
        return [np.array([radii[i], *places[i]]) for i in peaks], contrast

    def _ranked(self) -> tuple[Ints, list[int]]:
        """The first edge of every ray, then the second of those with two, and so on; and where each lot ends.

        Rays with more edges come first, so that the k-th edges are those of the first rays: whole rows are compared
        instead of a few numbers at a time.
        """
        sizes = np.bincount(self.ray)
        place = np.empty_like(sizes)
        place[np.argsort(-sizes, kind="stable")] = np.arange(self.rays)
        rank = np.arange(len(self.ray)) - self.first_of_ray[self.ray]
        return np.lexsort((place[self.ray], rank)), np.cumsum(np.bincount(rank)).tolist()

    def ovals(self, start: Floats) -> Iterator[tuple[Floats, Floats]]:
        """A start with a second harmonic: an oval that lies in one of some directions.

        From a circle the edges of an oval stem's longer side are out of reach, and what is found has one side right.
        """
        for oval in OVALS:
            for turn in np.arange(OVAL_TURNS) * 2 * np.pi / OVAL_TURNS:
                yield start, oval * start[0] * np.array([np.cos(turn), np.sin(turn)])

    def refine(self, start: Floats, oval: Floats) -> Solution:
        """Expectation-maximisation from ``start`` (radius and place) and a second harmonic, then with all harmonics."""
        x = self.prior_mean.copy()
        x[[0, 2, 3]], x[AXIS : AXIS + 2] = start, oval
        start_shape = np.r_[self.prior_mean[:AXIS], x[AXIS:]]
        noise = LEAST_NOISE_M
        offset, offset_prior = np.zeros(self.photos), np.full(self.photos, OFFSET_FIRST_M**-2)
        for turn in range(ROUNDS):
            early = turn < len(TOLERANCES_M)
            std = np.hypot(self.pixel, TOLERANCES_M[turn] if early else noise)
            weight, log_likelihood = self._responsibility(self._log_fit(x, offset, std))
            precision = weight / std**2
            prior, expected = self.prior.copy(), self.prior_mean
            if early:
                prior[AXIS : self.of_sectors.stop] *= ROUND_FIRST**2
                expected = start_shape
            told = np.bincount(self.photo, precision, self.photos)
            held = told + offset_prior
            information, told_sum, by_offsets = self._without_offsets(weight, precision, held)
            information += np.diag(prior)
            told_sum += prior * expected
            if self.faces is not None:
                information += self.face_information
                told_sum += self.face_sum
            x = np.asarray(np.linalg.solve(information, told_sum), np.float64)
            residual = self.support - self.design @ x
            offset = np.bincount(self.photo, precision * self.side * residual, self.photos) / held
            residual -= self.side * offset[self.photo]
            of_sector = np.bincount(self.sector, precision, NOISE_SECTORS)
            free = float((told / held).sum() + (of_sector / (of_sector + self.prior[self.of_sectors])).sum())
            offset_prior = 2.0 / (self.s.offset_m**2 + offset**2)
            total = max(float(weight.sum()), 1.0)
            pixels = float((weight * self.pixel**2).sum()) * max(1.0 - free / total, 0.0)
            excess = (float((weight * residual**2).sum()) - pixels) / max(total - 4.0 - free, 1.0)
            noise = float(np.sqrt(max(excess, LEAST_NOISE_M**2)))
        # Starts are compared at one tolerance: a larger noise must not look like a better fit. Nor an unlikely shape.
        _, log_likelihood = self._responsibility(self._log_fit(x, offset, np.hypot(self.pixel, TOLERANCES_M[-1])))
        aside = float(np.log1p((offset / self.s.offset_m) ** 2).sum())
        return Solution(
            x=x,
            by_offsets=by_offsets,
            weight=self._as_given(weight),
            residual=self._as_given(residual),
            information=information,
            noise_m=noise,
            # The offsets' prior goes with the edges; beside the shape's it lost (docs/trials-accuracy.md).
            log_likelihood=log_likelihood - aside,
            log_prior=self._log_prior(x),
            precision=self._as_given(precision),
        )

    def own_design(self, found: Solution) -> Floats:
        """The design (N, K) of the edges, as given, without what the photographs' offsets take up of it."""
        return self._as_given(self.design - self.side[:, None] * found.by_offsets[self.photo])

    def _as_given(self, sorted_rows: Floats) -> Floats:
        """Rows (N, ...) of the edges in the order in which they were given."""
        rows = np.empty_like(sorted_rows)
        rows[self.order] = sorted_rows
        return rows

    def _without_offsets(self, weight: Floats, precision: Floats, held: Floats) -> tuple[Floats, Floats, Floats]:
        """Matrix (K, K) and right side (K,) of the edges' equations without the photographs' offsets, and their part.

        That is Schur's complement: with the design D and the diagonal matrix W of ``precision`` (N,) it is D'WD less
        T'T / ``held``, where T (P, K) are the sums of WD over the photographs, each side with its sign, and ``held``
        (P,) the precision of each photograph's offset, by its edges and its prior. The part (P, K) is T / ``held``.
        """
        # Far from every edge all are unlikely, and the likeliest show the way.
        counted = np.flatnonzero(weight >= LEAST_WEIGHT * weight.max())
        photo, sided, support = self.photo[counted], self.sided[counted], self.sided_support[counted]
        weighed = sided * precision[counted, None]  # a side's sign cancels where it comes twice
        begins = np.flatnonzero(_begins(photo))
        taken, of_support = np.zeros((self.photos, sided.shape[1])), np.zeros(self.photos)
        taken[photo[begins]] = np.add.reduceat(weighed, begins, axis=0)
        of_support[photo[begins]] = np.add.reduceat(precision[counted] * support, begins)
        part = taken / held[:, None]
        return sided.T @ weighed - part.T @ taken, weighed.T @ support - part.T @ of_support, part

    def _log_prior(self, x: Floats) -> float:
        """Of the shape and what the edges do not tell, with the faces, which are as sure as they say."""
        away = (x - self.prior_mean)[AXIS:]
        return -0.5 * (float((self.prior[AXIS:] * away**2).sum()) + self._squares_of_faces(x))

    def _log_fit(self, x: Floats, offset: Floats, std: Floats) -> Floats:
        residual = self.support - self.design @ x - self.side * offset[self.photo]
        return np.asarray(self.log_strength - 0.5 * (residual / std) ** 2)

    def _responsibility(self, log_fit: Floats) -> tuple[Floats, float]:
        """Probability (N,) that a candidate is the stem's edge, at most one on each ray or none; and the likelihood."""
        none = float(np.log(self.s.background))
        top = np.maximum(np.maximum.reduceat(log_fit, self.first_of_ray), none)
        part = np.exp(log_fit - top[self.ray])
        total = np.exp(none - top) + np.add.reduceat(part, self.first_of_ray)
        return np.asarray(part / total[self.ray]), float((top + np.log(total)).sum())


def _begins(numbers: Ints) -> NDArray[np.bool_]:
    """Whether each of the numbers (N,), of which equal ones follow each other, is the first of its kind."""
    return np.asarray(np.r_[True, np.diff(numbers) != 0], np.bool_)


def design_matrix(angle: Floats, height: Floats, order: int) -> Floats:
    """(N, 6 + 2 * order) coefficients of radius, taper, place, slope and harmonics 2, 3, ..."""
    cosine, sine = np.cos(angle), np.sin(angle)
    columns = [np.ones_like(angle), height, cosine, sine, height * cosine, height * sine]
    for k in range(2, 2 + order):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    return np.column_stack(columns)

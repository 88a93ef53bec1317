"""Levenberg-Marquardt on poses, lenses, each photo's own unknowns and points, with a robust loss and priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from fsinfer.poses.adjustment.problem import Group, Ints, Observations, Unknowns
from fsinfer.poses.adjustment.projection import OWN, Floats
from fsinfer.poses.adjustment.reduced_system import Blocks, Rows, Structure, blocks_of, reduce_points, solve

#: Damping at the start, and its factor after a step that failed or won. Source: numerics.
_DAMPING, _LESS, _MORE, _MOST_DAMPING = 1e-5, 0.1, 10.0, 1e3
#: Steps at most, and the share of the cost that another step must gain. Source: numerics.
_MOST_STEPS, _ENOUGH = 12, 1e-4
#: Steps of points alone, with photos and lenses known. Source: numerics; they begin where another model had them.
_POINT_STEPS = 6


@dataclass(frozen=True, kw_only=True)
class Weighting:
    """How observations and priors weigh against each other.

    Attributes
    ----------
    loss_px: scale of the Cauchy loss.
    noise_px: standard deviation of an observation on one axis; a prior's residual of one standard deviation counts as
        much as an observation's.
    own_std: (N, 9) standard deviations of each photo's own unknowns.
    mean_std: (N, 9) those of the mean of each unknown over all photos, in the same units; infinite where it is free.
    lens_free: for each lens (12, p) directions in which it may change.
    """

    loss_px: float
    noise_px: float
    own_std: Floats
    mean_std: Floats
    lens_free: Sequence[Floats]

    def losses(self, residuals: Floats) -> Floats:
        """(n,) Cauchy losses, pixels^2, of (n, 2) residuals; close to the square where they are small."""
        return np.asarray(self.loss_px**2 * np.log1p((residuals**2).sum(1) / self.loss_px**2))

    def cost(self, seen: Observations, unknowns: Unknowns) -> float:
        """What is made least: losses of the observations, and the priors."""
        priors = float(((unknowns.own / self.own_std) ** 2).sum() + (self.means(unknowns) ** 2).sum())
        return float(self.losses(unknowns.residuals(seen)).sum()) + self.noise_px**2 * priors

    def means(self, unknowns: Unknowns) -> Floats:
        """(9,) means over all photos, in units of their standard deviations."""
        return np.asarray((unknowns.own / self.mean_std).mean(axis=0))


def noise_of(residuals: Floats) -> float:
    """Standard deviation on one axis from the median length of (n, 2) residuals, which is 1.177 of it."""
    return float(np.sqrt(np.median((residuals**2).sum(1)) / (2 * np.log(2))))


def columns_of(groups: Sequence[Group]) -> list[int]:
    """Which of a photo's nine unknowns belong to the groups."""
    return sorted(i for group in groups for i in range(OWN)[group.value])


def fit(
    structure: Structure,
    start: Unknowns,
    groups: Sequence[Group],
    weighting: Weighting,
    *,
    steps: int = _MOST_STEPS,
    enough: float = _ENOUGH,
    foreseen: float = 0.0,
) -> Unknowns:
    """Adjust everything; of each photo's own unknowns those of ``groups``.

    It ends after so many ``steps``, with one that gains less than the share ``enough`` of the cost, or with one after
    which the next would gain less than ``foreseen``, were its gain to fall as the last one did.
    """
    seen, best = structure.seen, start
    cost = weighting.cost(seen, best)
    damping = _DAMPING
    gain = 0.0
    for _ in range(steps):
        damped = damping
        blocks = normal_equations(structure, best, groups, weighting)
        while damping <= _MOST_DAMPING:
            try:
                step = solve(structure, reduce_points(structure, blocks, damping))
            except np.linalg.LinAlgError:
                damping *= _MORE
                continue
            tried = _stepped(best, *step, groups, weighting)
            cost_there = weighting.cost(seen, tried)
            if cost_there < cost:
                break
            damping *= _MORE
        else:
            return best
        before, gain = gain, 1 - cost_there / cost
        best, cost = tried, cost_there
        # After a step that had to be shortened the next may gain more.
        if gain < enough or (damping == damped and gain**2 < foreseen * before):
            break
        damping *= _LESS
    return best


def normal_equations(structure: Structure, at: Unknowns, groups: Sequence[Group], weighting: Weighting) -> Blocks:
    """Of the weighted observations and the priors, at ``at``; a photo has 6 + the groups' unknowns, see :func:`fit`.

    The pose's are a small rotation and shift of the camera: x becomes x + rotation x x + shift. Each photo's own are
    in units of their standard deviations.
    """
    seen = structure.seen
    columns = columns_of(groups)
    size = 6 + len(columns)
    blocks = blocks_of(structure, _rows(seen, at, columns, weighting))
    photos = len(seen.camera)
    means = weighting.means(at)
    for place, column in enumerate(columns):
        same = np.arange(photos) * size + 6 + place
        # How the mean, in its standard deviations, grows with each photo's unknown in those of its own.
        slope = weighting.own_std[:, column] / weighting.mean_std[:, column] / photos
        blocks.cameras[np.ix_(same, same)] += weighting.noise_px**2 * np.outer(slope, slope)
        blocks.cameras_right[same] += weighting.noise_px**2 * slope * means[column]
    for photo in range(photos):
        own = np.arange(photo * size + 6, (photo + 1) * size)
        blocks.cameras[own, own] += weighting.noise_px**2
        blocks.cameras_right[own] += weighting.noise_px**2 * (at.own[photo] / weighting.own_std[photo])[columns]
    return blocks


def _rows(seen: Observations, at: Unknowns, columns: Sequence[int], weighting: Weighting) -> Rows:
    """The weighted rows of the Jacobian; ``columns`` of each photo's own unknowns."""
    count, size = len(seen.photo), 6 + len(columns)
    border = sum(directions.shape[1] for directions in weighting.lens_free)
    found = Rows(
        residuals=np.empty((count, 2)),
        by_photo=np.empty((count, 2, size)),
        by_point=np.empty((count, 2, 3)),
        by_lens=np.empty((count, 2, border)),
    )
    for rows, part in seen.parts():
        inside = at.in_cameras(part)
        residuals, by_x, by_own, by_lens = at.derivatives(part, inside)
        # Iteratively reweighted least squares; the Cauchy loss's derivative by the squared error is the weight.
        root = 1 / np.sqrt(1 + (residuals**2).sum(1) / weighting.loss_px**2)[:, None, None]
        by_x *= root
        by_photo = found.by_photo[rows]
        by_photo[:, :, :3] = np.cross(inside[:, None, :], by_x)
        by_photo[:, :, 3:6] = by_x
        if columns:
            by_photo[:, :, 6:] = by_own[:, :, columns] * (weighting.own_std[:, columns][part.photo][:, None, :] * root)
        by_lens *= root
        found.residuals[rows] = residuals * root[:, :, 0]
        found.by_point[rows] = by_x @ at.rotations[part.photo]
        found.by_lens[rows] = _bordered(by_lens, seen.camera[part.photo], weighting.lens_free)
    return found


def _bordered(by_lens: Floats, lens_number: Ints, free: Sequence[Floats]) -> Floats:
    """(n, 2, M): derivatives by the free directions of all lenses, of which a photo has one."""
    if len(free) == 1:
        return np.asarray(by_lens @ free[0])
    ends = np.cumsum([0, *(directions.shape[1] for directions in free)])
    border = np.zeros((len(by_lens), 2, ends[-1]))
    for number, directions in enumerate(free):
        rows = np.flatnonzero(lens_number == number)
        border[rows, :, ends[number] : ends[number + 1]] = by_lens[rows] @ directions
    return border


def _stepped(at: Unknowns, cameras: Floats, points: Floats, groups: Sequence[Group], weighting: Weighting) -> Unknowns:
    columns = columns_of(groups)
    photos = len(at.rotations)
    steps = cameras[: photos * (6 + len(columns))].reshape(photos, -1)
    turns = Rotation.from_rotvec(steps[:, :3]).as_matrix()
    own = at.own.copy()
    own[:, columns] += steps[:, 6:] * weighting.own_std[:, columns]
    directions = block_diag(*weighting.lens_free)
    lenses = at.lenses + (directions @ cameras[steps.size :]).reshape(at.lenses.shape)
    return Unknowns(
        rotations=turns @ at.rotations,
        translations=(turns @ at.translations[:, :, None])[:, :, 0] + steps[:, 3:6],
        own=own,
        lenses=lenses,
        points=at.points + points,
    )


def with_points_fitted(seen: Observations, at: Unknowns, loss_px: float) -> Unknowns:
    """Move the points alone to where the photos that see them, as they stand, see them best; each step must gain."""
    count = len(at.points)
    damping = np.full(count, _DAMPING)

    def costs(there: Unknowns) -> Floats:
        losses = loss_px**2 * np.log1p((there.residuals(seen) ** 2).sum(1) / loss_px**2)
        return np.asarray(np.bincount(seen.point, losses, count))

    cost = costs(at)
    for _ in range(_POINT_STEPS):
        terms = np.empty((len(seen.photo), 12))
        for which, part in seen.parts():
            residuals, by_x, _, _ = at.derivatives(part, at.in_cameras(part))
            weights = 1 / (1 + (residuals**2).sum(1) / loss_px**2)
            rows = by_x @ at.rotations[part.photo]
            turned = rows.transpose(0, 2, 1) * weights[:, None, None]
            terms[which, :9] = (turned @ rows).reshape(-1, 9)
            terms[which, 9:] = (turned @ residuals[:, :, None])[:, :, 0]
        summed = np.stack([np.bincount(seen.point, term, count) for term in terms.T], axis=1)
        matrix, right = summed[:, :9].reshape(-1, 3, 3), summed[:, 9:]
        size = np.trace(matrix, axis1=1, axis2=2)
        matrix += np.eye(3) * (damping * size + np.finfo(float).tiny)[:, None, None]
        tried = replace(at, points=at.points - np.linalg.solve(matrix, right[:, :, None])[:, :, 0])
        there = costs(tried)
        better = there < cost
        at = replace(at, points=np.where(better[:, None], tried.points, at.points))
        cost = np.where(better, there, cost)
        damping *= np.where(better, _LESS, _MORE**2)
    return at

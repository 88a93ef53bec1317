"""Which views help a view, and how deep its scene is, from the points of structure from motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from fsinfer.poses.sparse import LONG_TRACK, SparseModel
from fsinfer.scene import Camera

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SelectionSettings:
    """Constants of view selection and depth ranges.

    Attributes
    ----------
    best_angle_deg, narrow_deg, wide_deg: a shared point counts exp(-(angle - best)² / 2 sigma²), sigma = narrow below
        the best angle and wide above. Source: MVSNet (Yao et al. 2018, section 4.1).
    outer_percent: of the depths of the points seen in a view, these nearest and farthest do not count. Source:
        judgement; false points.
    near_margin, far_margin: the range is widened by these factors. Source: judgement; what has no features lies
        before and behind what has.
    max_ratio: the far end is at most this many times the near end. Source: planes are uniform in inverse depth, so
        that everything beyond takes up 1 / max_ratio of them.
    min_ratio: and at least this many times. Source: judgement.
    """

    best_angle_deg: float = 5.0
    narrow_deg: float = 1.0
    wide_deg: float = 10.0
    outer_percent: float = 1.0
    near_margin: float = 0.75
    far_margin: float = 1.5
    max_ratio: float = 60.0
    min_ratio: float = 1.5


#: Below this many well seen points a range is made of all points. Source: judgement.
_ENOUGH_POINTS = 50
#: Points of other views pull the near end in, down to this share of it. Source: judgement; the ground at the
#: photographer's feet.
_NEAREST_SHARE = 0.4
#: A shared point scores at least this. Source: numerics.
_LEAST_SCORE = 1e-6
#: Points of pairs that are looked at together: what they need stays in a core's cache. Source: numerics.
_AT_ONCE = 32_768


def score_pairs(
    points: NDArray[np.float64],
    centers: NDArray[np.float64],
    seen: Sequence[NDArray[np.int64]],
    settings: SelectionSettings | None = None,
) -> NDArray[np.float64]:
    """Score every pair of views by its shared points and the angles at which their rays meet.

    A forest has trees at two metres and at twenty in one photo; a pair is good for some of them only. The sum over
    points takes care of that: near stems, which carry most points, decide, as they should for diameters.

    Parameters
    ----------
    points: (N, 3) float64, scene units.
    centers: (V, 3) float64, camera centres.
    seen: for each view the sorted indices of the points it sees.

    Returns
    -------
    (V, V) float64, symmetric, zero on the diagonal. Pairs that share points score at least 1e-6 a point, so that
    views from one standpoint still rank before views that share nothing.
    """
    settings = settings or SelectionSettings()
    views = len(seen)
    scores = np.zeros((views, views))
    starts = np.concatenate([[0], np.cumsum([len(numbers) for numbers in seen], dtype=np.int64)])
    numbers = np.concatenate([*seen, np.zeros(0, np.int64)])
    # Points by views. Only pairs that share points are ever looked at: of a long walk's pairs most share none.
    sees = csc_matrix((np.ones(len(numbers), np.int8), numbers, starts), shape=(len(points), views)).tocsr()
    columns = np.ascontiguousarray(points.T)
    for i, own in enumerate(seen):
        shared = sees[own, i + 1 :].tocsc()
        own_columns = columns[:, own]
        ends = shared.indptr
        # So many other views at a time as share that many points with this one.
        cuts = np.unique(np.append(np.searchsorted(ends, np.arange(0, ends[-1], _AT_ONCE)), len(ends) - 1))
        for first, last in pairwise(cuts.tolist()):
            other = np.repeat(np.arange(i + 1 + first, i + 1 + last), np.diff(ends[first : last + 1]))
            places = own_columns[:, shared.indices[ends[first] : ends[last]]]
            angle_deg = _angles_deg(centers[i][:, None] - places, centers[other].T - places)
            sigma = np.where(angle_deg <= settings.best_angle_deg, settings.narrow_deg, settings.wide_deg)
            weight = np.maximum(np.exp(-((angle_deg - settings.best_angle_deg) ** 2) / (2 * sigma**2)), _LEAST_SCORE)
            for j in range(first, last):
                if ends[j + 1] > ends[j]:
                    score = float(weight[ends[j] - ends[first] : ends[j + 1] - ends[first]].sum())
                    scores[i, i + 1 + j] = scores[i + 1 + j, i] = score
    return scores


def _angles_deg(first: Floats, second: Floats) -> Floats:
    """Angles (N,) between vectors (3, N): several times faster than of rows (N, 3)."""
    (ax, ay, az), (bx, by, bz) = first, second
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return np.asarray(np.degrees(np.arctan2(np.sqrt(x * x + y * y + z * z), ax * bx + ay * by + az * bz)))


def choose_sources(scores: NDArray[np.float64], limit: int) -> dict[int, list[tuple[int, float]]]:
    """``{view: [(source, score), ...]}``, best first, at most ``limit`` and only with a score above 0."""
    chosen = {}
    for view, row in enumerate(scores):
        order = np.argsort(-row, kind="stable")[:limit]
        chosen[view] = [(int(source), float(row[source])) for source in order if row[source] > 0]
    return chosen


def depth_range(
    sparse: SparseModel,
    seen: NDArray[np.int64],
    intrinsic: NDArray[np.float64],
    cam_from_world: NDArray[np.float64],
    size: tuple[int, int],
    settings: SelectionSettings | None = None,
) -> tuple[float, float] | None:
    """The z depths between which a view's scene lies.

    Percentiles of the points that the view sees. The ground at the photographer's feet has few features, so that
    points of other views that fall into the picture and lie nearer pull the near end in, down to a share of it.

    Parameters
    ----------
    seen: indices of the points seen in the view.
    size: (width, height) of the image.

    Returns
    -------
    ``(near, far)`` in scene units, or None where the view sees no point in front of it.
    """
    settings = settings or SelectionSettings()
    steady = seen[sparse.track_lengths[seen] >= LONG_TRACK]
    used = steady if len(steady) >= _ENOUGH_POINTS else seen
    depths = _in_camera(sparse.points[used], cam_from_world)[:, 2]
    depths = depths[depths > 0]
    if not len(depths):
        return None
    near = float(np.percentile(depths, settings.outer_percent))
    far = float(np.percentile(depths, 100 - settings.outer_percent)) * settings.far_margin
    others = _in_camera(sparse.points[sparse.track_lengths >= LONG_TRACK], cam_from_world)
    others = others[others[:, 2] > 0]
    pixels = others @ intrinsic.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    inside = ((pixels >= 0) & (pixels <= np.array(size) - 1)).all(axis=1)
    if inside.sum() >= _ENOUGH_POINTS:
        nearest = float(np.percentile(others[inside, 2], settings.outer_percent / 2))
        near = min(near, max(nearest, _NEAREST_SHARE * near))
    near *= settings.near_margin
    return near, float(np.clip(far, settings.min_ratio * near, settings.max_ratio * near))


def _in_camera(points: NDArray[np.float64], cam_from_world: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(points @ cam_from_world[:3, :3].T + cam_from_world[:3, 3])


def select_views(
    sparse: SparseModel, cameras: Mapping[str, Camera], limit: int, settings: SelectionSettings | None = None
) -> dict[int, list[tuple[int, float]]]:
    """The sources of every view; views are numbered by the rank of their name."""
    names = sorted(cameras)
    seen = [np.unique(sparse.observations.get(name, np.zeros(0, np.int64))) for name in names]
    centers = np.array([cameras[name].center for name in names])
    return choose_sources(score_pairs(sparse.points, centers, seen, settings), limit)

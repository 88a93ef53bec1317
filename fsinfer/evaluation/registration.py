"""Two maps of the same trees laid on each other: partners by position, and the rigid motion where the frames differ.

Diameters have no say in it. They are what is to be judged: a motion chosen because it puts like diameters on each other
would make any result look better than it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Floats = NDArray[np.float64]
#: Distance that stands for none in the assignment, metres. Source: numerics.
_FAR = 1e6
#: Pairs of trees whose distances differ by less may be the same, metres; shorter pairs fix no angle. Source: judgement.
_PAIR_TOLERANCE_M, _SHORTEST_PAIR_M = 0.3, 1.0
#: Noise that breaks ties, and pairs that are tried at most. Source: numerics.
_TIE, _MOST_TRIALS = 1e-3, 4000
#: Rounds of refinement. Source: numerics.
_ROUNDS = 5
#: What a near place adds to a match. Source: judgement; a tie-breaker, a match counts 1.
_WORTH_OF_NEARNESS = 0.1


def assign(truth: Floats, found: Floats, limit: float) -> list[tuple[int, int]]:
    """Most pairs within ``limit``, then least sum of distances (Hungarian method)."""
    if len(truth) == 0 or len(found) == 0:
        return []
    distance = np.linalg.norm(truth[:, None] - found[None], axis=2)
    rows, columns = linear_sum_assignment(np.where(distance <= limit, distance, _FAR))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if distance[i, j] <= limit]


def apply(motion: Floats, xy: Floats) -> Floats:
    """Turn and shift positions (N, 2) by ``motion`` (3,): angle, x, y."""
    cosine, sine = np.cos(motion[0]), np.sin(motion[0])
    return np.asarray(xy @ np.array([[cosine, sine], [-sine, cosine]]) + motion[1:])


def register(truth: Floats, found: Floats, limit: float) -> Floats | None:
    """Rigid motion (angle, x, y) that puts ``found`` onto ``truth``: from pairs at equal distances, refined."""
    if len(truth) < 2 or len(found) < 2:
        return None
    tolerance = min(_PAIR_TOLERANCE_M, limit)
    a = np.array([(i, j) for i in range(len(truth)) for j in range(len(truth)) if i != j])
    b = np.array([(i, j) for i in range(len(found)) for j in range(i + 1, len(found))])
    length_a = np.linalg.norm(truth[a[:, 1]] - truth[a[:, 0]], axis=1)
    length_b = np.linalg.norm(found[b[:, 1]] - found[b[:, 0]], axis=1)
    order = np.argsort(length_a)
    low = np.searchsorted(length_a[order], length_b - tolerance)
    high = np.searchsorted(length_a[order], length_b + tolerance)
    rng = np.random.default_rng(0)
    # Long pairs fix the angle best and go first; short ones are skipped.
    pair = np.repeat(np.arange(len(b)), high - low)
    match = order[np.concatenate([np.arange(x, y) for x, y in zip(low, high, strict=True)] or [np.zeros(0, int)])]
    usable = length_b[pair] >= _SHORTEST_PAIR_M
    pair, match = pair[usable], match[usable]
    if len(pair) == 0:
        return None
    best, best_score = None, -1.0
    for k in np.argsort(_TIE * rng.random(len(pair)) - length_b[pair])[:_MOST_TRIALS]:
        (i0, i1), (j0, j1) = a[match[k]], b[pair[k]]
        v, w = truth[i1] - truth[i0], found[j1] - found[j0]
        angle = np.arctan2(v[1], v[0]) - np.arctan2(w[1], w[0])
        motion = np.array([angle, 0.0, 0.0])
        motion[1:] = (truth[i0] + truth[i1]) / 2 - apply(motion, (found[j0] + found[j1])[None] / 2)[0]
        score = _score(truth, apply(motion, found), limit)
        if score > best_score:
            best, best_score = motion, score
    for _ in range(_ROUNDS):
        links = assign(truth, apply(best, found), limit) if best is not None else []
        if len(links) < 2:
            break
        best = _rigid(truth[[i for i, _ in links]], found[[j for _, j in links]])
    return best


def _score(truth: Floats, moved: Floats, limit: float) -> float:
    """Trees that find a partner, each worth a little more the nearer it is."""
    nearest = np.linalg.norm(truth[:, None] - moved[None], axis=2).min(axis=1)
    return float(((nearest <= limit) * (1.0 + _WORTH_OF_NEARNESS * (1.0 - (nearest / limit) ** 2))).sum())


def _rigid(truth: Floats, found: Floats) -> Floats:
    """Least-squares rotation and shift without scale (Kabsch in the plane)."""
    a, b = truth - truth.mean(axis=0), found - found.mean(axis=0)
    angle = float(np.arctan2((b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]).sum(), (a * b).sum()))
    motion = np.array([angle, 0.0, 0.0])
    motion[1:] = truth.mean(axis=0) - apply(motion, found.mean(axis=0)[None])[0]
    return motion

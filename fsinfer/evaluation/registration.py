"""Two maps of the same trees laid on each other: partners by position, and the rigid motion where the frames differ.

Diameters have no say in it. They are what is to be judged: a motion chosen because it puts like diameters on each other
would make any result look better than it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

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
    candidates = _like_pairs(truth, found, min(_PAIR_TOLERANCE_M, limit))
    if len(candidates) == 0:
        return None
    best, best_score = None, -1.0
    for i0, i1, j0, j1 in candidates:
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


def _like_pairs(truth: Floats, found: Floats, tolerance: float) -> NDArray[np.int64]:
    """Pairs of trees (M, 4) of about the same length: their numbers in the truth, twice, and in what was found, twice.

    Long pairs fix the angle best and go first; short ones are left out, and of the rest all but the first
    ``_MOST_TRIALS``. All like pairs would be as many as the fourth power of the trees: only those that can come among
    the first are listed.
    """
    a = np.argwhere(~np.eye(len(truth), dtype=bool))
    b = np.column_stack(np.triu_indices(len(found), 1))
    length_a = np.linalg.norm(truth[a[:, 1]] - truth[a[:, 0]], axis=1)
    length_b = np.linalg.norm(found[b[:, 1]] - found[b[:, 0]], axis=1)
    usable = length_b >= _SHORTEST_PAIR_M
    b, length_b = b[usable], length_b[usable]
    order = np.argsort(length_a)
    longest = np.argsort(-length_b)
    low, count = (np.empty(len(length_b), np.int64) for _ in range(2))
    # Asked in their order: jumping about in the lengths of three thousand trees takes several times as long.
    lengths_a, ascending = length_a[order], longest[::-1]
    low[ascending] = np.searchsorted(lengths_a, length_b[ascending] - tolerance)
    count[ascending] = np.searchsorted(lengths_a, length_b[ascending] + tolerance) - low[ascending]
    enough = int(np.searchsorted(np.cumsum(count[longest]), _MOST_TRIALS))
    # Noise can put a pair before others that are longer by less than it.
    shortest = length_b[longest[enough]] - _TIE if enough < len(longest) else 0.0
    matches, keys, pairs = [np.zeros(0, np.int64)], [np.zeros(0)], [np.zeros(0, np.int64)]
    before = np.cumsum(count) - count
    for k in np.flatnonzero((length_b >= shortest) & (count > 0)):
        # The noise of all pairs is one stream, of which these have their own piece.
        noise = np.random.Generator(np.random.PCG64(0).advance(int(before[k]))).random(int(count[k]))
        matches.append(order[low[k] : low[k] + count[k]])
        keys.append(_TIE * noise - length_b[k])
        pairs.append(np.full(count[k], k))
    first = np.argsort(np.concatenate(keys))[:_MOST_TRIALS]
    return np.column_stack([a[np.concatenate(matches)[first]], b[np.concatenate(pairs)[first]]])


def _score(truth: Floats, moved: Floats, limit: float) -> float:
    """Trees that find a partner, each worth a little more the nearer it is."""
    nearest, _ = cKDTree(moved).query(truth)
    return float(((nearest <= limit) * (1.0 + _WORTH_OF_NEARNESS * (1.0 - (nearest / limit) ** 2))).sum())


def _rigid(truth: Floats, found: Floats) -> Floats:
    """Least-squares rotation and shift without scale (Kabsch in the plane)."""
    a, b = truth - truth.mean(axis=0), found - found.mean(axis=0)
    angle = float(np.arctan2((b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]).sum(), (a * b).sum()))
    motion = np.array([angle, 0.0, 0.0])
    motion[1:] = truth.mean(axis=0) - apply(motion, found.mean(axis=0)[None])[0]
    return motion

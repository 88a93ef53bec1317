"""Photos whose place the matches speak against: every pair of photos votes with its matches.

The mapper places a photo by the points it knows, and a few dozen false matches, all on one tree that looks like
another, are enough. The true matches with other photos are then left over, and contradict the place.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.order import in_order_of_walking
from fsinfer.poses.pairs import MIN_INLIERS
from fsinfer.poses.verification.spanning_tree import cut, strongest_ties, tie_graph

#: Share of a photo's matches that must speak for its place. Source: 200 photos of a rendered plot, whose trees share
#: their bark: 95 of 100 rightly placed photos have 0.8 and more, those placed metres away 0.1 to 0.7; renders only.
MIN_SHARE = 0.6
#: A pair agrees with two places when this share of its matches lies within so many pixels of the epipolar lines.
#: Source: judgement.
AGREEING_SHARE, MAX_ERROR_PX = 0.6, 3.0
#: Matches that lie this near to where the turn alone takes them are of trees far away: they fit wherever both photos
#: stood. Source: judgement, twice the pixels above; on a rendered walk nearly half of the matches over a bend were such
#: ones, and hid that one side of it stood 15 m away.
_LEAST_PARALLAX_PX = 6.0
#: Neighbours in a walk look at the same trees, while look-alikes stand apart, so that their matches count more. Source:
#: a rendered plot of 300: with 1 its 20 wrong photos had 0.51 of their matches for them and the same photos rightly
#: placed 0.49, with 6 0.29 and 0.66; renders only.
NEIGHBOUR_WEIGHT = 6.0
#: Those next to each other, so many photos on, cannot stand metres apart, whatever looks alike. Source: of 20 of the
#: first 100 of these photos 0.52 were for the right places without this; with 24 for all neighbours two of the demo's
#: 36 photos, rightly placed, were outvoted by look-alikes six photos away; renders only.
CLOSE_WEIGHT, _CLOSE = 24.0, 3


@dataclass(frozen=True, kw_only=True)
class PairVote:
    """What the matches between two photos say about their places; photos by number.

    Attributes
    ----------
    matches, agrees: of all matches. telling, telling_agrees: without those of what is far away, which fit wherever the
        two photos stood; see :func:`telling`.
    parallax_px: by how much the matches moved beside what the turn explains, median.
    """

    first: int
    second: int
    matches: int
    agrees: bool
    telling: int = 0
    telling_agrees: bool = False
    parallax_px: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Ballot:
    """Votes as arrays: (K, 2) numbers of the photos, (K,) what each vote counts, (K,) whether it is for the places."""

    ends: NDArray[np.intp]
    weight: NDArray[np.float64]
    agrees: NDArray[np.bool_]

    @classmethod
    def of(cls, votes: Sequence[PairVote], neighbours: int = 0) -> Ballot:
        """The votes; ``neighbours`` see :func:`weight_of`."""
        return cls(
            ends=np.array([(vote.first, vote.second) for vote in votes], dtype=np.intp).reshape(-1, 2),
            weight=np.array([weight_of(vote, neighbours) for vote in votes], dtype=np.float64),
            agrees=np.array([vote.agrees for vote in votes], dtype=bool),
        )

    def only(self, chosen: NDArray[np.bool_]) -> Ballot:
        """Those of the votes."""
        return Ballot(ends=self.ends[chosen], weight=self.weight[chosen], agrees=self.agrees[chosen])

    def shares(self, count: int) -> NDArray[np.float64]:
        """Share of each photo's matches that speak for its place, (count,); NaN for a photo without any."""
        cast, for_it = np.zeros(count), np.zeros(count)
        for end in self.ends.T:
            cast += np.bincount(end, weights=self.weight, minlength=count)
            for_it += np.bincount(end, weights=self.weight * self.agrees, minlength=count)
        return np.where(cast > 0, for_it / np.maximum(cast, 1.0), np.nan)


def contradicted(
    votes: Sequence[PairVote],
    count: int,
    *,
    min_share: float = MIN_SHARE,
    stretches: str = "after",
    lenient: bool = False,
    neighbours: int = 0,
    parts: bool = True,
) -> NDArray[np.bool_]:
    """Whether the matches of each of ``count`` photos speak against its place, (count,) bool.

    Photos that were placed wrongly together vouch for each other, and speak against their right neighbours. So parts
    are judged by their matches with the rest: those into which the maximum spanning tree of the agreeing matches falls
    when one of its edges is cut, and stretches of photos that follow each other in the walk (their numbers), which
    false ties may hold more firmly than true ones. The most contradicted part is wrong; where no part is, the most
    contradicted photo; then votes are counted again without them, until no more are found. A photo without any vote
    is left alone. ``stretches`` are looked at ``before`` the parts of the tree, ``after`` them, or ``never``. Without
    ``parts`` only single photos can be found wrong.

    Matches between photos that follow each other within ``neighbours`` count more, see ``NEIGHBOUR_WEIGHT`` and
    ``CLOSE_WEIGHT``; 0 where photos are in no order.

    A wrong part may take right photos with it: ``lenient`` lets those come back who agree with the photos that are
    left. Photos that false matches tie to them come back as well.
    """
    ballot = Ballot.of(votes, neighbours)
    of_parts = {"before": (outvoted_stretch, _outvoted_part), "after": (_outvoted_part, outvoted_stretch)}.get(
        stretches, (_outvoted_part,)
    )
    looks = of_parts if parts else ()
    wrong = np.zeros(count, dtype=bool)
    while True:
        left = ballot.only(np.asarray(~wrong[ballot.ends].any(axis=1)))
        for look in (*looks, _outvoted_photo):
            more = look(left, ~wrong, min_share)
            if more.any():
                break
        else:
            break
        wrong |= more
    while lenient:
        border = ballot.only(np.asarray(wrong[ballot.ends].sum(axis=1) == 1))
        back = wrong & (border.shares(count) >= min_share)
        if not back.any():
            break
        wrong &= ~back
    return wrong


def weight_of(vote: PairVote, neighbours: int) -> float:
    """How much the matches of a pair count; photos are numbered in the order of walking, if ``neighbours`` > 0."""
    apart = abs(vote.first - vote.second)
    if apart > neighbours:
        return float(vote.matches)
    return vote.matches * (CLOSE_WEIGHT if apart <= _CLOSE else NEIGHBOUR_WEIGHT)


def _outvoted_photo(ballot: Ballot, trusted: NDArray[np.bool_], min_share: float) -> NDArray[np.bool_]:
    """The photo whose own matches speak against it most; none where no photo is outvoted."""
    share = ballot.shares(len(trusted))
    lowest = np.where(np.isnan(share), 1.0, share)
    return np.asarray((share < min_share) & (np.arange(len(trusted)) == lowest.argmin()))


def _outvoted_part(ballot: Ballot, trusted: NDArray[np.bool_], min_share: float) -> NDArray[np.bool_]:
    """The photos of the part whose matches with the rest speak against it most; none where no part is outvoted."""
    ends, weight, agrees = ballot.ends, ballot.weight, ballot.agrees
    count = len(trusted)
    graph = tie_graph(ends[agrees, 0], ends[agrees, 1], weight[agrees], count)
    _, label = connected_components(graph, directed=False)
    apart = trusted & (label != np.bincount(label[trusted], minlength=count).argmax())
    apart &= np.bincount(ends.ravel(), minlength=count) > 0
    if apart.any():
        return np.asarray(apart)  # not one match ties it to the largest part
    tree = strongest_ties(graph)
    worst, part = min_share, np.zeros(count, dtype=bool)
    for edge in range(len(tree.data)):
        one, other = (trusted & side for side in cut(tree, edge))
        across = (one[ends[:, 0]] & other[ends[:, 1]]) | (other[ends[:, 0]] & one[ends[:, 1]])
        share = weight[across & agrees].sum() / weight[across].sum()
        if share < worst:
            worst, part = share, one if one.sum() <= other.sum() else other
    return part


def outvoted_stretch(ballot: Ballot, trusted: NDArray[np.bool_], min_share: float) -> NDArray[np.bool_]:
    """That stretch of the walk, of half of the photos or less, whose matches with the rest speak against it most.

    None, where no stretch has a lower share of matches for it than ``min_share``, nor than a half: a place is
    right or wrong, and where false matches are many the majority must do.
    """
    kept = np.flatnonzero(trusted)
    count = len(kept)
    rank = np.cumsum(trusted) - 1
    first, second = np.sort(rank[ballot.ends], axis=1).T

    def across(matches: NDArray[np.float64]) -> NDArray[np.float64]:
        """Matches that leave the stretch from photo i to before photo j, (count + 1, count + 1) [i, j]."""
        table = np.zeros((count + 1, count + 1))
        np.add.at(table, (first + 1, second + 1), matches)
        summed = table.cumsum(axis=0).cumsum(axis=1)
        # Pairs are stored once, first < second: those inside are all below j without those that begin below i.
        inside = np.diag(summed)[None, :] - summed
        degree = np.concatenate([[0.0], np.cumsum(table.sum(axis=0)[1:] + table.sum(axis=1)[1:])])
        return np.asarray(degree[None, :] - degree[:, None] - 2 * inside)

    total, agreeing = across(ballot.weight), across(ballot.weight * ballot.agrees)
    start, end = np.indices(total.shape)
    candidate = (end > start) & (end - start <= count // 2) & (total > 0)
    share = np.where(candidate, agreeing / np.where(candidate, total, 1.0), np.inf)
    part = np.zeros(len(trusted), dtype=bool)
    if share.min() < min(min_share, 0.5):
        start_at, end_at = np.unravel_index(share.argmin(), share.shape)
        part[kept[start_at:end_at]] = True
    return part


def false_pairs(votes: Sequence[PairVote], wrong: NDArray[np.bool_]) -> list[PairVote]:
    """Pairs whose matches must be false: they put a wrong photo where it was, or contradict two right ones."""
    return [vote for vote in votes if _is_false(vote, wrong)]


def _is_false(vote: PairVote, wrong: NDArray[np.bool_]) -> bool:
    if wrong[vote.first] and wrong[vote.second]:
        return False  # of two wrong photos nothing is known
    return vote.agrees == bool(wrong[vote.first] or wrong[vote.second])


def pair_votes(model: Any, database: Path, *, within: int | None = None) -> tuple[list[int], list[PairVote]]:
    """The placed photos' image ids in the order of walking, and the votes of all pairs; photos are numbered in it.

    ``model`` is the ``pycolmap.Reconstruction`` that was made from ``database``; of pairs farther apart than
    ``within`` nothing is asked.
    """
    image_ids = in_order_of_walking(model)
    return image_ids, list(_votes(model, database, image_ids, len(image_ids) if within is None else within))


def _votes(model: Any, database: Path, image_ids: list[int], within: int) -> Iterator[PairVote]:
    import pycolmap

    number = {image_id: index for index, image_id in enumerate(image_ids)}
    focal_px = {key: camera.mean_focal_length() for key, camera in model.cameras.items()}
    poses = {i: np.vstack([model.images[i].cam_from_world().matrix(), [0.0, 0.0, 0.0, 1.0]]) for i in image_ids}
    with open_database(database) as opened:
        rays = {}
        for image_id in image_ids:
            camera = model.cameras[model.images[image_id].camera_id]
            keypoints = opened.read_keypoints(image_id)[:, :2].astype(np.float64)
            plane = np.asarray(camera.cam_from_img(keypoints), dtype=np.float64).reshape(-1, 2)
            rays[image_id] = np.column_stack([plane, np.ones(len(plane))])
        for pair_id in opened.read_two_view_geometry_num_inliers()[0]:
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            if first not in number or second not in number or abs(number[first] - number[second]) > within:
                continue
            matches = opened.read_two_view_geometry(first, second).inlier_matches
            if len(matches) < MIN_INLIERS:
                continue
            one, other = rays[first][matches[:, 0]], rays[second][matches[:, 1]]
            focal = 0.5 * sum(focal_px[model.images[i].camera_id] for i in (first, second))
            motion = poses[second] @ np.linalg.inv(poses[first])
            moved = parallax(one, other, motion[:3, :3])
            fits, tells = telling(one, other, motion, MAX_ERROR_PX / focal, moved > _LEAST_PARALLAX_PX / focal)
            yield PairVote(
                first=number[first],
                second=number[second],
                matches=len(matches),
                agrees=bool(fits.mean() > AGREEING_SHARE),
                telling=int(tells.sum()),
                telling_agrees=bool((fits & tells).sum() > AGREEING_SHARE * tells.sum()),
                parallax_px=float(focal * np.median(moved)),
            )


def telling_votes(votes: Sequence[PairVote]) -> list[PairVote]:
    """The votes of the matches that tell how two photos stand to each other, of pairs that have enough of these."""
    return [
        PairVote(first=vote.first, second=vote.second, matches=vote.telling, agrees=vote.telling_agrees)
        for vote in votes
        if vote.telling >= MIN_INLIERS
    ]


def telling(
    one: NDArray[np.float64],
    other: NDArray[np.float64],
    other_from_one: NDArray[np.float64],
    max_error: float,
    moved: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which matches (N,) fit a motion between two cameras, and which tell how these stand to each other.

    What the turn alone explains tells nothing: it is too far away, and fits whatever lies between the cameras.

    Parameters
    ----------
    one, other: (N, 3) rays of the two cameras, third coordinate 1.
    other_from_one: (4, 4) motion between the camera frames.
    max_error: in focal lengths. moved: (N,) whether they moved beside what the turn explains: :func:`parallax`.
    """
    fits = sampson_error(one, other, other_from_one) < max_error
    return fits, ~fits | moved


def parallax(one: NDArray[np.float64], other: NDArray[np.float64], turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far matches (N, 3) moved beside what the ``turn`` (3, 3) of the camera explains, (N,), in focal lengths."""
    turned = one @ turn.T
    ahead = np.maximum(turned[:, 2:], 1e-12)
    return np.asarray(np.hypot(*(turned[:, :2] / ahead - other[:, :2]).T))


def sampson_error(
    one: NDArray[np.float64], other: NDArray[np.float64], other_from_one: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distance of matches from the epipolar geometry, (N,), in focal lengths (Hartley and Zisserman, eq. 11.9).

    Parameters
    ----------
    one, other: (N, 3) rays of the two cameras, third coordinate 1.
    other_from_one: (4, 4) motion between the camera frames.
    """
    x, y, z = other_from_one[:3, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ other_from_one[:3, :3]
    line, line_back = one @ essential.T, other @ essential
    gradient = np.sqrt((line[:, :2] ** 2).sum(axis=1) + (line_back[:, :2] ** 2).sum(axis=1))
    return np.asarray(np.abs((line * other).sum(axis=1)) / np.maximum(gradient, 1e-12))

"""A walk followed from photo to photo, and what it says of the pairs of photos that stand farther apart.

Photos next to each other in a walk have hundreds of matches, and what looks alike a step away cannot outnumber them.
Three or more steps away it does: litter and bark repeat, a third of the pairs of neighbours of a rendered walk of 300
were false, and half of those that close loops. A map of the pairs next to each other alone drifts, by 0.26 m in that
walk, and look-alikes are off by a step and more, so that it tells which of the others are true.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fsinfer.poses.colmap import reconstruct, with_calibration
from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.thinning import MOST_MATCHES, add_points, thinned
from fsinfer.poses.verification.misplaced import without_pairs
from fsinfer.poses.verification.point_votes import PointVote, agreeing_share, point_votes
from fsinfer.poses.view_graph import configurations
from fsinfer.progress import Progress

_log = logging.getLogger(__name__)

#: Photos so many apart in the walk are next to each other. Source: a rendered walk of 300 photos, looked at afterwards:
#: of 597 such pairs one is false, of 588 three and four apart 148.
_CLOSE = 2
#: Points that must agree on the place of a photo, where only such pairs count. Source: judgement, as many as matches
#: of a pair; COLMAP's 30 tore that walk where three photos in a row share 22 points, all of them true.
_LEAST_POINTS = 15
#: A pair is true where its points are seen within this many focal lengths: of neighbours, and of photos that the drift
#: of a walk lies between, which grows with the way. Source: that walk and an undergrown one of 200, their pairs judged
#: by the finished maps: so 1,895 of 1,911 true neighbours are kept and 20 of 828 others, 1,143 of 1,170 true pairs that
#: close loops and none of 1,625 others; renders only.
NEAR, FAR, _MOST_FAR = 0.016, 0.064, 0.1
#: Photos on, from which drift is allowed for. Source: judgement; the walk above drifted by 0.26 m in 180 photos.
_DRIFTS = 100
#: Fewer points tell nothing. Source: judgement.
FEWEST_POINTS = 8
#: A stretch is believed where this share of the matches of its other neighbours agrees with it. Source: judgement; 0.74
#: to 1.00 of nine stretches of rendered and real photos that were followed rightly.
_BELIEVED = 0.6


@dataclass(frozen=True, kw_only=True)
class Judged:
    """What a walk that was followed tells.

    Attributes
    ----------
    true, false: pairs, by COLMAP's numbers of their photos, the smaller first.
    followed: the ``pycolmap.Reconstruction`` of the walk, where it is believed and holds all photos, else None.
    """

    true: frozenset[tuple[int, int]] = frozenset()
    false: frozenset[tuple[int, int]] = frozenset()
    followed: Any = field(default=None, compare=False)


def judge_pairs(
    database: Path,
    rank: Mapping[int, int],
    files: Sequence[str],
    work: Path,
    settings: PoseSettings,
    progress: Progress,
    *,
    beginnings: Sequence[tuple[int, int]],
) -> Judged:
    """Which pairs of a walk are true and which false; what it cannot tell is in neither.

    Parameters
    ----------
    database: of all matches, with calibrated cameras. rank: of each photo, by COLMAP's number, in the order of walking.
    files: in that order. work: folder with the photos in ``images``, and for copies of the database.
    beginnings: pairs to begin with, the best first.
    """
    true: set[tuple[int, int]] = set()
    false: set[tuple[int, int]] = set()
    followed = None
    for part in follow_walk(database, rank, files, work, settings, progress, beginnings=beginnings):
        votes = [vote for vote in point_votes(part, database) if _apart(vote, rank) > _CLOSE]
        share = believed_share(votes, rank, settings.pairs.overlap)
        _log.info("followed %d photos; %.2f of their neighbours' matches agree", part.num_reg_images(), share)
        if share < _BELIEVED:
            continue
        if part.num_reg_images() == len(files):
            followed = part
        for vote in votes:
            if vote.points >= FEWEST_POINTS:
                limit = limit_of(_apart(vote, rank), settings.pairs.overlap)
                (true if vote.error < limit else false).add((vote.first, vote.second))
    # Stretches may share photos, and see a pair in two ways.
    return Judged(true=frozenset(true - false), false=frozenset(false - true), followed=followed)


def follow_walk(
    database: Path,
    rank: Mapping[int, int],
    files: Sequence[str],
    work: Path,
    settings: PoseSettings,
    progress: Progress,
    *,
    beginnings: Sequence[tuple[int, int]],
) -> list[Any]:
    """A ``pycolmap.Reconstruction`` of each stretch that pairs next to each other hold together, the largest first.

    Its photos are placed by some of the matches, and its points are those of all.
    """
    with open_database(database) as opened:
        others = [pair for pair in configurations(opened) if abs(rank[pair[0]] - rank[pair[1]]) > _CLOSE]
    every = without_pairs(database, others, work / f"{database.stem}_close.db")
    close = thinned(every, MOST_MATCHES, work / f"{database.stem}_close_thinned.db")
    begin = [pair for pair in beginnings if abs(rank[pair[0]] - rank[pair[1]]) <= _CLOSE]

    def mapped(given: Path, **options: Any) -> list[Any]:
        folder, images = work / "followed", work / "images"
        step = "following the walk"
        return reconstruct(given, images, folder, settings, progress, least_points=_LEAST_POINTS, step=step, **options)

    parts = mapped(close, beginnings=begin)
    given = [close]
    placed = {str(part.images[i].name) for part in parts for i in part.reg_image_ids()}
    rest = [file for file in files if file not in placed]
    if parts and len(rest) >= settings.min_registered:
        cameras = sorted({parts[0].images[i].camera_id for i in parts[0].reg_image_ids()})
        given.append(with_calibration(close, [parts[0].cameras[i] for i in cameras], work / "close_rest.db"))
        parts += mapped(given[-1], only=rest, known_cameras=cameras)
    for part in parts:
        # A pair is judged by the points of its features, whichever they are.
        add_points(part, every)
    for copy in (every, *given):
        copy.unlink()  # of a thousand photos it has most of a gigabyte
    return parts


def limit_of(apart: int, neighbours: int) -> float:
    """How far off the points of photos so many apart in the walk may be in a map of it, in focal lengths."""
    return NEAR if apart <= neighbours else min(FAR * max(1.0, apart / _DRIFTS), _MOST_FAR)


def believed_share(votes: Sequence[PointVote], rank: Mapping[int, int], neighbours: int) -> float:
    """Share of the matches of neighbours, beyond those next to each other, that agree; 0 where there are none."""
    near = [vote for vote in votes if vote.points >= FEWEST_POINTS and _apart(vote, rank) <= neighbours]
    return agreeing_share(near, NEAR)


def _apart(vote: PointVote, rank: Mapping[int, int]) -> int:
    return abs(rank[vote.first] - rank[vote.second])

"""A walk is mapped by the pairs that do not contradict each other; true ones among the others come in afterwards."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fsinfer.poses.chain import FAR, FEWEST_POINTS, NEAR, judge_pairs
from fsinfer.poses.closing import closed
from fsinfer.poses.colmap import PLACING, reconstruct
from fsinfer.poses.colmap_calls import image_number, open_database
from fsinfer.poses.matches import inliers_by_rank, is_walk
from fsinfer.poses.pairs import MIN_INLIERS
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.thinning import MOST_MATCHES, add_points, thinned
from fsinfer.poses.verification.misplaced import without_pairs
from fsinfer.poses.verification.point_votes import PointVote, point_votes
from fsinfer.poses.view_graph import beginnings, calibrate, configurations, contradicting, pair_turns
from fsinfer.progress import Progress

_log = logging.getLogger(__name__)


#: Pairs that were left out come back where their points are seen within so many focal lengths. Source: as of common
#: points of two parts, ``joining/common_points.py``.
_AGREES = 0.008
#: A walk is mapped again where so many pairs more agree, for each that it was made of. Source: judgement; of two walks
#: of 300 and 200 photos, mapped rightly at once, 0.016 and less.
_WORTH = 0.05


@dataclass(frozen=True, kw_only=True)
class SurePairs:
    """What a mapper is given.

    Attributes
    ----------
    database: with the matches of the pairs that do not contradict each other.
    matched: with those of all pairs but the ``false`` ones.
    left_out: the pairs that are not in ``database``, by COLMAP's numbers of their photos, the smaller first.
    false: those of them that the walk tells to be false.
    beginnings: pairs to begin with, the best first.
    true: those that the walk tells to be true. followed: its ``pycolmap.Reconstruction``, see
        :class:`fsinfer.poses.chain.Judged`.
    """

    database: Path
    matched: Path
    left_out: tuple[tuple[int, int], ...] = ()
    false: tuple[tuple[int, int], ...] = ()
    beginnings: tuple[tuple[int, int], ...] = ()
    true: frozenset[tuple[int, int]] = frozenset()
    followed: Any = field(default=None, compare=False)


def sure_pairs(
    database: Path, files: Sequence[str], work: Path, settings: PoseSettings, progress: Progress
) -> SurePairs:
    """Calibrate the cameras of ``database`` by their pairs, and choose the pairs to map a walk with.

    Photos in no order, and those for the global mapper, which judges for itself, keep all their pairs.

    Parameters
    ----------
    files: of all photos in the order of walking. work: folder with the photos in ``images``, and for copies of the
        database.
    """
    if settings.mapper != "incremental":
        return SurePairs(database=database, matched=database)
    walk = is_walk(database, files, settings)
    rank = _ranks(database, files)
    calibrate(database, work, rank if walk else None)
    if not walk:
        return SurePairs(database=database, matched=database)
    turns = pair_turns(database)
    begin = beginnings(turns)
    judged = judge_pairs(database, rank, files, work, settings, progress, beginnings=begin)
    matched = database
    if judged.false:
        matched = without_pairs(database, sorted(judged.false), work / f"{database.stem}_matched.db")
        # Without them the others tell their directions better.
        turns = pair_turns(matched)
        begin = beginnings(turns)
    known = judged.true | judged.false
    doubted = [pair for pair in contradicting(turns, rank, settings.pairs.overlap) if pair not in known]
    sure = without_pairs(matched, doubted, work / f"{database.stem}_sure.db") if doubted else matched
    left_out = sorted({*judged.false, *doubted})
    _log.info("%d pairs are true, %d false, and %d doubted", len(judged.true), len(judged.false), len(doubted))
    return SurePairs(
        database=sure,
        matched=matched,
        left_out=tuple(left_out),
        false=tuple(sorted(judged.false)),
        beginnings=tuple(begin),
        true=judged.true,
        followed=judged.followed,
    )


def with_more(
    model: Any, sure: SurePairs, database: Path, files: Sequence[str], work: Path, settings: PoseSettings
) -> SurePairs | None:
    """The sure pairs with those ``left_out`` that agree with a first map made without them; None where they are few.

    A long walk that is followed from photo to photo drifts by more than a pair that closes a loop is allowed. Those
    that close short ones take most of the drift away.

    Parameters
    ----------
    model: the ``pycolmap.Reconstruction`` that was made of ``sure``. database: with the matches of all pairs.
    files: of all photos in the order of walking. work: folder for copies of the database.
    """
    if not sure.left_out:
        return None
    rank = _ranks(database, files)

    def limit(vote: PointVote) -> float:
        near = abs(rank[vote.first] - rank[vote.second]) <= settings.pairs.overlap
        return NEAR if near else FAR

    agreed = _agreeing(model, sure.left_out, database, limit)
    counting = sum(found >= MIN_INLIERS for found in inliers_by_rank(sure.database, files).values())
    if not agreed or len(agreed) < _WORTH * counting:
        return None
    _log.info("%d of %d pairs left out agree with the first map", len(agreed), len(sure.left_out))
    left_out = sorted(set(sure.left_out) - agreed)
    false = sorted(set(sure.false) - agreed)
    return replace(
        sure,
        database=without_pairs(database, left_out, work / f"{database.stem}_more.db"),
        matched=without_pairs(database, false, work / f"{database.stem}_more_matched.db"),
        left_out=tuple(left_out),
        false=tuple(false),
    )


def map_sure(
    sure: SurePairs, images: Path, folder: Path, settings: PoseSettings, progress: Progress, start: Any = None
) -> list[Any]:
    """The models of the sure pairs, made by some of their matches and with the points of all, the largest first.

    A walk that was followed from its first photo to its last is closed instead, where that tells the true pairs right.

    Parameters
    ----------
    images: folder of the photos. folder: for the models, and beside it for a copy of the database. start: a model to go
        on from. See :func:`fsinfer.poses.colmap.reconstruct`.
    """
    if start is None and sure.followed is not None:
        total = int(sure.followed.num_reg_images())
        progress(0, total, PLACING)
        model = closed(sure.followed, sure.true, sure.database)
        if model is not None:
            progress(total, total, PLACING)
            return [model]
    given = sure.database
    if settings.mapper == "incremental":
        given = thinned(sure.database, MOST_MATCHES, folder.with_name(f"{folder.name}_thinned.db"))
    models = reconstruct(given, images, folder, settings, progress, start=start, beginnings=sure.beginnings)
    if given != sure.database:
        for model in models:
            add_points(model, sure.database)
        given.unlink()
    return models


def put_back(model: Any, left_out: Sequence[tuple[int, int]], database: Path, work: Path) -> int:
    """Observations of those pairs ``left_out`` that agree with the finished model; returns how many came.

    A poor pair may tell a wrong turn and have true matches all the same, and a walk followed from photo to photo
    drifts: the end of one whose ties to its beginning were such ones drifted by 3 cm without them.

    Parameters
    ----------
    model: ``pycolmap.Reconstruction``; it is changed. database: with the matches of all pairs. work: folder for a copy.
    """
    agreed = _agreeing(model, left_out, database, lambda _vote: _AGREES)
    if not agreed:
        return 0
    with open_database(database) as opened:
        others = [pair for pair in configurations(opened) if pair not in agreed]
    copy = without_pairs(database, others, work / f"{database.stem}_agreed.db")
    came = add_points(model, copy, {photo for pair in agreed for photo in pair})
    _log.info("%d of %d pairs left out agree, and bring %d observations", len(agreed), len(left_out), came)
    return came


def _agreeing(
    model: Any, pairs: Sequence[tuple[int, int]], database: Path, limit: Callable[[PointVote], float]
) -> set[tuple[int, int]]:
    """Those of the pairs whose points lie within ``limit`` focal lengths of where the other photo sees them."""
    votes = point_votes(model, database, frozenset(pairs)) if pairs else []
    return {(vote.first, vote.second) for vote in votes if vote.points >= FEWEST_POINTS and vote.error < limit(vote)}


def _ranks(database: Path, files: Sequence[str]) -> dict[int, int]:
    """Of each photo, by COLMAP's number, the place in the order of walking."""
    with open_database(database) as opened:
        return {image_number(opened, file): place for place, file in enumerate(files)}

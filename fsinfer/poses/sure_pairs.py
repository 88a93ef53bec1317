"""A walk is mapped by the pairs that do not contradict each other; true ones among the others come in afterwards."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fsinfer.poses.colmap_calls import SEED, call, database_cache, image_number, open_database
from fsinfer.poses.matches import is_walk
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.verification.misplaced import without_pairs
from fsinfer.poses.verification.pair_votes import pair_votes
from fsinfer.poses.view_graph import beginnings, calibrate, configurations, contradicting, pair_turns

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class SurePairs:
    """What a mapper is given.

    Attributes
    ----------
    database: with the matches of the pairs that do not contradict each other.
    left_out: the others, by COLMAP's numbers of their photos, the smaller first.
    beginnings: pairs to begin with, the best first.
    """

    database: Path
    left_out: tuple[tuple[int, int], ...] = ()
    beginnings: tuple[tuple[int, int], ...] = ()


def sure_pairs(database: Path, files: Sequence[str], work: Path, settings: PoseSettings) -> SurePairs:
    """Calibrate the cameras of ``database`` by their pairs, and choose the pairs to map a walk with.

    Photos in no order, and those for the global mapper, which judges for itself, keep all their pairs.

    Parameters
    ----------
    files: of all photos in the order of walking. work: folder for copies of the database.
    """
    if settings.mapper != "incremental":
        return SurePairs(database=database)
    calibrate(database, work)
    if not is_walk(database, files, settings):
        return SurePairs(database=database)
    turns = pair_turns(database)
    with open_database(database) as opened:
        rank = {image_number(opened, file): place for place, file in enumerate(files)}
    left_out = contradicting(turns, rank, settings.pairs.overlap)
    _log.info("%d of %d pairs turn against all others", len(left_out), len(turns))
    sure = without_pairs(database, left_out, work / f"{database.stem}_sure.db") if left_out else database
    return SurePairs(database=sure, left_out=tuple(left_out), beginnings=tuple(beginnings(turns)))


def put_back(model: Any, left_out: Sequence[tuple[int, int]], database: Path, work: Path) -> int:
    """Observations of those pairs ``left_out`` that agree with the finished model; returns how many came.

    A poor pair may tell a wrong turn and have true matches all the same: the end of a walk whose ties to its beginning
    were such ones drifted by 3 cm without them.

    Parameters
    ----------
    model: ``pycolmap.Reconstruction``; it is changed. database: with the matches of all pairs. work: folder for a copy.
    """
    import pycolmap

    image_ids, votes = pair_votes(model, database) if left_out else ([], [])
    agreed = set(left_out) & {
        _in_order(image_ids[vote.first], image_ids[vote.second])
        for vote in votes
        if vote.agrees and vote.telling_agrees
    }
    if not agreed:
        return 0
    with open_database(database) as opened:
        others = [pair for pair in configurations(opened) if pair not in agreed]
    copy = without_pairs(database, others, work / f"{database.stem}_agreed.db")
    mapper = pycolmap.IncrementalMapper(database_cache(copy, all_photos=True))
    rules = pycolmap.IncrementalTriangulatorOptions()
    rules.random_seed = SEED
    call(mapper.begin_reconstruction, model)
    placed = set(model.reg_image_ids())
    came = sum(call(mapper.triangulate_image, rules, i) for i in sorted({i for p in agreed for i in p} & placed))
    call(mapper.merge_tracks, rules)
    call(mapper.end_reconstruction, False)
    _log.info("%d of %d pairs left out agree, and bring %d observations", len(agreed), len(left_out), came)
    return int(came)


def _in_order(first: int, second: int) -> tuple[int, int]:
    """As COLMAP names a pair."""
    return (first, second) if first < second else (second, first)

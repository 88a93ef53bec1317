"""A model in which photos were placed against their own matches, mapped again without the false ones."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

from fsinfer.poses.boards import BoardSighting
from fsinfer.poses.colmap import reconstruct, triangulate
from fsinfer.poses.joining.stretches import cut_and_join
from fsinfer.poses.matches import is_walk
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.verification.misplaced import (
    agreeing_matches,
    drop,
    drop_contradicted,
    drop_far,
    drop_loose_parts,
    drop_strays,
    shrunk_photos,
    without_pairs,
)
from fsinfer.poses.verification.pair_votes import contradicted, false_pairs, pair_votes
from fsinfer.progress import Progress

_log = logging.getLogger(__name__)

# How photos are judged before they are mapped again, see :func:`fsinfer.poses.verification.pair_votes.contradicted`:
# none of these ways was the best on all plots.
_WAYS = (("never", False), ("before", False), ("never", True))


def repair(
    model: Any,
    database: Path,
    walk: Sequence[str],
    work: Path,
    settings: PoseSettings,
    progress: Progress,
    *,
    sightings: Sequence[BoardSighting] = (),
) -> tuple[Any, dict[str, list[str]]]:
    """The model that most matches agree with, and by reason the files of the photos that were taken out of it.

    Parameters
    ----------
    model: ``pycolmap.Reconstruction`` that the mapper made of ``database``; it is changed.
    walk: files of all photos in the order of walking.
    work: folder that holds the photos in ``images``.
    sightings: of boards, which tie stretches of the walk.

    Notes
    -----
    Rendered plots whose trees share their bark: of 300 photos 24 lay 6.4 m off, of the first 100 of them 20, and all
    are right afterwards; of 200 with a quick turn 8 were wrong, ten are left out afterwards and the others right.
    """
    neighbours = settings.pairs.overlap if is_walk(database, walk, settings) else 0
    return max(
        _candidates(model, database, walk, work, settings, progress, neighbours, sightings),
        key=lambda candidate: agreeing_matches(candidate[0], database, neighbours),
    )


def repair_part(part: Any, database: Path, neighbours: int, least: int, mapped: Callable[[Any], Sequence[Any]]) -> Any:
    """A part without the photos that contradict their place, or with them where they belong.

    27 photos that had shrunk to a point beside 50 that were right find their place once those stand alone.

    Parameters
    ----------
    part: ``pycolmap.Reconstruction``; it is changed. neighbours: see
        :func:`fsinfer.poses.verification.misplaced.drop_contradicted`.
    least: photos of a part to go on from. mapped: the models that come of one to start from, the largest first.
    """
    if not drop_contradicted(part, database, neighbours) or part.num_reg_images() < least:
        return part
    return _mapped_on(part, lambda model: drop_contradicted(model, database, neighbours), mapped)


def placed_again(
    model: Any, walk: Sequence[str], database: Path, mapped: Callable[[Any], Sequence[Any]]
) -> tuple[Any, list[str]]:
    """A joined model with the photos that are astray in it where they belong, or without them; and the files of those.

    Four photos of a torn walk that were placed before the rest of their stretch was joined lay 134 km away.

    Parameters
    ----------
    model: ``pycolmap.Reconstruction``; it is changed. walk: files in the order of walking; empty where there is none.
    mapped: the models that come of one to start from, the largest first.
    """

    def astray(judged: Any) -> list[str]:
        return [*drop_far(judged), *(drop_strays(judged, walk, database) if walk else [])]

    lost = astray(model)
    if not lost:
        return model, []
    model = _mapped_on(model, astray, mapped)
    placed = {str(model.images[i].name) for i in model.reg_image_ids()}
    return model, [file for file in lost if file not in placed]


def _mapped_on(start: Any, take_out: Callable[[Any], Sequence[str]], mapped: Callable[[Any], Sequence[Any]]) -> Any:
    """What is ``mapped`` from a model, less the photos that are wrong in it; the model where that has no more."""
    again = next(iter(mapped(deepcopy(start))), None)
    if again is None:
        return start
    take_out(again)
    return max(start, again, key=lambda model: model.num_reg_images())


def _candidates(
    model: Any,
    database: Path,
    walk: Sequence[str],
    work: Path,
    settings: PoseSettings,
    progress: Progress,
    neighbours: int,
    sightings: Sequence[BoardSighting],
) -> Iterator[tuple[Any, dict[str, list[str]]]]:
    """The mapper's model and, where photos were placed against their matches, what becomes of it without them.

    First, and often enough: the stretches of an ordered walk, each of which is right in itself, put together anew.
    Without the false matches that misled the mapper it finds their true place, or none. Which matches were false is
    judged in several ways. Each comes with the files of the photos that were taken out of it.
    """
    if neighbours and settings.mapper == "incremental":
        model = _grown(model, database, walk, work, settings, progress)
    image_ids, votes = pair_votes(model, database)
    if neighbours and settings.mapper == "incremental":
        straight = cut_and_join(model, (image_ids, votes), database, walk, sightings, work, settings, progress)
        if straight is not None:
            misplaced = _drop_misplaced(straight, database, walk, neighbours, joined=True)
            yield straight, misplaced
            enough = settings.thorough.min_share * len(walk)
            if straight.num_reg_images() < enough:
                straight = _mapped_from_stretches(straight, database, work, settings, progress)
                misplaced = _drop_misplaced(straight, database, walk, neighbours, joined=True)
                yield straight, misplaced
            if straight.num_reg_images() >= enough:
                return  # what is still missing is not worth mapping the walk three times more
    tried: set[bytes] = set()
    for stretches, lenient in _WAYS if settings.mapper == "incremental" else ():
        wrong = contradicted(votes, len(image_ids), neighbours=neighbours, stretches=stretches, lenient=lenient)
        judged = wrong.tobytes()
        if not wrong.any() or judged in tried:
            continue  # what is judged the same way is mapped the same way
        tried.add(judged)
        start = deepcopy(model)
        drop(start, [image_id for image_id, is_wrong in zip(image_ids, wrong, strict=True) if is_wrong])
        if start.num_reg_images() < settings.min_registered:
            break
        false = [(image_ids[vote.first], image_ids[vote.second]) for vote in false_pairs(votes, wrong)]
        clean = without_pairs(database, false, work / "without_false.db")
        folder = work / f"again_{stretches}_{'lenient' if lenient else 'strict'}"
        mapped = reconstruct(clean, work / "images", folder, settings, progress, start=start)
        if mapped:
            misplaced = _drop_misplaced(mapped[0], database, walk, neighbours)
            yield mapped[0], misplaced
            if mapped[0].num_reg_images() == len(walk) and not any(misplaced.values()):
                return  # nothing can be better
    yield model, _drop_misplaced(model, database, walk, neighbours)


def _mapped_from_stretches(start: Any, database: Path, work: Path, settings: PoseSettings, progress: Progress) -> Any:
    """The stretches of a walk with the photos that had no place among them, or a wrong one.

    What the stretches see of each other was never compared, and holds those photos where they belong: on a rendered
    slope 174 of 200, all of them right, became 196.
    """
    compared = triangulate(deepcopy(start), database, work / "images", work / "cut_compared")
    mapped = reconstruct(database, work / "images", work / "cut_again", settings, progress, start=compared)
    return mapped[0] if mapped else start


def _grown(
    model: Any, database: Path, walk: Sequence[str], work: Path, settings: PoseSettings, progress: Progress
) -> Any:
    """The model with the photos of stretches that were placed far too small placed anew, from both ends."""
    small = shrunk_photos(model, walk, database)
    if not small:
        return model
    start = deepcopy(model)
    drop(start, small)
    if start.num_reg_images() < settings.min_registered:
        return model
    _log.info("%d photos were placed far too near to each other, and are placed again", len(small))
    mapped = reconstruct(database, work / "images", work / "grown", settings, progress, start=start)
    return mapped[0] if mapped else start


def _drop_misplaced(
    model: Any, database: Path, walk: Sequence[str], neighbours: int, *, joined: bool = False
) -> dict[str, list[str]]:
    """Take photos that are placed wrongly out of the model; returns their files by reason.

    Parts that were ``joined`` by evidence of their own are not outvoted: a walk begun anew has no true neighbours, and
    false matches with these count much. Of two straight walks, right to 20 mm, less than two fifths of the votes were.
    """
    small = drop(model, shrunk_photos(model, walk, database)) if neighbours else []
    return {
        "astray": [*small, *drop_strays(model, walk, database)],
        # All matches vote, so that no photo comes back whose true matches were taken for false ones.
        "contradicted": drop_contradicted(model, database, neighbours, parts=not joined),
        "loose": drop_loose_parts(model),
    }

"""A model that was bent where the walk goes on: cut there, and its stretches put together again."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.poses.boards import BoardSighting
from fsinfer.poses.colmap import reconstruct
from fsinfer.poses.joining.parts import join_parts
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.verification.misplaced import drop
from fsinfer.poses.verification.pair_votes import PairVote, pair_votes, telling_votes
from fsinfer.poses.verification.stretches import stretches_of_walk
from fsinfer.progress import Progress

_log = logging.getLogger(__name__)


def cut_and_join(
    model: Any,
    votes: tuple[Sequence[int], Sequence[PairVote]],
    database: Path,
    walk: Sequence[str],
    sightings: Sequence[BoardSighting],
    work: Path,
    settings: PoseSettings,
    progress: Progress,
) -> Any | None:
    """The stretches of ``model``, a ``pycolmap.Reconstruction``, each at its place; None where it was not bent.

    Photos of stretches that could not be placed are mapped onto the others, as far as neighbours then agree.
    ``votes`` are those of :func:`fsinfer.poses.verification.pair_votes.pair_votes` on the model.
    """
    image_ids, cast = votes
    stretch = stretches_of_walk(telling_votes(cast), len(image_ids), settings.pairs.overlap)
    if not len(stretch) or stretch[-1] == 0:
        return None
    numbers, sizes = np.unique(stretch, return_counts=True)
    parts: list[Any] = []
    for k in np.argsort(-sizes, kind="stable"):
        if sizes[k] < settings.min_registered:
            break
        part = deepcopy(model)
        drop(part, [i for i, own in zip(image_ids, stretch, strict=True) if own != numbers[k]])
        if parts:
            # The features of the other photos are most of a model, and a long walk may have dozens of stretches.
            part.tear_down()
        parts.append(part)
    if not parts:
        return None
    base = parts[0]
    joined, left = join_parts(base, parts[1:], sightings, database=database, walk=walk)
    _log.info("cut into %d stretches; %d photos joined, %d stretches left", stretch[-1] + 1, len(joined), len(left))
    placed = set(base.reg_image_ids())
    mapped = reconstruct(database, work / "images", work / "cut", settings, progress, start=base)
    if not mapped:
        return None
    drop(mapped[0], _bent_again(mapped[0], database, placed, settings.pairs.overlap))
    return mapped[0]


def _bent_again(model: Any, database: Path, placed: set[int], neighbours: int) -> list[int]:
    """Photos that the mapper put where their neighbours contradict it, of those that were not ``placed`` before."""
    image_ids, votes = pair_votes(model, database)
    stretch = stretches_of_walk(telling_votes(votes), len(image_ids), neighbours)
    trusted = {int(own) for image_id, own in zip(image_ids, stretch, strict=True) if image_id in placed}
    return [image_id for image_id, own in zip(image_ids, stretch, strict=True) if int(own) not in trusted]

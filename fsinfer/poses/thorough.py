"""Thorough where the walk tore: more features and more pairs, only for photos that have no place and those beside them.

Features cost by their square in matching, so that all photos get few at first. Where a walk tears (leaves that move,
a smooth floor, blur) neighbours share too few of them, and a photo that is doubled gives several times as many.
"""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from fsinfer.poses.colmap import extract_features
from fsinfer.poses.colmap_calls import copy_database, open_database
from fsinfer.poses.matches import inliers_by_rank, match_pairs
from fsinfer.poses.pairs import MIN_INLIERS, Pair
from fsinfer.poses.settings import DOUBLED, PoseSettings
from fsinfer.progress import Progress

_log = logging.getLogger(__name__)

#: Photos are doubled whatever their size. Source: COLMAP's default.
_DOUBLE_ALL_PX = 1_000_000


def torn(placed: Sequence[bool], settings: PoseSettings) -> bool:
    """Whether so many photos have no place that a second, thorough round is worth its time."""
    return sum(placed) < settings.thorough.min_share * len(placed)


def seams(placed: Sequence[bool], beside: int) -> list[int]:
    """Ranks of the photos without a place and of those up to ``beside`` photos before and after them, sorted."""
    missing = [rank for rank, has_place in enumerate(placed) if not has_place]
    count = len(placed)
    return sorted({near for rank in missing for near in range(max(0, rank - beside), min(count, rank + beside + 1))})


def thorough_pairs(
    placed: Sequence[bool], affected: Sequence[int], found: Mapping[Pair, int], settings: PoseSettings
) -> list[Pair]:
    """Pairs to be matched again, sorted, ``first < second``.

    Those of the affected photos that are neighbours in the walk, within more photos than at first, and those that
    matched before; and a net between the photos without a place and all others.

    Parameters
    ----------
    found: of the pairs that were tried before, the matches that passed the geometric check.
    """
    thorough, count = settings.thorough, len(placed)
    again = set(affected)
    pairs: set[Pair] = set()
    for rank in affected:
        low, high = max(0, rank - thorough.overlap), min(count - 1, rank + thorough.overlap)
        pairs |= {(min(rank, near), max(rank, near)) for near in range(low, high + 1) if near != rank}
    for (first, second), inliers in found.items():
        if inliers >= MIN_INLIERS and (first in again or second in again):
            pairs.add((first, second))
    stride = thorough.net_stride
    for rank in range(0, count, stride):
        if not placed[rank]:
            pairs |= {(min(rank, other), max(rank, other)) for other in range(0, count, stride) if other != rank}
    return sorted((i, j) for i, j in pairs if 0 <= i < j < count and (i in again or j in again))


def rematch(
    database: Path,
    images: Path,
    cameras: Mapping[str, Sequence[str]],
    walk: Sequence[str],
    placed: Sequence[bool],
    settings: PoseSettings,
    progress: Progress,
) -> Path:
    """A database beside ``database`` with more features of the affected photos, and their matches; returns its path.

    Parameters
    ----------
    cameras: ``{camera: file names}``, see :func:`fsinfer.poses.colmap.extract_features`.
    walk: files of all photos in the order of walking. placed: whether each of them has a place.

    A run that was stopped in here goes on where it was.
    """
    target = database.with_name("thorough.db")
    affected = seams(placed, settings.thorough.beside)
    files = [walk[rank] for rank in affected]
    found = inliers_by_rank(database, walk)
    if not target.exists():
        begun = target.with_suffix(".begun")
        _forget(database, files, begun)
        begun.rename(target)
    _log.info("the walk tore: %d of %d photos are looked at again", len(files), len(walk))
    again = set(files)
    rich = replace(
        settings,
        enlarge_below_px=_DOUBLE_ALL_PX,
        enlargement=DOUBLED,
        max_enlarged_features=settings.thorough.max_features,
    )
    group = {camera: [file for file in members if file in again] for camera, members in cameras.items()}
    step = "looking again where the walk tore"
    extract_features(target, images, {k: v for k, v in group.items() if v}, rich, progress, step=step)
    match_pairs(target, walk, thorough_pairs(placed, affected, found, settings), settings, progress, step=step)
    return target


def _forget(database: Path, files: Sequence[str], copy: Path) -> None:
    """A copy of the database without the features of these photos and without their matches."""
    import pycolmap

    copy_database(database, copy)
    with open_database(copy) as opened:
        ids = {image.image_id for image in opened.read_all_images() if image.name in set(files)}
        for pair_id in opened.read_two_view_geometry_num_inliers()[0]:
            _forget_pair(opened, pycolmap.pair_id_to_image_pair(pair_id), ids)
        for pair_id in opened.read_num_matches()[0]:
            _forget_pair(opened, pycolmap.pair_id_to_image_pair(pair_id), ids)
    # COLMAP's interface forgets the features of all photos or of none.
    with closing(sqlite3.connect(copy)) as target:
        for table in ("keypoints", "descriptors"):
            target.executemany(f"DELETE FROM {table} WHERE image_id = ?", [(i,) for i in sorted(ids)])
        target.commit()


def _forget_pair(opened: Any, pair: tuple[int, int], ids: set[int]) -> None:
    if ids.intersection(pair):
        opened.delete_matches(*pair)
        opened.delete_two_view_geometry(*pair)

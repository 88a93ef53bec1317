"""Pairs of photos: which are matched, their matches found and checked, and how many passed.

Everything is done in small batches, so that progress can be told, a key press can stop it, and a repetition after a
kill goes on from the database.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.geometric_check import check_pairs
from fsinfer.poses.matching import PairMatcher
from fsinfer.poses.pairs import first_pairs, in_walking_order, most_pairs, pairs_beside
from fsinfer.poses.settings import PoseSettings
from fsinfer.progress import Progress

#: Pairs matched at a time: large enough that what is kept of their photos serves many of them. Source: numerics.
_PAIRS_PER_BATCH = 120


def match_features(database: Path, names: Sequence[str], settings: PoseSettings, progress: Progress) -> None:
    """Match the photos and check the matches geometrically; pairs that the database has are not matched again.

    ``names`` are those of the photos in the order of walking.
    """
    count = len(names)
    pairs = first_pairs(count, settings.pairs)
    rounds = settings.pairs.rounds if count > settings.pairs.exhaustive_up_to else 0
    total = most_pairs(count, settings.pairs)
    _match(database, names, pairs, settings, progress, 0, total)
    tried = pairs
    for _ in range(rounds):
        # Only what was matched before this round decides, so that a run that was killed in it goes on to the same end.
        found = inliers_by_rank(database, names)
        pairs = pairs_beside({pair: found.get(pair, 0) for pair in tried}, count, settings.pairs)
        _match(database, names, pairs, settings, progress, len(tried), total)
        tried = tried + pairs
    progress(total, total, "matching photos")


def match_pairs(
    database: Path,
    names: Sequence[str],
    pairs: Sequence[tuple[int, int]],
    settings: PoseSettings,
    progress: Progress,
    *,
    step: str = "matching photos",
) -> None:
    """Match these pairs of photos, by their ranks among ``names``; those that the database has are not repeated."""
    _match(database, names, pairs, settings, progress, 0, len(pairs), step=step)
    progress(len(pairs), len(pairs), step)


def inliers_by_rank(database: Path, names: Sequence[str]) -> dict[tuple[int, int], int]:
    """Matches of each pair of photos, by their ranks, that passed the geometric check."""
    import pycolmap

    rank = {name: index for index, name in enumerate(names)}
    with open_database(database) as opened:
        number = {image.image_id: rank[image.name] for image in opened.read_all_images()}
        pair_ids, counts = opened.read_two_view_geometry_num_inliers()
    found = {}
    for pair_id, inliers in zip(pair_ids, counts, strict=True):
        first, second = sorted(number[i] for i in pycolmap.pair_id_to_image_pair(pair_id))
        found[first, second] = int(inliers)
    return found


def is_walk(database: Path, names: Sequence[str], settings: PoseSettings) -> bool:
    """Whether the photos, in the order of their names, were taken one after the other, as far as matches tell."""
    return in_walking_order(inliers_by_rank(database, names), len(names), settings.pairs)


def _match(
    database: Path,
    names: Sequence[str],
    pairs: Sequence[tuple[int, int]],
    settings: PoseSettings,
    progress: Progress,
    done: int,
    total: int,
    *,
    step: str = "matching photos",
) -> None:
    import pycolmap

    rules = pycolmap.FeatureMatchingOptions().sift
    matcher = PairMatcher(database, names, max_ratio=rules.max_ratio, max_angle=rules.max_distance)
    for start in range(0, len(pairs), _PAIRS_PER_BATCH):
        progress(done + start, total, step)
        batch = pairs[start : start + _PAIRS_PER_BATCH]
        matcher.match(batch, settings.thread_count)
        check_pairs(database, [(names[first], names[second]) for first, second in batch], settings.thread_count)

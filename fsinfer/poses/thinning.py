"""Mapping with fewer matches, and the points of all of them afterwards.

The time that the incremental mapper takes goes with the observations of its points, and some hundred matches of a pair
tell where its photos stand. What the others see is placed by the finished map.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.colmap_calls import SEED, call, copy_for_mapping, database_cache, open_database
from fsinfer.poses.pairs import MIN_INLIERS

#: Matches of a pair that a mapper is given. Source: numerics, docs/trials-speed.md; 300 rendered photos of 700 matches
#: a pair are followed in 10 instead of 18 s, of 3,433 verdicts 5 changing, and mapped in 25 instead of 36; with 120 the
#: walk tears; renders only.
MOST_MATCHES = 300


def thinned(database: Path, most: int, copy: Path) -> Path:
    """A copy of the database in which no pair has more than ``most`` matches; returns ``copy``.

    Kept are those whose features other pairs see as well, pairs of few matches above all: a photo finds its place by
    features that have a point already, and one that a weak pair alone ties to the rest has no others.
    """
    import pycolmap

    copy_for_mapping(database, copy)
    with open_database(copy) as opened:
        worth = {
            image.image_id: np.zeros(int(opened.num_keypoints_for_image(image.image_id)))
            for image in opened.read_all_images()
        }
        pairs: list[tuple[int, int, Any, NDArray[np.intp]]] = []
        for pair_id, geometry in zip(*opened.read_two_view_geometries(), strict=True):
            first, second = pycolmap.pair_id_to_image_pair(pair_id)
            matches = np.asarray(geometry.inlier_matches, np.intp).reshape(-1, 2)
            if len(matches) < MIN_INLIERS:
                continue
            pairs.append((first, second, geometry, matches))
            for side, photo in enumerate((first, second)):
                np.add.at(worth[photo], matches[:, side], 1 / len(matches))
        for first, second, geometry, matches in pairs:
            if len(matches) > most:
                value = worth[first][matches[:, 0]] + worth[second][matches[:, 1]]
                kept = np.sort(np.argsort(-value, kind="stable")[:most])
                geometry.inlier_matches = matches[kept].astype(np.uint32)
                opened.delete_two_view_geometry(first, second)
                opened.write_two_view_geometry(first, second, geometry)
    return copy


def add_points(model: Any, database: Path, photos: AbstractSet[int] | None = None) -> int:
    """The points, and the observations of its points, that matches in ``database`` tell; returns how many came.

    Parameters
    ----------
    model: ``pycolmap.Reconstruction``; it is changed, and nothing in it is adjusted. photos: by COLMAP's numbers, those
        whose features are placed; None: of all.
    """
    with _triangulating(model, database) as (mapper, rules):
        placed = set(model.reg_image_ids())
        asked = sorted(placed if photos is None else placed & photos)
        came = sum(call(mapper.triangulate_image, rules, i) for i in asked)
        call(mapper.merge_tracks, rules)
    return int(came)


def join_points(model: Any, database: Path) -> int:
    """Observations of its points, and points that are one, which matches in ``database`` tell; returns how many.

    Less than :func:`add_points`: features without a point get none. ``model`` is changed, and nothing in it adjusted.
    """
    with _triangulating(model, database) as (mapper, rules):
        return int(call(mapper.complete_tracks, rules) + call(mapper.merge_tracks, rules))


@contextmanager
def _triangulating(model: Any, database: Path) -> Iterator[tuple[Any, Any]]:
    """A ``pycolmap.IncrementalMapper`` that changes ``model`` by the matches of ``database``, and its rules."""
    import pycolmap

    mapper = pycolmap.IncrementalMapper(database_cache(database, all_photos=True))
    rules = pycolmap.IncrementalTriangulatorOptions()
    rules.random_seed = SEED
    call(mapper.begin_reconstruction, model)
    yield mapper, rules
    call(mapper.end_reconstruction, False)

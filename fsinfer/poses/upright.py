"""Whether the features of a walk's photos may keep the pictures' own up.

SIFT turns each feature to the strongest slope about it, and makes two of it where two are about as strong, so that
photos turned against each other match. Who walks through a wood holds the camera upright (a phone says which way it was
held, and its photos are turned by that before): then the turns only add features of one place, a sixth of all, which
matching pays for twice. A few pairs of neighbours, looked at both ways, tell whether anything is lost without them.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.io.files import make_folder, write_text
from fsinfer.poses.colmap import extract_features
from fsinfer.poses.colmap_calls import image_number, open_database
from fsinfer.poses.matches import match_pairs
from fsinfer.poses.pairs import MIN_INLIERS
from fsinfer.poses.settings import PoseSettings
from fsinfer.progress import Progress, silent

_log = logging.getLogger(__name__)

#: Share of the matches with turned features that a pair, and all pairs together, must have without. Source: numerics;
#: 22 pairs of phone photos 0.65 and 1.03, 25 of a rendered walk 0.82 and 0.95; photos turned by 90 degrees have none.
_LEAST_OF_PAIR, _LEAST_OF_ALL = 0.6, 0.85
#: Share of the pairs that must match at all to tell. Source: judgement.
_LEAST_TELLING = 0.5


def as_the_photos_stand(
    settings: PoseSettings, images: Path, files: Sequence[str], work: Path, progress: Progress
) -> PoseSettings:
    """``settings``, with ``upright`` where the photos of a long walk match as well so.

    Parameters
    ----------
    images: folder of the ``files``, which are in the order of walking. work: folder for what is looked at, and for the
        answer, which a run that was stopped finds there.
    """
    if settings.upright or settings.upright_pairs < 1 or len(files) <= settings.pairs.exhaustive_up_to:
        return settings
    answer = work / "upright.json"
    if not answer.is_file():
        progress(0, len(files), "finding features")
        first = sorted({int(rank) for rank in np.linspace(0, len(files) - 2, settings.upright_pairs)})
        turned, kept = (
            _shared(replace(settings, upright=upright), images, files, first, make_folder(work / "upright"))
            for upright in (False, True)
        )
        upright = matches_as_well(turned, kept)
        _log.info("matches of %d pairs with turned features %s, upright %s", len(first), turned, kept)
        write_text(answer, json.dumps({"upright": upright, "turned": turned, "kept": kept}) + "\n")
    return replace(settings, upright=bool(json.loads(answer.read_text(encoding="utf-8"))["upright"]))


def matches_as_well(turned: Sequence[int], kept: Sequence[int]) -> bool:
    """Whether pairs that have so many matches with ``turned`` features have about as many with those ``kept`` upright.

    Pairs that do not match either way tell nothing.
    """
    telling = [(before, after) for before, after in zip(turned, kept, strict=True) if max(before, after) >= MIN_INLIERS]
    if not telling or len(telling) < _LEAST_TELLING * len(turned):
        return False
    of_all = sum(after for _, after in telling) >= _LEAST_OF_ALL * sum(before for before, _ in telling)
    return of_all and all(after >= _LEAST_OF_PAIR * before for before, after in telling)


def _shared(settings: PoseSettings, images: Path, files: Sequence[str], first: Sequence[int], work: Path) -> list[int]:
    """Of these photos and the ones after them, the places that they share; two features of one place count once."""
    database = work / f"{'upright' if settings.upright else 'turned'}.db"
    walk = [files[rank] for rank in sorted({*first, *(rank + 1 for rank in first)})]
    pairs = [(walk.index(files[rank]), walk.index(files[rank + 1])) for rank in first]
    extract_features(database, images, {"sample": walk}, settings, silent)
    match_pairs(database, walk, pairs, settings, silent)
    with open_database(database) as opened:
        numbers = [image_number(opened, name) for name in walk]
        return [_places_shared(opened, numbers[one], numbers[other]) for one, other in pairs]


def _places_shared(opened: Any, first: int, second: int) -> int:
    matches = np.asarray(opened.read_two_view_geometry(first, second).inlier_matches, dtype=np.intp).reshape(-1, 2)
    places = np.asarray(opened.read_keypoints(first))[:, :2]
    return len(np.unique(places[matches[:, 0]], axis=0))

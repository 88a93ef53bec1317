"""Structure from motion of a walk: cheap first, thorough where it tore, parts joined, boards as ties."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.errors import PosesError
from fsinfer.poses.boards import BoardSighting, boards_in, find_boards, tie_boards
from fsinfer.poses.colmap import extract_features, reconstruct, triangulate, with_calibration
from fsinfer.poses.joining.parts import join_parts
from fsinfer.poses.matches import is_walk, match_features
from fsinfer.poses.refinement import FEATURE_SIZE_PX
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.sure_pairs import put_back, sure_pairs
from fsinfer.poses.thorough import rematch, seams, torn
from fsinfer.poses.verification.misplaced import drop
from fsinfer.poses.verification.repair import placed_again, repair, repair_part
from fsinfer.progress import Progress
from fsinfer.threads import beside

_log = logging.getLogger(__name__)

#: Share of the photos that must be left to go on from. Source: judgement.
_LEAST_START = 0.25
#: Photos that look in directions so far apart tell the focal length. Source: judgement; a wrong one bends a walk that
#: turns by so much visibly, and one straight ahead not at all.
_LEAST_TURN_DEG = 60.0

ADVICE = (
    "photos must overlap by two thirds or more, be sharp, and show bark, litter or other texture in good light, from "
    "so far away that both edges of a stem and the ground are in the picture; "
    "walk on a little between photos and do not only turn on the spot"
)


@dataclass(frozen=True, kw_only=True)
class Walk:
    """The photos of one walk.

    Attributes
    ----------
    files: in the order of walking.
    cameras: ``{camera: files}``; the photos of one camera share one calibration.
    """

    files: tuple[str, ...]
    cameras: Mapping[str, Sequence[str]]

    def has_place(self, model: Any) -> list[bool]:
        """Whether each photo is in a ``pycolmap.Reconstruction``."""
        placed = {model.images[i].name for i in model.reg_image_ids()}
        return [file in placed for file in self.files]


@dataclass(frozen=True, kw_only=True)
class MappedWalk:
    """What the mapper made of a walk.

    Attributes
    ----------
    model: the ``pycolmap.Reconstruction``, not yet refined.
    misplaced: by reason the files of photos that were placed wrongly and taken out.
    joined: files of photos that were mapped apart and joined to the rest. apart: those of each part that was not.
    """

    model: Any
    misplaced: dict[str, list[str]]
    joined: tuple[str, ...] = ()
    apart: tuple[tuple[str, ...], ...] = field(default=())


def map_walk(walk: Walk, given: Path, work: Path, settings: PoseSettings, progress: Progress) -> MappedWalk:
    """Features, matches and the map of all photos in ``work/images``.

    Parameters
    ----------
    given: what messages call the photos. work: folder for the database and the models; a run that was stopped finds
        its features and matches there.

    Raises
    ------
    PosesError
        Fewer than ``settings.min_registered`` photos could be placed together.
    """
    images, database = work / "images", work / "database.db"
    extract_features(database, images, walk.cameras, settings, progress)
    match_features(database, walk.files, settings, progress)

    def look_for_boards(told: Progress, threads: int) -> list[BoardSighting]:
        return find_boards(
            images,
            walk.files,
            dictionary=settings.dictionary,
            longest_px=FEATURE_SIZE_PX,
            progress=told,
            threads=threads,
        )

    def map_all() -> list[Any]:
        return reconstruct(sure.database, images, work / "models", settings, progress, beginnings=sure.beginnings)

    sure = sure_pairs(database, walk.files, work, settings, progress)
    if settings.mapper == "incremental" and settings.photo_threads > 1:

        def quietly(go_on: Callable[[], None]) -> list[BoardSighting]:
            return look_for_boards(lambda _done, _total, _what: go_on(), settings.photo_threads - 1)

        # The incremental mapper has one thread, and lets others work.
        with beside(quietly) as boards:
            models = map_all()
            sightings = boards()
    else:
        sightings = look_for_boards(progress, settings.photo_threads)
        models = map_all()
    placed = models[0].num_reg_images() if models else 0
    model: Any = None
    misplaced: dict[str, list[str]] = {}
    if placed >= settings.min_registered:
        model, misplaced = repair(models[0], sure.matched, walk.files, work, settings, progress, sightings=sightings)
        put_back(model, sure.left_out, database, work)
    has_place = walk.has_place(model) if model is not None else [False] * len(walk.files)
    matched = sure.matched
    if torn(has_place, settings):
        richer = rematch(database, images, walk.cameras, walk.files, has_place, settings, progress)
        start = _beyond_the_tear(model, walk, seams(has_place, settings.thorough.beside), settings)
        sure = sure_pairs(richer, walk.files, work, settings, progress)
        again = reconstruct(
            sure.database, images, work / "thorough", settings, progress, start=start, beginnings=sure.beginnings
        )
        if again and again[0].num_reg_images() >= max(sum(has_place), settings.min_registered):
            better, wrong = repair(again[0], sure.matched, walk.files, work, settings, progress, sightings=sightings)
            put_back(better, sure.left_out, richer, work)
            if sum(walk.has_place(better)) > sum(has_place):
                _log.info("thorough: %d instead of %d photos", better.num_reg_images(), sum(has_place))
                model, misplaced, models = better, wrong, again
                matched = sure.matched
        placed = max(placed, again[0].num_reg_images() if again else 0)
    if model is None:
        found = "no two photos" if placed == 0 else f"only {placed} photos"
        msg = f"{found} of the {len(walk.files)} in {given} could be placed together: {ADVICE}"
        raise PosesError(msg)
    if model.num_reg_images() < settings.min_registered:
        msg = f"the {len(walk.files)} photos in {given} match in ways that contradict each other: {ADVICE}"
        raise PosesError(msg)
    # What was taken out as misplaced hangs together, too: mapped alone, nothing false pulls at it.
    if settings.mapper == "incremental":
        parts = _alone(model, matched, walk, work, settings, progress)
    else:
        parts = [part for part in models[1:] if part.num_reg_images() >= settings.min_registered]
    path = walk.files if is_walk(matched, walk.files, settings) else ()
    joined, left = join_parts(model, parts, sightings, database=matched, walk=path)
    if joined:
        # What both parts see of the wood was never compared while they stood apart.
        model = triangulate(model, matched, images, work / "joined")

        def grown(start: Any) -> list[Any]:
            return reconstruct(matched, images, work / "joined_again", settings, progress, start=start)

        model, astray = placed_again(model, path, matched, grown)
        misplaced["astray"] = [*misplaced.get("astray", []), *astray]
        joined = [file for file in joined if file not in astray]
    tied = tie_boards(model, boards_in(model, sightings))
    _log.info("%d photos were joined; %d corners of boards tie all", len(joined), tied)
    apart = tuple(tuple(sorted(str(part.images[i].name) for i in part.reg_image_ids())) for part in left)
    named = {*joined, *(file for files in apart for file in files)}
    misplaced = {how: [file for file in files if file not in named] for how, files in misplaced.items()}
    return MappedWalk(model=model, misplaced=misplaced, joined=tuple(sorted(joined)), apart=apart)


def _beyond_the_tear(model: Any, walk: Walk, affected: Sequence[int], settings: PoseSettings) -> Any:
    """The model without the photos that are looked at again, whose features are others now; None where little is left.

    Mapped from nothing, a walk with many features in one place and few in another may begin where it is worst.
    """
    if model is None:
        return None
    start = deepcopy(model)
    again = {walk.files[rank] for rank in affected}
    drop(start, [i for i in start.reg_image_ids() if start.images[i].name in again])
    start.tear_down()
    enough = start.num_reg_images() >= max(settings.min_registered, _LEAST_START * len(walk.files))
    return start if enough else None


def tells_focal_length(model: Any) -> bool:
    """Whether the photos of a model look in so many directions that its focal length is known."""
    ahead = np.array([model.images[i].cam_from_world().rotation.matrix()[2] for i in model.reg_image_ids()])
    return bool(np.degrees(np.arccos(np.clip((ahead @ ahead.T).min(), -1.0, 1.0))) >= _LEAST_TURN_DEG)


def _alone(model: Any, database: Path, walk: Walk, work: Path, settings: PoseSettings, progress: Progress) -> list[Any]:
    """The parts that the photos without a place make among themselves, without those that contradict them.

    They are mapped with the calibration of the model, if that turns enough to know it: a part in which all look forward
    does not tell its focal length, and goes astray with a wrong one.
    """
    files = [file for file, has in zip(walk.files, walk.has_place(model), strict=True) if not has]
    if len(files) < settings.min_registered:
        return []
    cameras = sorted({model.images[i].camera_id for i in model.reg_image_ids()}) if tells_focal_length(model) else []
    calibrated = with_calibration(database, [model.cameras[i] for i in cameras], work / "alone.db")

    def mapped(start: Any = None) -> list[Any]:
        folder = work / "alone"
        return reconstruct(
            calibrated, work / "images", folder, settings, progress, start=start, only=files, known_cameras=cameras
        )

    neighbours = settings.pairs.overlap if len(walk.files) > settings.pairs.exhaustive_up_to else 0
    parts = [repair_part(part, database, neighbours, settings.min_registered, mapped) for part in mapped()]
    return [part for part in parts if part.num_reg_images() >= settings.min_registered]

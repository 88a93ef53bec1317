"""Structure from motion of a walk: cheap first, thorough where it tore, parts joined, boards as ties."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fsinfer.errors import PosesError
from fsinfer.io.photo_size import PHOTO_SIZE_PX
from fsinfer.poses.boards import BoardSighting, boards_in, find_boards, tie_boards
from fsinfer.poses.colmap import extract_features, reconstruct, triangulate, with_calibration
from fsinfer.poses.joining.parts import join_parts
from fsinfer.poses.matches import is_walk, match_features
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.sure_pairs import SurePairs, map_sure, put_back, sure_pairs, with_more
from fsinfer.poses.thorough import rematch, seams, torn
from fsinfer.poses.verification.misplaced import drop
from fsinfer.poses.verification.repair import placed_again, repair, repair_part
from fsinfer.progress import Progress
from fsinfer.threads import beside

_log = logging.getLogger(__name__)

#: Longer side at which boards are looked for, pixels. Source: judgement; more than features need, so that a board is
#: found from farther away.
_BOARD_SIZE_PX = PHOTO_SIZE_PX
#: Share of the photos that must be left to go on from. Source: judgement.
_LEAST_START = 0.25
#: Photos that look in directions so far apart tell the focal length. Source: judgement; a wrong one bends a walk that
#: turns by so much visibly, and one straight ahead not at all.
_LEAST_TURN_DEG = 60.0

#: So many boards tell a part's place beyond doubt. Source: judgement; what matches alone tell may be look-alikes.
_SURE_BOARDS = 2

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
    sightings: of boards in the photos; None where they were not looked for at full size.
    """

    model: Any
    misplaced: dict[str, list[str]]
    joined: tuple[str, ...] = ()
    apart: tuple[tuple[str, ...], ...] = field(default=())
    sightings: tuple[BoardSighting, ...] | None = None


@dataclass(frozen=True, kw_only=True)
class _Placed:
    """A look at the walk: its model, the matches it was made of, and what was taken out of it, joined to it, or not."""

    model: Any
    matched: Path
    misplaced: dict[str, list[str]]
    joined: tuple[str, ...] = ()
    apart: tuple[Any, ...] = ()


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
    sure, models, sightings = _map_and_find_boards(database, walk, work, settings, progress)
    more = with_more(models[0], sure, database, walk.files, work, settings) if models else None
    if more is not None:
        again = map_sure(more, images, work / "more", settings, progress)
        if again and again[0].num_reg_images() >= models[0].num_reg_images():
            sure, models = more, again
    most = models[0].num_reg_images() if models else 0
    placed = _repaired(models, sure, database, walk, work, settings, progress, sightings)
    if placed is not None:
        # Where boards tell its place, what stands apart need not be looked at again.
        placed = _with_parts(placed, models[1:], walk, work, settings, progress, sightings, least_boards=_SURE_BOARDS)
    has_place = [False] * len(walk.files) if placed is None else walk.has_place(placed.model)
    if torn(has_place, settings):
        richer = rematch(database, images, walk.cameras, walk.files, has_place, settings, progress)
        affected = seams(has_place, settings.thorough.beside)
        start = None if placed is None else _beyond_the_tear(placed.model, walk, affected, settings)
        sure = sure_pairs(richer, walk.files, work, settings, progress)
        again = map_sure(sure, images, work / "thorough", settings, progress, start=start)
        better = None
        if again and again[0].num_reg_images() >= sum(has_place):
            better = _repaired(again, sure, richer, walk, work, settings, progress, sightings)
        if better is not None and sum(walk.has_place(better.model)) > sum(has_place):
            _log.info("thorough: %d instead of %d photos", better.model.num_reg_images(), sum(has_place))
            # The global mapper begins anew.
            went_on = placed is not None and start is not None and settings.mapper == "incremental"
            joined = placed.joined if placed is not None and went_on else ()
            placed, models = replace(better, joined=joined), again
        most = max(most, again[0].num_reg_images() if again else 0)
    if placed is None:
        found = "no two photos" if most == 0 else f"only {most} photos"
        msg = f"{found} of the {len(walk.files)} in {given} could be placed together: {ADVICE}"
        raise PosesError(msg)
    model = placed.model
    if model.num_reg_images() < settings.min_registered:
        msg = f"the {len(walk.files)} photos in {given} match in ways that contradict each other: {ADVICE}"
        raise PosesError(msg)
    placed = _with_parts(placed, models[1:], walk, work, settings, progress, sightings)
    model = placed.model
    tied = tie_boards(model, boards_in(model, sightings))
    in_model = {file for file, has in zip(walk.files, walk.has_place(model), strict=True) if has}
    joined = tuple(sorted(set(placed.joined) & in_model))
    _log.info("%d photos were joined; %d corners of boards tie all", len(joined), tied)
    apart = tuple(tuple(sorted(str(part.images[i].name) for i in part.reg_image_ids())) for part in placed.apart)
    named = {*joined, *(file for files in apart for file in files)}
    misplaced = {how: [file for file in files if file not in named] for how, files in placed.misplaced.items()}
    # Larger photos were made smaller for it.
    seen = tuple(sightings) if settings.longest_px <= _BOARD_SIZE_PX else None
    return MappedWalk(model=model, misplaced=misplaced, joined=joined, apart=apart, sightings=seen)


def _map_and_find_boards(
    database: Path, walk: Walk, work: Path, settings: PoseSettings, progress: Progress
) -> tuple[SurePairs, list[Any], list[BoardSighting]]:
    """The first map's pairs and models, the largest first, and the boards that the photos show."""
    images = work / "images"

    def look_for_boards(told: Progress, threads: int) -> list[BoardSighting]:
        return find_boards(
            images,
            walk.files,
            dictionary=settings.dictionary,
            longest_px=_BOARD_SIZE_PX,
            progress=told,
            threads=threads,
        )

    def chosen() -> SurePairs:
        return sure_pairs(database, walk.files, work, settings, progress)

    def mapped(sure: SurePairs) -> list[Any]:
        return map_sure(sure, images, work / "models", settings, progress)

    if settings.mapper != "incremental" or settings.photo_threads == 1:
        sure = chosen()
        sightings = look_for_boards(progress, settings.photo_threads)
        return sure, mapped(sure), sightings

    def quietly(go_on: Callable[[], None]) -> list[BoardSighting]:
        return look_for_boards(lambda _done, _total, _what: go_on(), settings.photo_threads - 1)

    # The incremental mapper, which follows the walk, has one thread and lets others work; adjustments do not.
    with beside(quietly) as boards:
        sure = chosen()
        models = mapped(sure)
        return sure, models, boards()


def _repaired(
    models: Sequence[Any],
    sure: SurePairs,
    database: Path,
    walk: Walk,
    work: Path,
    settings: PoseSettings,
    progress: Progress,
    sightings: Sequence[BoardSighting],
) -> _Placed | None:
    """The largest of the models without what is wrong in it, with the pairs that were left out; None where none is."""
    if not models or models[0].num_reg_images() < settings.min_registered:
        return None
    model, misplaced = repair(models[0], sure.matched, walk.files, work, settings, progress, sightings=sightings)
    put_back(model, sure.left_out, database, work)
    return _Placed(model=model, matched=sure.matched, misplaced=misplaced)


def _with_parts(
    placed: _Placed,
    others: Sequence[Any],
    walk: Walk,
    work: Path,
    settings: PoseSettings,
    progress: Progress,
    sightings: Sequence[BoardSighting],
    *,
    least_boards: int = 0,
) -> _Placed:
    """With the parts that the photos without a place make among themselves, as far as something tells where they lie.

    Parameters
    ----------
    others: what the global mapper made beside the model. least_boards: that must tell where a part lies.
    """
    model, matched, images = placed.model, placed.matched, work / "images"
    if (
        model.num_reg_images() < settings.min_registered
        or len({sighting.number for sighting in sightings}) < least_boards
    ):
        return placed
    # What was taken out as misplaced hangs together, too: mapped alone, nothing false pulls at it.
    if settings.mapper == "incremental":
        parts = _alone(model, matched, walk, work, settings, progress)
    else:
        had = set(model.reg_image_ids())
        parts = [part for part in others if len(set(part.reg_image_ids()) - had) >= settings.min_registered]
    if not parts:
        return replace(placed, apart=())
    path = walk.files if is_walk(matched, walk.files, settings) else ()
    joined, left = join_parts(model, parts, sightings, database=matched, walk=path, least_boards=least_boards)
    misplaced = placed.misplaced
    if joined:
        # What both parts see of the wood was never compared while they stood apart.
        model = triangulate(model, matched, images, work / "joined")

        def grown(start: Any) -> list[Any]:
            return reconstruct(matched, images, work / "joined_again", settings, progress, start=start)

        model, astray = placed_again(model, path, matched, grown)
        misplaced = misplaced | {"astray": [*misplaced.get("astray", []), *astray]}
        joined = [file for file in joined if file not in astray]
    return replace(placed, model=model, misplaced=misplaced, joined=(*placed.joined, *joined), apart=tuple(left))


def _beyond_the_tear(model: Any, walk: Walk, affected: Sequence[int], settings: PoseSettings) -> Any:
    """The model without the photos that are looked at again, whose features are others now; None where little is left.

    Mapped from nothing, a walk with many features in one place and few in another may begin where it is worst.
    """
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

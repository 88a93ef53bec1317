"""Few small photos are looked at as they are, and doubled only where not all have a place then."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fsinfer.io.images import write_image
from fsinfer.poses.colmap import reconstruct
from fsinfer.poses.estimate import estimate_poses
from fsinfer.poses.pairs import PairSettings
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.thorough import worth_a_glance
from fsinfer.progress import silent
from tests.support.rendered_room import photographs

pycolmap = pytest.importorskip("pycolmap")

SETTINGS = PoseSettings(threads=1, max_features=1500)
#: First octave of COLMAP's SIFT: photos as they are, and doubled.
PLAIN, DOUBLED = 0, -1


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("room")
    for index, image in enumerate(photographs()[:6]):
        write_image(folder / f"{index}.png", image)
    return folder


@pytest.fixture
def octaves(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The first octave of every search for features."""
    searched: list[int] = []
    search = pycolmap.extract_features

    def recorded(*arguments: Any, extraction_options: Any, **options: Any) -> Any:
        searched.append(int(extraction_options.sift.first_octave))
        return search(*arguments, extraction_options=extraction_options, **options)

    monkeypatch.setattr(pycolmap, "extract_features", recorded)
    return searched


def test_photos_that_hold_together_as_they_are_are_not_doubled(room: Path, tmp_path: Path, octaves: list[int]) -> None:
    result = estimate_poses(room, tmp_path / "scene", settings=SETTINGS)
    assert result.registered == 6
    assert set(octaves) == {PLAIN}


def test_photos_are_doubled_where_one_has_no_place_as_they_are(
    room: Path, tmp_path: Path, octaves: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def all_but_one(database: Path, *arguments: Any, **options: Any) -> list[Any]:
        models = reconstruct(database, *arguments, **options)
        if octaves == [PLAIN]:
            model = models[0]
            model.deregister_frame(model.images[max(model.reg_image_ids())].frame_id)
        return models

    monkeypatch.setattr("fsinfer.poses.mapping.reconstruct", all_but_one)
    result = estimate_poses(room, tmp_path / "scene", settings=SETTINGS)
    assert result.registered == 6
    assert octaves == [PLAIN, DOUBLED]


@pytest.mark.parametrize(
    ("below_px", "exhaustive", "worth"),
    [(1000, 60, True), (100, 60, False), (0, 60, False), (1000, 5, False), (1000, 6, True)],
)
def test_many_photos_and_large_ones_are_looked_at_once(
    room: Path, tmp_path: Path, octaves: list[int], below_px: int, exhaustive: int, worth: bool
) -> None:
    settings = PoseSettings(
        threads=1, max_features=1500, double_below_px=below_px, pairs=PairSettings(exhaustive_up_to=exhaustive)
    )
    assert worth_a_glance(room, [f"{i}.png" for i in range(6)], settings) is worth
    estimate_poses(room, tmp_path / "scene", settings=settings, progress=silent)
    assert octaves[0] == (PLAIN if worth or below_px < 1000 else DOUBLED)

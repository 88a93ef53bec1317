"""What the poses stage told of the markers is not looked for again, and is right where it is used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsinfer.scale import marker_search
from fsinfer.scale.aruco import scale_from_aruco
from fsinfer.scale.marker_search import look_for_markers
from fsinfer.scale.markers_seen import FILE, UNSEEN, MarkersSeen, read_markers_seen, write_markers_seen
from fsinfer.scale.square_fit import MarkerSettings
from fsinfer.scene import Scene, View, read_view_image
from tests.fsinfer.scale.test_aruco import NUMBERS, SIDE, make_scene


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return make_scene(tmp_path, dict(enumerate(NUMBERS)))


def as_found(scene: Scene, off_px: float = 0.0) -> MarkersSeen:
    """What a search finds, so far off."""
    rng = np.random.default_rng(3)
    places: dict[str, Any] = {view.name: () for view in scene.views}
    for one in look_for_markers(scene).sightings:
        corners = one.corners_px + rng.uniform(-off_px, off_px, (4, 2))
        places[scene.views[one.view].name] += ((one.marker_id, corners),)
    return MarkersSeen(dictionary="4X4_50", min_side_px=12.0, places=places)


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The views whose images are read from now on."""
    read: list[str] = []

    def noted(view: View) -> Any:
        read.append(view.name)
        return read_view_image(view)

    monkeypatch.setattr(marker_search, "read_view_image", noted)
    return read


def test_written_and_read_again(scene: Scene) -> None:
    seen = as_found(scene)
    assert read_markers_seen(scene) is UNSEEN
    write_markers_seen(scene.folder, seen)
    read = read_markers_seen(scene)
    assert (read.dictionary, read.min_side_px) == ("4X4_50", 12.0)
    assert read.places.keys() == seen.places.keys()
    for name, places in seen.places.items():
        assert [number for number, _ in read.places[name]] == [number for number, _ in places]
        for (_, one), (_, other) in zip(read.places[name], places, strict=True):
            np.testing.assert_allclose(one, other, atol=0.006)


def test_corners_are_found_from_places_a_pixel_off_without_a_search(
    scene: Scene, searched: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    looked = look_for_markers(scene)
    write_markers_seen(scene.folder, as_found(scene, off_px=0.8))
    monkeypatch.setattr(marker_search, "detect_markers", None)  # cannot be called
    told = look_for_markers(scene)
    named = [[(one.marker_id, one.view) for one in found.sightings] for found in (told, looked)]
    assert named[0] == named[1]
    for one, other in zip(told.sightings, looked.sightings, strict=True):
        np.testing.assert_allclose(one.corners_px, other.corners_px, atol=0.1)
    assert searched  # its corners were looked for in the images
    scale = scale_from_aruco(scene, 0.25)
    assert scale.m_per_unit == pytest.approx(0.25 / SIDE, rel=0.0025)


def test_views_without_markers_are_not_read_and_views_that_nobody_looked_at_are_searched(
    scene: Scene, searched: list[str]
) -> None:
    seen = as_found(scene)
    first, second, *_ = (view.name for view in scene.views)
    found = {(one.marker_id, one.view) for one in look_for_markers(scene).sightings}
    searched.clear()
    write_markers_seen(scene.folder, replace(seen, places={**seen.places, first: ()}))
    assert {(one.marker_id, one.view) for one in look_for_markers(scene).sightings} == {
        (number, view) for number, view in found if view != 0
    }
    assert sorted(searched) == sorted(view.name for view in scene.views[1:])
    write_markers_seen(
        scene.folder, replace(seen, places={name: places for name, places in seen.places.items() if name != second})
    )
    assert {(one.marker_id, one.view) for one in look_for_markers(scene).sightings} == found


def test_another_dictionary_and_smaller_markers_are_looked_for(scene: Scene) -> None:
    empty = MarkersSeen(dictionary="4X4_50", min_side_px=12.0, places={view.name: () for view in scene.views})
    write_markers_seen(scene.folder, empty)
    assert not look_for_markers(scene).sightings
    assert not look_for_markers(scene, dictionary="4x4_50", settings=MarkerSettings(min_side_px=20.0)).sightings
    assert look_for_markers(scene, settings=MarkerSettings(min_side_px=8.0)).sightings
    assert look_for_markers(scene, dictionary="4X4_100").sightings
    write_markers_seen(scene.folder, replace(empty, dictionary="5X5_50"))
    assert look_for_markers(scene).sightings


@pytest.mark.parametrize(
    "damage",
    [
        "",
        "[]",
        '{"dictionary": "4X4_50"}',
        '{"dictionary": "4X4_50", "min_side_px": "wide", "views": {}}',
        '{"dictionary": "4X4_50", "min_side_px": 12, "views": []}',
        '{"dictionary": "4X4_50", "min_side_px": 12, "views": {"v0": [{"number": 1}]}}',
        '{"dictionary": "4X4_50", "min_side_px": 12, "views": {"v0": [{"number": 1, "corners_px": [[1, 2]]}]}}',
        '{"dictionary": "4X4_50", "min_side_px": 12, "views": {"v0": [{"number": 1e999, "corners_px": []}]}}',
        '{"dictionary": "4X4_50", "min_side_px": 12, "views": {"v0": [{"number": 1, "corners_px": '
        "[[1e999, 2], [2, 2], [2, 3], [1, 3]]}]}}",
    ],
)
def test_a_damaged_file_is_as_none(scene: Scene, damage: str) -> None:
    (scene.folder / FILE).write_text(damage, encoding="utf-8")
    assert read_markers_seen(scene) is UNSEEN
    assert look_for_markers(scene).sightings

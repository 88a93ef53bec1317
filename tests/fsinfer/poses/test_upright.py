"""Features that keep the pictures' own up, where the photos of a walk match as well so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import fsinfer.poses.upright as module
from fsinfer.io.images import write_image
from fsinfer.poses.colmap import extract_features
from fsinfer.poses.colmap_calls import open_database
from fsinfer.poses.pairs import PairSettings
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.upright import as_the_photos_stand, matches_as_well
from fsinfer.progress import silent

pytest.importorskip("pycolmap")

#: Ten photos are a long walk.
SETTINGS = PoseSettings(double_below_px=0, max_features=800, upright_pairs=3, pairs=PairSettings(exhaustive_up_to=6))
SIDE_PX, PHOTOS = 320, 10


def walk(folder: Path, *, turned: bool) -> list[str]:
    """Photos along a rough wall, each a little farther on; every second one turned by 90 degrees, or none."""
    rng = np.random.default_rng(4)
    layers = [rng.normal(0, 1, (SIDE_PX // size + 2, 800 // size + 2)).astype(np.float32) for size in (3, 8, 20)]
    wall = sum(cv2.resize(layer, (800, SIDE_PX), interpolation=cv2.INTER_CUBIC) for layer in layers)
    grey = np.clip(128 + 40 * np.asarray(wall), 0, 255).astype(np.uint8)
    folder.mkdir()
    names = []
    for rank in range(PHOTOS):
        photo = grey[:, 40 * rank : 40 * rank + SIDE_PX]
        photo = np.rot90(photo) if turned and rank % 2 else photo
        names.append(f"{rank:05d}.png")
        write_image(folder / names[-1], np.ascontiguousarray(np.repeat(photo[:, :, None], 3, axis=2)))
    return names


@pytest.mark.parametrize("turned", [False, True])
def test_photos_turned_against_each_other_have_turned_features(turned: bool, tmp_path: Path) -> None:
    files = walk(tmp_path / "photos", turned=turned)
    work = tmp_path / "work"
    work.mkdir()
    found = as_the_photos_stand(SETTINGS, tmp_path / "photos", files, work, silent)
    assert found == replace(SETTINGS, upright=not turned)
    told = json.loads((work / "upright.json").read_text(encoding="utf-8"))
    assert min(told["turned"]) > 50
    assert (max(told["kept"]) < 15) == turned


def test_the_answer_is_asked_for_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = walk(tmp_path / "photos", turned=False)
    as_the_photos_stand(SETTINGS, tmp_path / "photos", files, tmp_path, silent)

    def never(*_arguments: object) -> None:
        raise AssertionError

    monkeypatch.setattr(module, "extract_features", never)
    assert as_the_photos_stand(SETTINGS, tmp_path / "photos", files, tmp_path, silent).upright


@pytest.mark.parametrize(
    "settings",
    [
        replace(SETTINGS, pairs=PairSettings(exhaustive_up_to=PHOTOS)),
        replace(SETTINGS, upright_pairs=0),
        replace(SETTINGS, upright=True),
    ],
)
def test_few_photos_are_not_asked_and_a_given_answer_stands(settings: PoseSettings, tmp_path: Path) -> None:
    files = [f"{rank}.png" for rank in range(PHOTOS)]
    assert as_the_photos_stand(settings, tmp_path, files, tmp_path, silent) == settings
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("turned", "kept", "expected"),
    [
        ([1000, 800, 600], [950, 820, 590], True),
        ([1000, 800, 600], [1000, 800, 350], False),  # one pair loses two fifths
        ([1000, 800, 600], [800, 640, 480], False),  # each a fifth
        ([1000, 800, 600], [850, 680, 510], True),
        ([1000, 5, 0], [1000, 5, 0], False),  # one pair tells too little
        ([1000, 900, 0], [1000, 900, 14], True),
        ([0, 0, 0], [0, 0, 0], False),
    ],
)
def test_it_is_told_by_what_pairs_lose(turned: list[int], kept: list[int], expected: bool) -> None:
    assert matches_as_well(turned, kept) == expected


def test_upright_features_are_not_turned(tmp_path: Path) -> None:
    """Of one place there is one feature then."""
    files = walk(tmp_path / "photos", turned=False)[:1]
    most = []
    for upright in (False, True):
        database = tmp_path / f"{upright}.db"
        extract_features(database, tmp_path / "photos", {"camera": files}, replace(SETTINGS, upright=upright), silent)
        with open_database(database) as opened:
            places = np.asarray(opened.read_keypoints(1))[:, :3]
        most.append(np.unique(places[:, :2], axis=0, return_counts=True)[1].max())
    assert most[0] > 1
    assert most[1] == 1

"""How well cameras are known: as well as they come out when the same walk is observed again and again."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsinfer.errors import SceneError
from fsinfer.poses.adjustment.fit import columns_of, fit
from fsinfer.poses.adjustment.last_fit import like
from fsinfer.poses.adjustment.precision import CameraPrecision, camera_precisions, read_camera_precisions
from fsinfer.poses.adjustment.problem import Group
from fsinfer.poses.adjustment.reduced_system import Structure
from tests.fsinfer.poses.adjustment.test_fit import weighting
from tests.support.phone_walk import PHONE, phone_walk

PHOTOS, DRAWS, NOISE_PX = 8, 48, 0.2


@pytest.mark.parametrize("groups", [(), (Group.turn, Group.focal)], ids=["poses", "with each photo's own"])
def test_told_spread_is_that_of_repeated_walks(groups: tuple[Group, ...]) -> None:
    effects = PHONE * [1, 0, 0, 1, 1, 1, 0, 0, 0] if groups else None
    exact, truth = phone_walk(photos=PHOTOS, points=400, effects=effects, noise_px=0.0)
    structure = Structure(exact, len(truth.points))
    weights = replace(weighting(PHOTOS), noise_px=NOISE_PX)
    rng = np.random.default_rng(5)
    centers, told = [], np.zeros(PHOTOS)
    for _ in range(DRAWS):
        structure.seen = replace(exact, xy=exact.xy + rng.normal(0, NOISE_PX, exact.xy.shape))
        found = fit(structure, truth, groups, weights)
        # Eight photos are each other's neighbours: one frame for all.
        centers.append(like(found, truth).centers)
        told += [precision.center_std for precision in camera_precisions(structure, found, groups, weights)]
    spread = np.sqrt(((np.array(centers) - truth.centers) ** 2).mean(axis=(0, 2)))
    np.testing.assert_allclose((told / DRAWS).mean(), spread.mean(), rtol=0.25)
    # Of those at the ends less is known, and it is told.
    assert np.corrcoef(told, spread)[0, 1] > 0.8


@pytest.mark.parametrize(("groups", "most"), [((Group.turn, Group.focal), 2.3), ((), 3.2)])
def test_the_matrix_of_many_photos_is_held_twice_and_not_five_times(groups: tuple[Group, ...], most: float) -> None:
    """Of 300 photographs it takes 160 MB. Without unknowns of each photo's own the poses' inverse is as large."""
    photos = 120
    seen, truth = phone_walk(photos=photos, points=300, effects=None, noise_px=0.2)
    structure = Structure(seen, len(truth.points))
    tracemalloc.start()
    try:
        camera_precisions(structure, truth, groups, weighting(photos))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < most * 8 * (photos * (6 + len(columns_of(groups)))) ** 2


def test_precisions_are_read_from_the_scene(tmp_path: Path) -> None:
    assert read_camera_precisions(tmp_path) == {}
    path = tmp_path / "poses.json"
    path.write_text(json.dumps({"camera_std": {"a": {"center": 0.01, "direction_rad": 0.002}}}), encoding="utf-8")
    assert read_camera_precisions(tmp_path) == {"a": CameraPrecision(center_std=0.01, direction_std_rad=0.002)}
    path.write_text('{"camera_std": {"a": {}}}', encoding="utf-8")
    with pytest.raises(SceneError, match="damaged"):
        read_camera_precisions(tmp_path)

"""Clouds that lie on their side or their head are set up and measured, and the result says so."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentences
from fsinfer.notices.stems import StemCode
from fsinfer.scale.request import ScaleRequest
from fsinfer.trees import analyse_plot
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.sanity import TURNS, SanitySettings, TurnedCloudError, thicker_upwards, thin_upwards
from fsinfer.workflow.measure_cloud import measure_cloud_file
from tests.support.stem_clouds import stem_plot, wall


@pytest.mark.parametrize(("how", "turn"), TURNS, ids=[how for how, _ in TURNS])
def test_a_cloud_that_does_not_stand_upright_is_turned(tmp_path: Path, how: str, turn: NDArray[np.float64]) -> None:
    plot = stem_plot(seed=1, trees=4, spacing_m=0.02, top_m=3.5)
    # turn @ lying = upright, so the plot lies as turn.T leaves it.
    write_cloud(tmp_path / "cloud.ply", PointCloud(xyz=plot.points @ turn))
    values = measure_cloud_file(tmp_path / "cloud.ply", tmp_path / "out", request=ScaleRequest())
    assert any(how in text and "turned" in text for text in sentences(values.result.trees.warnings))
    trees = read_trees(tmp_path / "out" / "trees.csv")
    assert len(trees) == 4
    for xy, dbh in zip(plot.xy, plot.dbh_cm, strict=True):
        tree = min(trees, key=lambda tree: np.hypot(tree.x_m - xy[0], tree.y_m - xy[1]))
        np.testing.assert_allclose([tree.x_m, tree.y_m], xy, atol=0.02)
        assert tree.dbh_cm == pytest.approx(dbh, abs=0.5)
    labelled = read_cloud(tmp_path / "out" / "trees.laz")
    np.testing.assert_allclose(labelled.xyz[:, 2].max(), plot.points[:, 2].max(), atol=1e-3)


def test_a_cloud_that_stands_upright_is_left_alone(tmp_path: Path) -> None:
    plot = stem_plot(seed=1, trees=4, spacing_m=0.02, top_m=3.5)
    write_cloud(tmp_path / "cloud.ply", PointCloud(xyz=plot.points))
    values = measure_cloud_file(tmp_path / "cloud.ply", tmp_path / "out", request=ScaleRequest())
    assert values.result.trees.trees == 4
    assert StemCode.turned not in [item.code for item in values.result.trees.warnings]


def cut_in_the_crowns(ground_per_m2: float) -> NDArray[np.float64]:
    """Nine pines of 30 cm, cut off level at 6 m, where their crowns close; ground with few points."""
    rng = np.random.default_rng(3)
    count = int(100 * ground_per_m2)
    parts = [np.column_stack([rng.uniform(-5, 5, (count, 2)), rng.normal(0, 0.01, count)])]
    for x, y in product((-3.0, 0.0, 3.0), repeat=2):
        z = rng.uniform(0.0, 6.0, 9000)
        angle, radius = rng.uniform(0, 2 * np.pi, len(z)), 0.15 - 0.005 * (z - 1.3) + rng.normal(0, 0.003, len(z))
        parts.append(np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle), z]))
        crown = rng.normal((x, y), 0.9, (40_000, 2))
        parts.append(np.column_stack([crown, rng.uniform(4.0, 6.0, len(crown))]))
    return np.concatenate(parts)


def test_a_cloud_cut_off_in_the_crowns_above_thin_ground_is_left_alone() -> None:
    found = analyse_plot(cut_in_the_crowns(8.0))
    assert [tree.dbh_cm for tree in found.trees] == pytest.approx([30.0] * 9, abs=0.6)
    codes = {told.code for told in found.warnings}
    assert StemCode.level_top in codes
    assert StemCode.thicker_upwards not in codes


def test_pillars_between_a_floor_and_a_ceiling_alike_are_not_set_up_by_a_guess() -> None:
    rng = np.random.default_rng(2)
    corners = np.array([[x, y, 0.0] for x, y in product((-1.5, 1.5), repeat=2)])
    pillars = [wall(rng, radius=0.15, spacing_m=0.02, taper=0.0, top_m=3.5) + corner for corner in corners]
    level = np.column_stack([rng.uniform(-3.0, 3.0, (15_000, 2)), np.repeat([0.0, 3.5], 7_500)])
    hall = np.concatenate([level, *pillars])
    lying = (hall + rng.normal(0.0, 0.003, hall.shape)) @ TURNS[0][1]
    with pytest.raises(CloudError, match=r"y points (up|down) or y points (up|down)") as told:
        analyse_plot(lying)
    assert not isinstance(told.value, TurnedCloudError)
    # Without the ceiling it is plain.
    with pytest.raises(TurnedCloudError, match="y points up"):
        analyse_plot(lying[lying[:, 1] < 3.4])


def test_a_cloud_without_a_scale_is_asked_which_way_up_it_stands() -> None:
    plot = stem_plot(seed=1, trees=4, spacing_m=0.02, top_m=3.5)
    with pytest.raises(TurnedCloudError, match="z points down"):
        analyse_plot(plot.points * [1.0, -1.0, -1.0], metric=False)
    assert len(analyse_plot(plot.points, metric=False).trees) == 4
    # Cameras have told.
    assert analyse_plot(plot.points * [1.0, -1.0, -1.0], metric=False, turned=True).units_per_m == 1.0


def test_stems_that_all_grow_thicker_upwards_are_told_of() -> None:
    found = analyse_plot(cut_in_the_crowns(8.0) * [1.0, -1.0, -1.0])
    assert notice(StemCode.thicker_upwards, stems=len(found.trees)) in found.warnings


@pytest.mark.parametrize(
    ("tapers", "feet", "head"),
    [
        ([-0.01, -0.01], True, False),
        ([-0.01], False, False),
        ([], False, False),
        ([-0.01, 0.01, -0.01], False, False),
        ([-0.01] * 7 + [0.01] * 3, True, False),
        ([0.01] * 3, False, False),
        ([0.01] * 4 + [-0.01], False, True),
    ],
)
def test_what_tapers_tell_of_feet_and_head(tapers: list[float], feet: bool, head: bool) -> None:
    assert thin_upwards(tapers, SanitySettings()) is feet
    assert thicker_upwards(tapers, SanitySettings()) is head

"""Clouds that lie on their side or their head are set up and measured, and the result says so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.notices.sentences import sentences
from fsinfer.notices.stems import StemCode
from fsinfer.scale.request import ScaleRequest
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.sanity import TURNS
from fsinfer.workflow.measure_cloud import measure_cloud_file
from tests.support.stem_clouds import stem_plot


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

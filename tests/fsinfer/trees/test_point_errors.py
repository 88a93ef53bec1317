"""Clouds that tell how sure their points are: the surface seen from near counts, the haze about it hardly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.io.cloud import DEPTH_STD, PIXEL_SIZE, PointCloud
from fsinfer.trees import PlotResult, TreeSettings, analyse_plot
from fsinfer.trees.edit_rows import TreeEdit
from fsinfer.trees.edits import apply_edits
from fsinfer.trees.outputs.table import read_trees
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.stem_curve import stem_curves
from fsinfer.trees.tree import Tree
from fsinfer.workflow.tree_stage import PlotCloudInput, measure_plot
from tests.support.stem_clouds import StemPlot, stem_plot

TAPER = -0.005


@dataclass(frozen=True)
class HazyPlot:
    """Stems twice as often from far as from near; ``told`` says which points are which."""

    plot: StemPlot
    points: NDArray[np.float64]
    std_m: NDArray[np.float64]
    normals: NDArray[np.float64]

    @property
    def told(self) -> PointErrors:
        """What the cloud tells."""
        return PointErrors(std_m=self.std_m, normals=self.normals)

    def errors_cm(self, trees: tuple[Tree, ...]) -> NDArray[np.float64]:
        """Of the diameters of those that have one."""
        measured = [tree for tree in trees if tree.dbh_cm is not None]
        nearest = [self.plot.stem_at(tree.x_m, tree.y_m) for tree in measured]
        return np.array([tree.dbh_cm for tree in measured], dtype=np.float64) - self.plot.dbh_cm[nearest]


@pytest.fixture(scope="module")
def hazy() -> HazyPlot:
    plot = stem_plot(trees=4, seed=8, slope=0.05, lean_deg=2.0, spacing_m=0.014)
    rng = np.random.default_rng(1)
    nearest = np.argmin(np.linalg.norm(plot.points[:, None, :2] - plot.xy[None], axis=2), axis=1)
    outward = plot.points[:, :2] - plot.xy[nearest]
    distance = np.linalg.norm(outward, axis=1)
    on_stem = (distance < 0.35) & (plot.points[:, 2] > plot.z_ground[nearest] + 0.3)
    away = outward[on_stem] / distance[on_stem, None]
    far = np.repeat(plot.points[on_stem], 2, axis=0)
    far[:, :2] += np.repeat(away, 2, axis=0) * rng.normal(0.012, 0.015, (len(far), 1))
    std_m = np.r_[np.full(len(plot.points), 0.001), np.full(len(far), 0.02)]
    normals = np.zeros((len(plot.points), 3))
    normals[:, 2] = 1.0
    normals[on_stem] = np.column_stack([away, np.zeros(len(away))])
    normals = np.concatenate([normals, np.repeat(normals[on_stem], 2, axis=0)])
    return HazyPlot(plot, np.concatenate([plot.points, far]), std_m, normals)


@pytest.fixture(scope="module")
def told(hazy: HazyPlot) -> PlotResult:
    return analyse_plot(hazy.points, errors=hazy.told)


@pytest.fixture(scope="module")
def untold(hazy: HazyPlot) -> PlotResult:
    return analyse_plot(hazy.points)


def test_diameters_are_those_of_the_surface(hazy: HazyPlot, told: PlotResult, untold: PlotResult) -> None:
    assert len(told.trees) == 4
    error, without = hazy.errors_cm(told.trees), hazy.errors_cm(untold.trees)
    assert len(error) == 4
    assert np.abs(error).max() < 0.3
    assert np.median(np.abs(without)) > 3.0 * np.median(np.abs(error))


@pytest.mark.parametrize("place", [np.nan, 1e308, 5000.0], ids=["no number", "too large", "far away"])
def test_points_that_are_dropped_take_their_errors_along(hazy: HazyPlot, told: PlotResult, place: float) -> None:
    broken = np.insert(hazy.points, [0, 500, 9000], place, axis=0)
    std_m = np.insert(hazy.std_m, [0, 500, 9000], 5.0)
    normals = np.insert(hazy.normals, [0, 500, 9000], 1.0, axis=0)
    again = analyse_plot(broken, errors=PointErrors(std_m=std_m, normals=normals))
    assert [tree.dbh_cm for tree in again.trees] == [tree.dbh_cm for tree in told.trees]


def test_curves_follow_the_surface_too(hazy: HazyPlot, told: PlotResult) -> None:
    def errors(of_points: PointErrors | None) -> NDArray[np.float64]:
        curves = stem_curves(hazy.points, told, errors=of_points)
        found = []
        for tree in told.trees:
            dbh_cm = hazy.plot.dbh_cm[hazy.plot.stem_at(tree.x_m, tree.y_m)]
            found += [
                p.diameter_cm - (dbh_cm + 200.0 * TAPER * (p.height_m - 1.3))
                for p in curves[tree.tree_id]
                if p.diameter_cm is not None and p.height_m >= 1.5
            ]
        return np.array(found)

    error, without = errors(hazy.told), errors(None)
    assert len(error) >= 16
    assert np.sqrt(np.mean(error**2)) < 0.3
    # All is haze where nobody tells.
    assert len(without) < 0.5 * len(error)


def test_a_tree_added_by_hand_is_measured_alike(hazy: HazyPlot, told: PlotResult) -> None:
    first = told.trees[0]
    without = replace(told, trees=told.trees[1:], sections=told.sections[1:])
    added = TreeEdit(action="add", x_m=first.x_m, y_m=first.y_m, row=2)
    result = apply_edits(without, hazy.points, [added], settings=TreeSettings(), errors=hazy.told)
    (tree,) = [tree for tree in result.trees if tree not in told.trees]
    assert tree.dbh_cm == pytest.approx(first.dbh_cm, abs=0.15)


def test_the_tree_stage_reads_it_from_the_cloud(hazy: HazyPlot, told: PlotResult, tmp_path: Path) -> None:
    std, normals = hazy.std_m.astype(np.float32), hazy.normals.astype(np.float32)
    cloud = PointCloud(xyz=hazy.points, normals=normals, extra={DEPTH_STD: std})
    measure_plot(PlotCloudInput(cloud=cloud, camera_height=1.5), tmp_path)
    error = hazy.errors_cm(tuple(read_trees(tmp_path / "trees.csv")))
    assert error == pytest.approx(hazy.errors_cm(told.trees), abs=0.02)
    # In model units nobody knows what it means; what is no number is no noise.
    assert PlotCloudInput(cloud=cloud, metric=False).errors is None
    assert PlotCloudInput(cloud=replace(cloud, normals=None)).errors is None
    assert PlotCloudInput(cloud=replace(cloud, extra={})).errors is None
    std[:3] = np.nan, -1.0, np.inf
    odd = PlotCloudInput(cloud=replace(cloud, extra={DEPTH_STD: std})).errors
    assert odd is not None
    assert odd.std_m[:3].tolist() == [0.0, 0.0, 0.0]
    assert odd.pixel_m is None
    pixel = std.copy()
    with_pixel = PlotCloudInput(cloud=replace(cloud, extra={DEPTH_STD: hazy.std_m, PIXEL_SIZE: pixel})).errors
    assert with_pixel is not None
    assert with_pixel.pixel_m is not None
    assert with_pixel.pixel_m.tolist() == [0.0, 0.0, 0.0, *pixel[3:].tolist()]
    chosen = np.arange(len(pixel)) % 5 == 4
    few = with_pixel.select(chosen).pixel_m
    assert few is not None
    assert few.tolist() == pixel[chosen].tolist()

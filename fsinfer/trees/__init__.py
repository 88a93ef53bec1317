"""Dendrometry: from a metric point cloud to stem positions and diameters."""

from fsinfer.trees.circle import CircleFit, CircleSettings, fit_circle
from fsinfer.trees.dbh import DbhSettings, Section
from fsinfer.trees.ground import Ground, GroundSettings, find_ground
from fsinfer.trees.measure import PlotResult, Tree, TreeSettings, analyse_plot, measure_trees
from fsinfer.trees.stems import StemSettings, find_stems

__all__ = [
    "CircleFit",
    "CircleSettings",
    "DbhSettings",
    "Ground",
    "GroundSettings",
    "PlotResult",
    "Section",
    "StemSettings",
    "Tree",
    "TreeSettings",
    "analyse_plot",
    "find_ground",
    "find_stems",
    "fit_circle",
    "measure_trees",
]

"""Dendrometry: from a metric point cloud to stem positions and diameters."""

from fsinfer.trees.diameter.circle import CircleFit, CircleSettings, fit_circle
from fsinfer.trees.diameter.dbh_settings import DbhSettings
from fsinfer.trees.diameter.section import Section
from fsinfer.trees.ground.ground import Ground, find_ground
from fsinfer.trees.ground.settings import GroundSettings
from fsinfer.trees.measure import PlotResult, analyse_plot, measure_trees
from fsinfer.trees.points.errors import PointErrors
from fsinfer.trees.search.find import find_stems
from fsinfer.trees.search.stem import StemSettings
from fsinfer.trees.settings import TreeSettings
from fsinfer.trees.stand import StandTable, stand_table
from fsinfer.trees.tree import Tree

__all__ = [
    "CircleFit",
    "CircleSettings",
    "DbhSettings",
    "Ground",
    "GroundSettings",
    "PlotResult",
    "PointErrors",
    "Section",
    "StandTable",
    "StemSettings",
    "Tree",
    "TreeSettings",
    "analyse_plot",
    "find_ground",
    "find_stems",
    "fit_circle",
    "measure_trees",
    "stand_table",
]

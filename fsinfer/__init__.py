"""Forest plots from photographs: dense metric point cloud, stem map and DBH with intervals, offline on a CPU.

The names below are loaded when they are first used, so that ``import fsinfer`` takes milliseconds:

>>> import fsinfer
>>> cloud = fsinfer.read_cloud("plot.laz")  # doctest: +SKIP
>>> trees = fsinfer.measure_trees(cloud.xyz)  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from fsinfer._version import __version__
from fsinfer.errors import FsinferError

if TYPE_CHECKING:
    from fsinfer.depth.model import DepthEstimate, DepthModel
    from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
    from fsinfer.trees import Tree, measure_trees

_HOME = {
    "DepthEstimate": "fsinfer.depth.model",
    "DepthModel": "fsinfer.depth.model",
    "PointCloud": "fsinfer.io.cloud",
    "Tree": "fsinfer.trees",
    "measure_trees": "fsinfer.trees",
    "read_cloud": "fsinfer.io.cloud",
    "write_cloud": "fsinfer.io.cloud",
}

__all__ = [
    "DepthEstimate",
    "DepthModel",
    "FsinferError",
    "PointCloud",
    "Tree",
    "__version__",
    "measure_trees",
    "read_cloud",
    "write_cloud",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
    elif name == "trees":
        # fsinfer.trees.fit_circle works without an import of its own.
        value = import_module("fsinfer.trees")
    else:
        msg = f"module 'fsinfer' has no attribute {name!r}"
        raise AttributeError(msg)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME, "trees"})

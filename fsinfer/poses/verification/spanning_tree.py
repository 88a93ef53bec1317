"""Parts into which photos fall where the strongest ties that hold them together are cut."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree


def tie_graph(one: NDArray[np.intp], other: NDArray[np.intp], strength: NDArray[np.float64], count: int) -> csr_array:
    """Graph of ``count`` photos, (count, count), whose edges are as long as one over each tie's strength, (K,) > 0."""
    # The spanning tree of older SciPy (1.13 to 1.15 tried) takes 32-bit indices only.
    ends = one.astype(np.int32), other.astype(np.int32)
    return csr_array((1.0 / strength, ends), shape=(count, count))


def strongest_ties(graph: csr_array) -> coo_array:
    """Edges of the maximum spanning tree of the ties: between two parts, the strongest tie across any cut."""
    return minimum_spanning_tree(graph).tocoo()


def cut(tree: coo_array, edge: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The two parts, (count,) bool each, into which the tree falls without its edge number ``edge``."""
    kept = np.arange(len(tree.data)) != edge
    rest = csr_array((tree.data[kept], (tree.row[kept], tree.col[kept])), shape=tree.shape)
    _, label = connected_components(rest, directed=False)
    return label == label[tree.row[edge]], label == label[tree.col[edge]]

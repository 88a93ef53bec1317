"""Candidate edges of one stem from many photographs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Edges:
    """Candidate edges near one stem, N of them, about the axis that the cloud's fit gave.

    Attributes
    ----------
    support_m: (N,) distance of the viewing ray from the axis, towards ``angle_rad``.
    angle_rad: (N,) direction of the outward normal in the plane across the axis.
    height_m: (N,) along the axis, about breast height.
    strength: (N,) of the edge, in standard deviations of what the bark itself shows.
    pixel_m: (N,) one pixel of the photograph at the stem.
    ray: (N,) number of photograph, side and band: of those with the same number at most one is the stem's edge.
    photo: (N,) index of the photograph in the scene.
    own: (N,) bool, False where something tells that it is the edge of another thing.
    """

    support_m: Floats
    angle_rad: Floats
    height_m: Floats
    strength: Floats
    pixel_m: Floats
    ray: Ints
    photo: Ints
    own: NDArray[np.bool_]


def chosen_edges(edges: Edges, chosen: NDArray[np.bool_] | Ints) -> Edges:
    """The edges of which ``chosen`` (N,) is true, or those that it numbers."""
    return Edges(
        support_m=edges.support_m[chosen],
        angle_rad=edges.angle_rad[chosen],
        height_m=edges.height_m[chosen],
        strength=edges.strength[chosen],
        pixel_m=edges.pixel_m[chosen],
        ray=edges.ray[chosen],
        photo=edges.photo[chosen],
        own=edges.own[chosen],
    )


def joined_edges(first: Edges, second: Edges) -> Edges:
    """The edges of both, which share no photograph."""
    return Edges(
        support_m=np.r_[first.support_m, second.support_m],
        angle_rad=np.r_[first.angle_rad, second.angle_rad],
        height_m=np.r_[first.height_m, second.height_m],
        strength=np.r_[first.strength, second.strength],
        pixel_m=np.r_[first.pixel_m, second.pixel_m],
        ray=np.r_[first.ray, second.ray],
        photo=np.r_[first.photo, second.photo],
        own=np.r_[first.own, second.own],
    )


def sides_in_photos(edges: Edges) -> Floats:
    """Which of the two sides of the stem in its photograph each edge (N,) lies on: 1 as that one's first, or -1."""
    _, first, photo = np.unique(edges.photo, return_index=True, return_inverse=True)
    return np.where(np.cos(edges.angle_rad - edges.angle_rad[first[photo]]) > 0.0, 1.0, -1.0)


def two_sided(edges: Edges) -> NDArray[np.bool_]:
    """Whether each edge's (N,) photograph has edges on both sides of the stem."""
    return np.isin(edges.photo, edges.photo[sides_in_photos(edges) < 0.0])

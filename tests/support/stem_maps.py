"""Tables of trees whose places and diameters are given, and the same stems as another part of the walk has them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.trees.tree import Tree

Floats = NDArray[np.float64]


def tree_of(number: int, place: Sequence[float], dbh_cm: float | None, *, half_cm: float = 0.4) -> Tree:
    """A sound tree at ``place`` (x, y, ground); without a DBH an unmeasured one."""
    known = dbh_cm is not None
    return Tree(
        tree_id=number,
        x_m=float(place[0]),
        y_m=float(place[1]),
        z_ground_m=float(place[2]),
        dbh_cm=dbh_cm,
        dbh_lo95_cm=None if dbh_cm is None else dbh_cm - half_cm,
        dbh_hi95_cm=None if dbh_cm is None else dbh_cm + half_cm,
        dbh_perimeter_cm=dbh_cm,
        dbh_min_cm=None,
        dbh_max_cm=None,
        bh_m=1.3,
        arc_coverage=0.8 if known else 0.1,
        points=900,
        residual_cm=0.5 if known else None,
        lean_deg=1.0,
        height_m=None,
        status="ok" if known else "unmeasured",
        reasons=(),
    )


def strewn(count: int, *, seed: int, extent_m: float = 16.0, apart_m: float = 1.5) -> list[Tree]:
    """Stems strewn over a square, no two nearer than ``apart_m``, on ground that slopes."""
    rng = np.random.default_rng(seed)
    places: list[Floats] = []
    while len(places) < count:
        place = rng.uniform(0.0, extent_m, 2)
        if all(np.hypot(*(place - other)) >= apart_m for other in places):
            places.append(place)
    return [
        tree_of(number, (x, y, 0.1 * x), round(float(rng.uniform(10.0, 40.0)), 2))
        for number, (x, y) in enumerate(places, start=1)
    ]


def seen_from_elsewhere(
    trees: Sequence[Tree], *, turn_deg: float, shift: tuple[float, float, float], noise_m: float = 0.0, seed: int = 0
) -> list[Tree]:
    """The trees in another frame, numbered anew: turned about the vertical, then shifted; places off by ``noise_m``."""
    rng = np.random.default_rng(seed)
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    moved = []
    for number, tree in enumerate(trees, start=1):
        x, y = cos * tree.x_m - sin * tree.y_m + shift[0], sin * tree.x_m + cos * tree.y_m + shift[1]
        off_x, off_y = rng.normal(0.0, noise_m, 2)
        moved.append(replace(tree, tree_id=number, x_m=x + off_x, y_m=y + off_y, z_ground_m=tree.z_ground_m + shift[2]))
    return moved

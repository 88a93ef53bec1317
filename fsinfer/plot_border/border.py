"""The border itself in the plan of the cloud: how far inside it places lie, its area, and its outline to draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.plot_border.request import Place
from fsinfer.plot_border.request import area_m2 as polygon_area_m2

Floats = NDArray[np.float64]
#: Corners by which a circle is drawn. Source: layout.
OUTLINE_CORNERS = 96
#: Places times corners that are looked at together. Source: numerics; they take 100 bytes each.
_AT_ONCE = 500_000


@dataclass(frozen=True, kw_only=True)
class Border:
    """A circle (``center`` and ``radius_m``) or a polygon (``corners``), in metres of the cloud's frame.

    Attributes
    ----------
    center, radius_m: of the circle; None for a polygon.
    corners: of the polygon, in their order; empty for a circle.
    origin: "walk", "marker 7", "coordinate" or "polygon": what it was placed by.
    moves_along: whether it was placed by something in the cloud, so that an error of the scale moves it with the stems;
        a coordinate or a polygon stays where it was written.
    """

    center: Place | None = None
    radius_m: float | None = None
    corners: tuple[Place, ...] = ()
    origin: str
    moves_along: bool

    @property
    def area_m2(self) -> float:
        """Horizontal area."""
        if self.radius_m is not None:
            return float(np.pi * self.radius_m**2)
        return polygon_area_m2(self.corners)

    @property
    def anchor(self) -> Place:
        """Place (x, y) that an error of the scale leaves where it is, seen from the border."""
        return self.center if self.moves_along and self.center is not None else (0.0, 0.0)

    @property
    def middle(self) -> Place:
        """Place (x, y) that it lies round."""
        if self.center is not None:
            return self.center
        x, y = np.mean(self.corners, axis=0).tolist()
        return x, y

    def inside_m(self, xy: Floats) -> Floats:
        """Distance (N,) of places (N, 2) from the border, negative outside of it."""
        if self.center is not None and self.radius_m is not None:
            return np.asarray(self.radius_m - np.hypot(*(xy - np.array(self.center)).T))
        at_once = max(1, _AT_ONCE // len(self.corners))
        parts = [self._inside_polygon_m(xy[first : first + at_once]) for first in range(0, len(xy), at_once)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _inside_polygon_m(self, xy: Floats) -> Floats:
        corners = np.array(self.corners)
        nexts = np.roll(corners, -1, axis=0)
        side = nexts - corners
        offset = xy[:, None, :] - corners
        along = np.clip((offset * side).sum(axis=-1) / (side**2).sum(axis=-1), 0.0, 1.0)
        distance = np.linalg.norm(offset - along[..., None] * side, axis=-1).min(axis=1)
        # A ray towards +x crosses the sides of a polygon an odd number of times from within.
        spans = (corners[:, 1] > xy[:, None, 1]) != (nexts[:, 1] > xy[:, None, 1])
        rise = np.where(side[:, 1] == 0, 1.0, side[:, 1])
        crossing = corners[:, 0] + (xy[:, None, 1] - corners[:, 1]) / rise * side[:, 0]
        inside = (np.count_nonzero(spans & (xy[:, None, 0] < crossing), axis=1) % 2).astype(bool)
        return np.asarray(np.where(inside, distance, -distance), dtype=np.float64)

    @property
    def outline(self) -> Floats:
        """Corners (K, 2) to draw it by, the first not repeated."""
        if self.center is None or self.radius_m is None:
            return np.array(self.corners, dtype=np.float64)
        turn = np.linspace(0.0, 2.0 * np.pi, OUTLINE_CORNERS, endpoint=False)
        return np.asarray(np.array(self.center) + self.radius_m * np.column_stack([np.cos(turn), np.sin(turn)]))

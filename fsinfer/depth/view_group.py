"""A reference view and its sources, as the network is given them: feature maps, cameras and the range searched."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.cost_volume import Features
from fsinfer.depth.warping import Projection, relative_projection
from fsinfer.errors import InputError

Float64 = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ViewFeatures:
    """Feature maps of one image at a quarter and, for the refinement, at half resolution."""

    quarter: Features
    half: Features | None


@dataclass(frozen=True, kw_only=True)
class ViewGroup:
    """Views of which the first is the reference.

    Attributes
    ----------
    features: of N views.
    intrinsics: (N, 3, 3) float64, image pixels, pixel centres at integer coordinates.
    cam_from_world: (N, 4, 4) float64, metres or scene units.
    depth_range: nearest and farthest z depth searched, in the same units.
    """

    features: Sequence[ViewFeatures]
    intrinsics: Float64
    cam_from_world: Float64
    depth_range: tuple[float, float]

    @classmethod
    def of(
        cls,
        features: Sequence[ViewFeatures],
        intrinsics: Float64,
        cam_from_world: Float64,
        depth_range: tuple[float, float],
    ) -> ViewGroup:
        """The group of what was given; raises :class:`InputError` where shapes, numbers or the range do not fit."""
        intrinsics, cam_from_world = np.asarray(intrinsics, np.float64), np.asarray(cam_from_world, np.float64)
        near, far = depth_range
        if intrinsics.shape != (len(features), 3, 3) or cam_from_world.shape != (len(features), 4, 4):
            msg = f"{len(features)} views need (N,3,3) and (N,4,4), got {intrinsics.shape=}, {cam_from_world.shape=}"
            raise InputError(msg)
        if not (np.isfinite(intrinsics).all() and np.isfinite(cam_from_world).all()):
            msg = "intrinsics and cam_from_world must be finite numbers"
            raise InputError(msg)
        if not 0 < near < far or not np.isfinite(far):
            msg = f"the depth range must be 0 < near < far, is {depth_range}"
            raise InputError(msg)
        return cls(features=features, intrinsics=intrinsics, cam_from_world=cam_from_world, depth_range=depth_range)

    @property
    def quarter(self) -> list[Features]:
        """Feature maps at a quarter of the resolution."""
        return [view.quarter for view in self.features]

    @property
    def half(self) -> list[Features]:
        """Feature maps at half the resolution, of a model that has them."""
        return [view.half for view in self.features if view.half is not None]

    def projections(self, stride: int, reference_stride: int | None = None) -> list[Projection]:
        """From the reference to each source at a feature stride (:func:`fsinfer.depth.warping.relative_projection`)."""
        reference = self.intrinsics[0], self.cam_from_world[0]
        return [
            relative_projection(*reference, self.intrinsics[i], self.cam_from_world[i], stride, reference_stride)
            for i in range(1, len(self.intrinsics))
        ]

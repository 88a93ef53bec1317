"""How far a fused point may be off along its line of sight, and how large a pixel of its depth map is there.

A place that two photographs a base b apart show, f pixels of focal length, is known from a match that is off by e
pixels to ``e Z^2 / (f b)`` at the depth Z: the normal case of stereo photogrammetry (K. Kraus, Photogrammetry, 2007,
section 2.1.2). That of a cloud's points ranges over two orders of magnitude, and who measures in the cloud has to know.
A depth is that of a patch of pixels: how large a pixel is tells what it is a mean over.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.settings import DepthSettings
from fsinfer.scene import Scene, View

#: Standard deviation of a match, pixels of the picture that the network is given, with what the cameras' errors add: of
#: a larger photograph it is as much more as that was reduced. Source: chosen on the stems of one rendered plot
#: (docs/trials-accuracy.md).
MATCH_PX = 0.15
#: Sources whose bases count: those that a view is compared with. Source: option; that of depth.
SOURCES = DepthSettings.source_views
#: Bits of the mantissa that are kept: three per cent of a standard deviation are enough, six of a pixel, and what comes
#: after is not compressed. Source: numerics.
_BITS, _PIXEL_BITS = 5, 4


def std_at_unit_depth(scene: Scene, views: Sequence[int], focals_px: Sequence[float] | NDArray[np.float64]) -> float:
    """Standard deviation of a depth of 1 from one view, scene units: the median of the ``views``; 0 where none has a
    source.

    ``focals_px``, one for each of the ``views``, are in pixels of the pictures that were matched
    (:meth:`fsinfer.depth.maps.DepthMaps.picture_focals_px`), which may be smaller than the photographs.
    """
    per_px = [focal_px * _base(scene, scene.views[v]) for v, focal_px in zip(views, focals_px, strict=True)]
    each = [1.0 / focal_times_base for focal_times_base in per_px if focal_times_base > 0.0]
    return MATCH_PX * float(np.median(each)) if each else 0.0


def _base(scene: Scene, view: View) -> float:
    """Longest base across the line of sight among the first sources of a view, scene units."""
    offsets = np.array([scene.views[s].camera.center - view.camera.center for s in view.sources[:SOURCES]])
    if not len(offsets):
        return 0.0
    across = offsets @ view.camera.cam_from_world[:2, :3].T
    return float(np.linalg.norm(across, axis=1).max())


def depth_std(quality: NDArray[np.float64], at_unit_depth: float) -> NDArray[np.float32]:
    """(N,) standard deviation of points along their lines of sight, scene units, in steps of three per cent.

    ``quality`` (N,) is theirs: views over depth^4 (:attr:`fsinfer.fusion.voxels.Samples.quality`).
    """
    return _in_steps(at_unit_depth / np.sqrt(quality), _BITS)


def pixel_size(quality: NDArray[np.float64], views: NDArray[np.integer], focal_px: float) -> NDArray[np.float32]:
    """(N,) length of a pixel of the depth maps at points, scene units, in steps of six per cent.

    ``quality`` (N,) as of :func:`depth_std`, ``views`` (N,) how many agree: what both say of the depth.
    ``focal_px`` is in pixels of the depth maps (:meth:`fsinfer.depth.maps.DepthMaps.focal_px`): a depth is the mean
    over a patch of the picture that it was computed from, which may be smaller than the photograph.
    """
    return _in_steps((views / quality) ** 0.25 / focal_px, _PIXEL_BITS)


def _in_steps(values: NDArray[np.float64], bits: int) -> NDArray[np.float32]:
    """Positive ``values`` (N,) to the nearest number with so many bits of mantissa."""
    step = np.int32(1 << (23 - bits))
    return ((values.astype(np.float32).view(np.int32) + step // 2) & -step).view(np.float32)

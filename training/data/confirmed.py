"""The part of a true depth map that the true maps of neighbouring views confirm.

A truth that was itself computed from photographs is wrong in places: where a wall without texture, the sky round a
silhouette or a reflection in a window took the depth of something else. Such places seldom fit into the maps of the
neighbours. The estimate that is judged has no part in the choice.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.view_maps import reduced_intrinsic
from fsinfer.depth.warping import relative_projection
from fsinfer.io.images import image_size
from fsinfer.scene import Scene, View
from training.data.true_scene import TrueScene

Float32 = NDArray[np.float32]

#: Neighbours that are asked. Source: judgement; they see the same side.
NEIGHBOURS = 10
#: Relative difference of the depths up to which a neighbour confirms. Source: judgement; that of the share of good
#: pixels in :mod:`training.metrics`.
TOLERANCE = 0.01


@dataclass(frozen=True, kw_only=True)
class ConfirmedTruth:
    """A scene of whose true depth only that counts which ``votes`` of the views' first sources confirm.

    ``counts`` are the pixels with truth, and those of them that are confirmed, of all maps asked for so far.
    """

    scene: TrueScene
    votes: int
    counts: list[int] = field(default_factory=lambda: [0, 0])

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.scene.name

    def read(self) -> Scene:
        """Read the scene; SceneError where it is incomplete."""
        return self._read

    @cached_property
    def _read(self) -> Scene:
        return self.scene.read()

    def true_depth(self, view: View) -> Float32 | None:
        """(H, W) float32 as the scene has it, 0 where too few neighbours confirm it. None: no map."""
        truth = self.scene.true_depth(view)
        if truth is None:
            return None
        found = np.zeros(truth.shape, np.int32)
        for other in (self._read.views[i] for i in view.sources[:NEIGHBOURS]):
            theirs = self.scene.true_depth(other)
            if theirs is not None:
                found += agree(truth, view, theirs, other)
        confirmed = (truth > 0) & (found >= self.votes)
        self.counts[0] += int((truth > 0).sum())
        self.counts[1] += int(confirmed.sum())
        return np.where(confirmed, truth, np.float32(0))


def agree(depth: Float32, view: View, theirs: Float32, other: View) -> NDArray[np.bool_]:
    """(h, w) bool: where a pixel's place in space has the depth there that the other map has for it, within 1 %.

    ``depth`` (h, w) and ``theirs`` are maps of the views' photographs or of an integer part of their size, 0 unknown.
    """
    (h, w), (their_h, their_w) = depth.shape, theirs.shape
    projection = relative_projection(
        _intrinsic_of(depth, view),
        view.camera.cam_from_world,
        _intrinsic_of(theirs, other),
        other.camera.cam_from_world,
        1,
    )
    v, u = np.mgrid[:h, :w]
    # Before the divide: column and row there times the depth there, and that depth.
    x, y, z = projection.matrix @ np.stack([u, v, np.ones_like(u)]).reshape(3, -1) * depth.ravel()
    x, y, z = (part.reshape(h, w) + shift for part, shift in zip((x, y, z), projection.offset, strict=True))
    ahead = (depth > 0) & (z > 0)
    z = np.where(ahead, z, 1.0)
    column, row = np.rint(x / z), np.rint(y / z)
    seen = ahead & (column >= 0) & (column < their_w) & (row >= 0) & (row < their_h)
    there = np.zeros(depth.shape)
    there[seen] = theirs[row[seen].astype(np.intp), column[seen].astype(np.intp)]
    return np.asarray(seen & (there > 0) & (np.abs(there - z) <= TOLERANCE * z), bool)


def _intrinsic_of(depth: Float32, view: View) -> NDArray[np.float64]:
    """(3, 3) of a map of the view's photograph, or of one reduced to its size."""
    width, height = image_size(view.image_path, upright=False)
    return reduced_intrinsic(view.camera.intrinsic, depth.shape[1] / width, depth.shape[0] / height)

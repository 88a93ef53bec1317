"""The part of a true depth map that the true maps of neighbouring views confirm.

A truth that was itself computed from photographs is wrong in places: where a wall without texture, the sky round a
silhouette or a reflection in a window took the depth of something else. Such places seldom fit into the maps of the
neighbours. The estimate that is judged has no part in the choice.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

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
    _maps: dict[str, Float32 | None] = field(default_factory=dict)
    _scene: list[Scene] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.scene.name

    def read(self) -> Scene:
        """Read the scene; SceneError where it is incomplete."""
        if not self._scene:
            self._scene.append(self.scene.read())
        return self._scene[0]

    def true_depth(self, view: View) -> Float32 | None:
        """(H, W) float32 as the scene has it, 0 where too few neighbours confirm it. None: no map."""
        truth = self._map(view)
        if truth is None:
            return None
        views = self.read().views
        found = np.zeros(truth.shape, np.int32)
        for i in view.sources[:NEIGHBOURS]:
            theirs = self._map(views[i])
            if theirs is not None:
                found += agree(truth, view, theirs, views[i])
        confirmed = (truth > 0) & (found >= self.votes)
        self.counts[0] += int((truth > 0).sum())
        self.counts[1] += int(confirmed.sum())
        return np.where(confirmed, truth, np.float32(0))

    def _map(self, view: View) -> Float32 | None:
        if view.name not in self._maps:
            self._maps[view.name] = self.scene.true_depth(view)
        return self._maps[view.name]


def agree(depth: Float32, view: View, theirs: Float32, other: View) -> NDArray[np.bool_]:
    """(h, w) bool: where a pixel's place in space has the depth there that the other map has for it, within 1 %.

    ``depth`` (h, w) and ``theirs`` are maps of the views' photographs or of an integer part of their size, 0 unknown.
    """
    (h, w), (their_h, their_w) = depth.shape, theirs.shape
    full_w, full_h = image_size(view.image_path, upright=False)
    their_full_w, their_full_h = image_size(other.image_path, upright=False)
    v, u = np.mgrid[:h, :w]
    # Pixel i of a map reduced by s covers the pixels s i to s (i + 1) - 1 of the photograph.
    x, y = (u + 0.5) * full_w / w - 0.5, (v + 0.5) * full_h / h - 0.5
    k = view.camera.intrinsic
    rays = np.stack([(x - k[0, 2]) / k[0, 0], (y - k[1, 2]) / k[1, 1], np.ones_like(x)], axis=-1)
    relative = other.camera.cam_from_world @ np.linalg.inv(view.camera.cam_from_world)
    places = (rays * depth[..., None]) @ relative[:3, :3].T + relative[:3, 3]
    ahead = (depth > 0) & (places[..., 2] > 0)
    z = np.where(ahead, places[..., 2], 1.0)
    k = other.camera.intrinsic
    column = np.rint((k[0, 0] * places[..., 0] / z + k[0, 2] + 0.5) * their_w / their_full_w - 0.5)
    row = np.rint((k[1, 1] * places[..., 1] / z + k[1, 2] + 0.5) * their_h / their_full_h - 0.5)
    seen = ahead & (column >= 0) & (column < their_w) & (row >= 0) & (row < their_h)
    there = np.zeros(depth.shape)
    there[seen] = theirs[row[seen].astype(np.intp), column[seen].astype(np.intp)]
    return np.asarray(seen & (there > 0) & (np.abs(there - z) <= TOLERANCE * z), bool)

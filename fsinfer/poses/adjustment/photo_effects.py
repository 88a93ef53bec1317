"""What a photo has of its own, and how it is undone: so that everything after sees a pinhole that stood still."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.adjustment.projection import DRIFT, FOCAL, OWN, PRINCIPAL, TURN, Floats, project, read_at

#: Rounds in which the row of a pixel is found, on which its own place depends. Source: numerics; each gains a factor
#: of hundred.
_ROUNDS = 3
#: Cells across a photo in which its inverse depth is averaged, and how far points count, in widths of a photo. Source:
#: judgement; the way of a phone while it reads a photo out is a centimetre, a pixel or two at 5 m.
_CELLS, _REACH = 32, 0.05
#: Weight of the photo's middle depth where no point is near, in points. Source: judgement.
_FAR_WEIGHT = 0.1


@dataclass(frozen=True, kw_only=True)
class PhotoEffects:
    """A photo's own focal length, principal point and motion while it was read out.

    Attributes
    ----------
    focal_factor: of the lens's focal length. principal_px: (2,) shift of its principal point.
    turn_rad: (3,) rotation from the first to the last row, about the camera's axes: a point at x in the camera
        of the middle row's time is seen by the last row at x + turn/2 x x + drift/2.
    drift: (3,) way from the first to the last row, of the points in the camera, model units.
    width_px, height_px: of the photo.
    inverse_depth: (cells, cells) of the photo's points, 1/model units, over the photo from edge to edge; smooth.
    """

    focal_factor: float
    principal_px: tuple[float, float]
    turn_rad: tuple[float, float, float]
    drift: tuple[float, float, float]
    width_px: int
    height_px: int
    inverse_depth: NDArray[np.float32]

    @property
    def own(self) -> Floats:
        """(9,) as in :mod:`fsinfer.poses.adjustment.projection`."""
        return np.array([np.log(self.focal_factor), *self.principal_px, *self.turn_rad, *self.drift])

    def pixels(self, rays: Floats, inverse_depth: Floats, lens: Floats) -> Floats:
        """Where the photo shows (n, 3) rays of the middle row's camera, z = 1: (n, 2) pixels, COLMAP's origin.

        Lens (12,); the inverse depth (n,) counts for the way alone, the rotation is undone without it.
        """
        count = len(rays)
        lenses, own = np.broadcast_to(lens, (count, len(lens))), np.broadcast_to(self.own, (count, OWN)).copy()
        own[:, DRIFT] *= inverse_depth[:, None]
        pixels = project(rays, np.zeros(count), lenses, own)
        for _ in range(_ROUNDS):
            pixels = project(rays, read_at(pixels, self.width_px, self.height_px), lenses, own)
        return pixels

    def inverse_depths(self, pixels: Floats) -> Floats:
        """(n,) at (n, 2) pixels of the photo, COLMAP's origin, between the cells' middles."""
        cells = np.array(self.inverse_depth.shape[::-1])
        at = (pixels / (self.width_px, self.height_px) * cells - 0.5).astype(np.float32)
        found = [
            cv2.remap(self.inverse_depth, part[:, :1].copy(), part[:, 1:].copy(), cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REPLICATE)[:, 0]
            for part in np.array_split(at, len(at) // _MOST_AT_ONCE + 1)
        ]  # fmt: skip
        return np.concatenate(found).astype(np.float64)


#: Pixels looked up at once. Source: numerics; OpenCV's remap takes images of up to 32,767 rows.
_MOST_AT_ONCE = 30000


def effects_of(own: Floats, pixels: Floats, depths: Floats, width_px: int, height_px: int) -> PhotoEffects:
    """Of (9,) unknowns; pixels (n, 2) and depths (n,) of the points that the photo sees give its smooth depth."""
    turn, drift = own[TURN].tolist(), own[DRIFT].tolist()
    return PhotoEffects(
        focal_factor=float(np.exp(own[FOCAL][0])),
        principal_px=(float(own[PRINCIPAL][0]), float(own[PRINCIPAL][1])),
        turn_rad=(turn[0], turn[1], turn[2]),
        drift=(drift[0], drift[1], drift[2]),
        width_px=width_px,
        height_px=height_px,
        inverse_depth=smooth_inverse_depth(pixels, depths, width_px, height_px),
    )


def smooth_inverse_depth(pixels: Floats, depths: Floats, width_px: int, height_px: int) -> NDArray[np.float32]:
    """(cells, cells) weighted means of the points' inverse depths: an approximation, blind to edges of stems."""
    middles = (np.arange(_CELLS) + 0.5) / _CELLS
    inverse = 1 / depths
    reach = _REACH * width_px
    across = np.exp(-0.5 * ((middles[:, None] * width_px - pixels[:, 0]) / reach) ** 2)
    down = np.exp(-0.5 * ((middles[:, None] * height_px - pixels[:, 1]) / reach) ** 2)
    weight = down @ across.T + _FAR_WEIGHT
    usual = float(np.median(inverse)) if len(inverse) else 0.0
    return np.asarray(((down * inverse) @ across.T + _FAR_WEIGHT * usual) / weight, dtype=np.float32)

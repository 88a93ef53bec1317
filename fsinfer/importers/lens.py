"""The lens of a photograph that another program calibrated, and the pinhole image that it is resampled to.

Pixel centres lie at integer coordinates. Rays are ``(x, y)`` with z = 1: x right, y down.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError

Floats = NDArray[np.float64]

#: Places along each border of a photo that are followed to the pinhole image. Source: numerics; a border is smooth.
_BORDER_PLACES = 65
#: Newton's steps at most, and how near (at z = 1) a ray has to come. Source: numerics.
_MOST_STEPS, _NEAR = 60, 1e-10
#: Shift by which slopes are taken. Source: numerics.
_SHIFT = 1e-6
#: Sides of the pinhole image over those of the photo, at least and at most. Source: judgement; a phone's lens changes
#: them by a few per cent, and what is beyond is no calibration of this photo.
_LEAST_SIDE, _MOST_SIDE = 0.3, 2.0
#: Rows of the image whose places in the photo are computed at a time. Source: numerics.
_ROWS = 64
#: Sides of a photo may differ so much from those of its calibration, scaled to it. Source: numerics; rounding of a
#: reduced copy.
_SIDE_TOLERANCE_PX = 1.5


@dataclass(frozen=True, kw_only=True)
class Lens:
    """A calibrated lens: ``u = fx x' + skew y' + cx``, ``v = fy y' + cy``.

    ``x' = x (1 + k1 r² + k2 r⁴ + ...) / (1 + d1 r² + d2 r⁴ + ...) + 2 p1 x y + p2 (r² + 2 x²)`` and
    ``y' = y (...) / (...) + p1 (r² + 2 y²) + 2 p2 x y``, with ``r² = x² + y²``: Brown's model with OpenCV's order of
    the tangential terms. Source: OpenCV's documentation of camera calibration.

    Attributes
    ----------
    width, height: of the photos it was calibrated on, pixels.
    fx, fy, cx, cy, skew: pixels.
    radial: k1, k2, ...
    divisor: d1, d2, ... (k4, k5, k6 of OpenCV).
    tangential: p1 and p2.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    skew: float = 0.0
    radial: tuple[float, ...] = ()
    divisor: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy, self.skew, *self.radial, *self.divisor, *self.tangential)
        if not (np.isfinite(numbers).all() and self.fx > 0 and self.fy > 0 and self.width > 0 and self.height > 0):
            msg = f"a camera of {self.width}x{self.height} pixels has the focal lengths {self.fx} and {self.fy}"
            raise SceneError(msg)

    @property
    def is_pinhole(self) -> bool:
        """Whether photos can be used as they are."""
        return not any((self.skew, *self.radial, *self.divisor, *self.tangential))

    @property
    def intrinsic(self) -> Floats:
        """(3, 3) without distortion."""
        return np.array([[self.fx, self.skew, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    def distort(self, rays: Floats) -> Floats:
        """Rays (N, 2) as the lens bends them."""
        x, y = rays[:, 0], rays[:, 1]
        r2 = x * x + y * y
        factor = _series(self.radial, r2) / _series(self.divisor, r2)
        p1, p2 = self.tangential
        return np.stack(
            [x * factor + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * factor + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
            axis=1,
        )

    def pixels_of(self, rays: Floats) -> Floats:
        """Where rays (N, 2) fall in the photo, (N, 2)."""
        bent = self.distort(rays)
        return np.stack(
            [self.fx * bent[:, 0] + self.skew * bent[:, 1] + self.cx, self.fy * bent[:, 1] + self.cy], axis=1
        )

    def rays_of(self, pixels: Floats) -> Floats:
        """The rays (N, 2) that fall on pixels (N, 2), by Newton's method from the middle outwards.

        Raises
        ------
        SceneError
            The distortion cannot be undone there: it folds, which no lens does.
        """
        y = (pixels[:, 1] - self.cy) / self.fy
        bent = np.stack([(pixels[:, 0] - self.cx - self.skew * y) / self.fx, y], axis=1)
        if self.is_pinhole:
            return bent
        rays = bent.copy()
        with np.errstate(all="ignore"):
            for _ in range(_MOST_STEPS):
                missing = bent - self.distort(rays)
                slopes = self._slopes(rays)
                determinant = slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0]
                step_x = (slopes[:, 1, 1] * missing[:, 0] - slopes[:, 0, 1] * missing[:, 1]) / determinant
                step_y = (slopes[:, 0, 0] * missing[:, 1] - slopes[:, 1, 0] * missing[:, 0]) / determinant
                rays = rays + np.stack([step_x, step_y], axis=1)
                if not np.isfinite(rays).all() or np.abs(missing).max(initial=0.0) < _NEAR:
                    break
            unmet = np.abs(bent - self.distort(rays))
            # Beyond the fold there is a second answer: the way out from the middle has to rise all along.
            rising = np.ones(len(rays), dtype=bool)
            for share in np.linspace(0.0, 1.0, 17):
                slopes = self._slopes(share * rays)
                rising &= slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0] > 0
        if not (np.isfinite(unmet).all() and unmet.max(initial=0.0) < 1e-6 and rising.all()):
            msg = f"the distortion of a camera of {self.width}x{self.height} pixels cannot be undone at its border"
            raise SceneError(msg)
        return rays

    def _slopes(self, rays: Floats) -> Floats:
        """(N, 2, 2) derivatives of the bent rays by the rays."""
        shifts = np.eye(2) * _SHIFT
        by_x, by_y = (self.distort(rays + shift) - self.distort(rays - shift) for shift in shifts)
        return np.stack([by_x, by_y], axis=2) / (2 * _SHIFT)

    def of_size(self, width: int, height: int) -> Lens:
        """The same lens for a copy of the photo reduced to another size.

        Raises
        ------
        SceneError
            The copy has other proportions: it was cut, or is not this photo.
        """
        if (width, height) == (self.width, self.height):
            return self
        x, y = width / self.width, height / self.height
        # Both sides of a reduced copy are rounded.
        if abs(width - self.width * y) > _SIDE_TOLERANCE_PX and abs(height - self.height * x) > _SIDE_TOLERANCE_PX:
            msg = (
                f"the photo is {width}x{height} pixels large, its camera was calibrated for {self.width}x{self.height}"
            )
            raise SceneError(msg)
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * x,
            fy=self.fy * y,
            cx=(self.cx + 0.5) * x - 0.5,
            cy=(self.cy + 0.5) * y - 0.5,
            skew=self.skew * x,
        )


def _series(coefficients: tuple[float, ...], r2: Floats) -> Floats:
    value = np.zeros_like(r2)
    for coefficient in reversed(coefficients):
        value = (value + coefficient) * r2
    return np.asarray(1.0 + value)


def pinhole_of(lens: Lens) -> Lens:
    """The pinhole camera of the same focal lengths whose image is the largest that shows no black border."""
    if lens.is_pinhole:
        return lens
    along_x = np.linspace(-0.5, lens.width - 0.5, _BORDER_PLACES)
    along_y = np.linspace(-0.5, lens.height - 0.5, _BORDER_PLACES)
    left, right = (
        lens.rays_of(np.stack([np.full(_BORDER_PLACES, x), along_y], axis=1))[:, 0] for x in (-0.5, lens.width - 0.5)
    )
    top, bottom = (
        lens.rays_of(np.stack([along_x, np.full(_BORDER_PLACES, y)], axis=1))[:, 1] for y in (-0.5, lens.height - 0.5)
    )
    least_x, least_y = float(left.max()), float(top.max())
    width = int(np.floor((float(right.min()) - least_x) * lens.fx))
    height = int(np.floor((float(bottom.min()) - least_y) * lens.fy))
    for side, of_photo in ((width, lens.width), (height, lens.height)):
        if not _LEAST_SIDE * of_photo <= side <= _MOST_SIDE * of_photo:
            msg = f"without its distortion a photo of {lens.width}x{lens.height} pixels would have {width}x{height}"
            raise SceneError(msg)
    return Lens(
        width=width,
        height=height,
        fx=lens.fx,
        fy=lens.fy,
        cx=-least_x * lens.fx - 0.5,
        cy=-least_y * lens.fy - 0.5,
    )


def undistortion_maps(lens: Lens, pinhole: Lens) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """For each pixel of the pinhole image, where it lies in the photo: x and y, (h, w) float32."""
    x_map = np.empty((pinhole.height, pinhole.width), dtype=np.float32)
    y_map = np.empty_like(x_map)
    x = (np.arange(pinhole.width) - pinhole.cx) / pinhole.fx
    for start in range(0, pinhole.height, _ROWS):
        rows = np.arange(start, min(start + _ROWS, pinhole.height))
        y = (rows - pinhole.cy) / pinhole.fy
        rays = np.stack([np.tile(x, len(rows)), np.repeat(y, len(x))], axis=1)
        pixels = lens.pixels_of(rays).reshape(len(rows), len(x), 2)
        x_map[rows], y_map[rows] = pixels[..., 0], pixels[..., 1]
    return x_map, y_map

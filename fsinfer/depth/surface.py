"""Whether a depth is that of the surface which its pixel shows: what a small network is given, and what it gives.

A depth map ends a pixel or two beside the silhouette: the pixels there have the depth of a stem and show what stands
behind it. The correlations of the photographs do not tell, for before the sky or a wall without texture the stem is the
only thing that can be compared. The picture tells: it has an edge where the silhouette is. So a network looks at the
features of the photograph at half of the resolution beside the steps of the depth map, and gives the probability that
a pixel lies on the surface that its depth says. The depth stays as it is; fusion leaves out what is unsure.

The network sees four pixels of the map as one, so that most of it works at a quarter of the photograph's resolution.
The same in PyTorch is ``training/model/surface.py``; ``python -m training.surface`` trains it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]

#: Name of the graph in a manifest.
SURFACE = "surface"
#: Pixels of the map that are one to the network. Source: layout, two by two.
PARTS = 4
#: A step of so many planes counts three quarters of one without end. Source: the training; the narrow volume reaches
#: half as far to each side.
STEP_PLANES = 3.0
#: A pixel is doubted where its depth is less likely than this to be of its surface. Source: docs/trials-accuracy.md,
#: "What the picture tells of where a surface ends"; without it parts of real photographs are doubted for nothing.
LIKELY = 0.5
#: The eight pixels round one, down and right. Source: layout; the training.
AROUND = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if (down, right) != (0, 0))


def surface_inputs(features_chw: Float32, index: Float32, confidence: Float32) -> Float32:
    """What the network is given: (4 C + 16, h, w) of maps (H, W), h and w being half of these, rounded up.

    The features (C, H, W) of the photograph and the ``confidence`` of each of the four pixels that are one; how far
    their plane ``index`` lies from the mean of the four, and that of the eight neighbours from it, in steps that end
    at 1.
    """
    four = in_parts(index)
    mean = four.mean(axis=0, dtype=np.float32)
    height, width = mean.shape
    wide = np.pad(mean, 1, mode="edge")
    beside = [wide[1 + down : 1 + down + height, 1 + right : 1 + right + width] for down, right in AROUND]
    steps = np.concatenate([four, beside]) - mean
    steps *= np.float32(1 / STEP_PLANES)
    np.tanh(steps, out=steps)
    return np.concatenate([in_parts(features_chw).reshape(-1, height, width), steps, in_parts(confidence)])


def in_parts(values: Float32) -> Float32:
    """(…, H, W) as (…, 4, h, w): pixel (2 i + down, 2 j + right) is pixel (i, j) of part 2 down + right.

    An odd row or column is repeated.
    """
    *leading, height, width = values.shape
    border = [(0, 0)] * len(leading) + [(0, height % 2), (0, width % 2)]
    even = np.pad(values, border, mode="edge") if height % 2 or width % 2 else values
    parts = even.reshape(*leading, (height + 1) // 2, 2, (width + 1) // 2, 2)
    return np.moveaxis(parts, (-3, -1), (-4, -3)).reshape(*leading, PARTS, (height + 1) // 2, (width + 1) // 2)


def of_parts(parts: Float32, shape: tuple[int, int]) -> Float32:
    """The map (H, W) of its four parts (4, h, w): :func:`in_parts` undone."""
    _, rows, columns = parts.shape
    whole = parts.reshape(2, 2, rows, columns).transpose(2, 0, 3, 1).reshape(2 * rows, 2 * columns)
    return np.ascontiguousarray(whole[: shape[0], : shape[1]])


def doubted(confidence: Float32, surface: Float32) -> Float32:
    """``confidence`` (H, W) of depths that are of their pixels' surfaces with probabilities ``surface`` (H, W)."""
    doubt = np.minimum(surface * np.float32(1 / LIKELY), np.float32(1))
    return np.asarray(confidence * doubt, np.float32)

"""Volumes of few hypotheses of each pixel's own: what the graphs after the regularizer are given.

The indices of these hypotheses are those of the 192 planes, with fractions; the planes are uniform in 1/depth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fsinfer.depth.candidates import candidate_planes, hints, spread_indices
from fsinfer.depth.cost_volume import upsample_index, upsample_twice, weighted_correlation_volume
from fsinfer.depth.manifest import ModelManifest
from fsinfer.depth.view_group import ViewGroup
from fsinfer.errors import ModelError
from fsinfer.threads import one_blas_thread

Float32 = NDArray[np.float32]

#: Least 1/depth of a hypothesis: what lies beyond infinity is nowhere. Source: numerics.
_LEAST_INVERSE = np.float32(1e-6)


@one_blas_thread()
def candidate_volume(
    manifest: ModelManifest,
    group: ViewGroup,
    index: Float32,
    confidence: Float32,
    weights: Float32,
    *,
    threads: int,
) -> tuple[dict[str, Float32], Float32]:
    """What the graph of the candidates is given, and the weights (S, H, W) of the sources at a quarter.

    ``index``, ``confidence`` (h, w) are those of the regularizer, ``weights`` (S, h, w) those of the sources in its
    volume. The inputs are by their names ``volume`` (candidates that are looked up x groups, H, W), ``features`` (C, H,
    W), ``hints`` (3, H, W) and ``planes`` (candidates, H, W); see :mod:`fsinfer.depth.candidates`.
    """
    found = manifest.candidates
    if found is None:
        msg = f"model {manifest.name} has no candidates"
        raise ModelError(msg)
    quarter = group.quarter
    height, width = quarter[0].shape
    centres = spread_indices(index, height, width)
    planes = candidate_planes(centres, around=found.around, step=found.step)
    weights = upsample_twice(weights, height, width)

    def inverse_depth_of(rows: slice) -> Float32:
        looked_up = candidate_planes(centres[:, rows], around=found.looked_up, step=found.looked_up_step)
        return _inverse_depth(looked_up, manifest, group.depth_range, out=looked_up)

    volume = weighted_correlation_volume(
        quarter[0],
        quarter[1:],
        group.projections(4),
        3 * found.looked_up,
        inverse_depth_of,
        weights,
        threads=threads,
    )
    inputs = {
        "volume": volume.reshape(-1, height, width),
        "features": quarter[0].to_chw(),
        "hints": hints(planes, confidence),
        "planes": planes,
    }
    return inputs, weights


@one_blas_thread()
def refiner_volume(
    manifest: ModelManifest, group: ViewGroup, index: Float32, weights: Float32, *, threads: int
) -> tuple[dict[str, Float32], Float32]:
    """What the refiner is given, and the plane index (H, W) at half resolution that its hypotheses lie round.

    ``index`` (h, w) is that at a quarter, ``weights`` (S, h, w) those of the sources there. The inputs are ``volume``
    (hypotheses that are looked up x groups, H, W) and ``features`` (C, H, W) by their names.
    """
    half = group.half
    height, width = half[0].shape
    centre = upsample_index(index, height, width)
    offsets = np.linspace(-manifest.refine_span, manifest.refine_span, manifest.refine_looked_up, dtype=np.float32)

    def inverse_depth_of(rows: slice) -> Float32:
        # Block by block: all at once they would be as large as half of the volume, and one thread's work.
        planes = np.add(centre[rows], offsets[:, None, None])
        return _inverse_depth(planes, manifest, group.depth_range, out=planes)

    volume = weighted_correlation_volume(
        half[0],
        half[1:],
        group.projections(2),
        len(offsets),
        inverse_depth_of,
        upsample_twice(weights, height, width),
        threads=threads,
    )
    return {"volume": volume.reshape(-1, height, width), "features": half[0].to_chw()}, centre


def depth_of_index(index: Float32, manifest: ModelManifest, depth_range: tuple[float, float]) -> Float32:
    """z depth at plane indices with fractions."""
    near, far = depth_range
    fraction = index / np.float32(manifest.planes - 1)
    if manifest.inverse_depth:
        inverse = np.float32(1 / far) + fraction * np.float32(1 / near - 1 / far)
        return np.asarray(1 / np.maximum(inverse, _LEAST_INVERSE), np.float32)
    return np.asarray(np.float32(near) + fraction * np.float32(far - near), np.float32)


def _inverse_depth(
    planes_dhw: Float32, manifest: ModelManifest, depth_range: tuple[float, float], *, out: Float32 | None = None
) -> Float32:
    """1/depth at plane indices, into ``out``."""
    near, far = depth_range
    interval = np.float32((1 / near - 1 / far) / (manifest.planes - 1))
    inverse: Float32 = np.multiply(planes_dhw, interval, out=out)
    inverse += np.float32(1 / far)
    np.maximum(inverse, _LEAST_INVERSE, out=inverse)
    return inverse

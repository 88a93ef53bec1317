"""Depth error figures that evaluation and the training log share."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class DepthErrors:
    """Errors of one depth map over the pixels with truth.

    Attributes
    ----------
    median_rel: median of |d - t| / t.  within_1pct: share of all pixels with truth whose error is below 1 %.
    within_1pct_sure: the same among the surer 70 %.  median_abs, median_abs_sure: in scene units.
    within_3cm_sure: share of the surer 70 % within 0.03 scene units.
    """

    pixels: int
    median_rel: float
    within_1pct: float
    within_1pct_sure: float
    median_abs: float
    median_abs_sure: float
    within_3cm_sure: float

    def to_dict(self) -> dict[str, float]:
        """Return the fields as plain values."""
        return asdict(self)


def depth_errors(
    depth: NDArray[np.float32],
    confidence: NDArray[np.float32],
    truth: NDArray[np.float32],
    *,
    max_depth: float = np.inf,
) -> DepthErrors | None:
    """Compare a depth map with the truth sampled on the same grid; pixels without truth (0) do not count.

    A missing estimate (0) counts as wrong. Returns ``None`` where no pixel has truth.
    """
    mask = (truth > 0) & (truth < max_depth)
    if not mask.any():
        return None
    error = np.abs(depth[mask] - truth[mask])
    relative = error / truth[mask]
    sure = confidence[mask] >= np.quantile(confidence[mask], 0.3)
    return DepthErrors(
        pixels=int(mask.sum()),
        median_rel=float(np.median(relative)),
        within_1pct=float((relative < 0.01).mean()),
        within_1pct_sure=float((relative[sure] < 0.01).mean()),
        median_abs=float(np.median(error)),
        median_abs_sure=float(np.median(error[sure])),
        within_3cm_sure=float((error[sure] < 0.03).mean()),
    )


def mean_errors(rows: list[DepthErrors]) -> dict[str, float]:
    """Unweighted mean over views of every figure."""
    return {key: float(np.mean([row.to_dict()[key] for row in rows])) for key in rows[0].to_dict()} if rows else {}

"""Correlations between the hypotheses at which they are looked up.

Narrow volumes have hypotheses nearer to each other than a pixel of the feature maps: what a bilinear sample gives at
one of them is nearly that between its neighbours. So fewer are looked up, and the others are those of a natural cubic
spline through them: a product with a fixed matrix, which the export multiplies into the convolution that follows.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor, nn


def spline_matrix(count: int, looked_up: int) -> Tensor:
    """(``count``, ``looked_up``) float64: values at evenly spaced places from those at fewer, of the same first and
    last place, ``looked_up`` >= 2.
    """
    places = np.linspace(0, 1, looked_up)
    spline = CubicSpline(places, np.eye(looked_up), bc_type="natural")
    return torch.from_numpy(np.asarray(spline(np.linspace(0, 1, count)), np.float64))


class Between(nn.Module):
    """Correlations (sets x ``looked_up`` x G, h, w) to those of all hypotheses, (sets x ``count`` x G, h, w).

    Each of the ``sets`` is a row of evenly spaced hypotheses.
    """

    def __init__(self, *, count: int, looked_up: int, sets: int = 1) -> None:
        super().__init__()
        self.count, self.looked_up, self.sets = count, looked_up, sets
        # No weight: checkpoints do not hold it.
        self.register_buffer("matrix", spline_matrix(count, looked_up).float(), persistent=False)

    def forward(self, volume_chw: Tensor) -> Tensor:
        """In any precision: the matrix takes that of the volume."""
        matrix = torch.as_tensor(self.matrix).to(volume_chw.dtype)
        rows = volume_chw.reshape(self.sets, self.looked_up, -1)
        return (matrix @ rows).reshape(-1, *volume_chw.shape[1:])

    def folded(self, weight: Tensor, groups: int) -> Tensor:
        """Weights (O, C, kh, kw) for what this gives, in front of other channels, to weights for what this takes."""
        of_volume = self.sets * self.count * groups
        apart = weight[:, :of_volume].reshape(len(weight), self.sets, self.count, groups, *weight.shape[2:])
        fewer = torch.einsum("oskgyx,kl->oslgyx", apart, torch.as_tensor(self.matrix).to(weight.dtype))
        return torch.cat([fewer.flatten(1, 3), weight[:, of_volume:]], dim=1)

"""MVSNet in PyTorch as it is usually written, to hold the speed of ours against.

Features, 3D U-Net and soft-argmin are those of the preset ``mvsnet`` of ``training``. Its cost volume is made there in
chunks of planes that stay in the cache, which was done for training; here each source is warped onto all planes at
once, and sums and sums of squares of whole volumes, added up in place, give the variance (MVSNet, eq. 2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from training.model import FSMVSNet, fsmvsnet
from training.model.config import PRESETS
from training.model.warping import project, sample

#: Images (H, W, 3) RGB uint8, intrinsics (N, 3, 3), poses (N, 4, 4), depth range.
Views = tuple[Sequence[NDArray[np.uint8]], NDArray[np.float64], NDArray[np.float64], tuple[float, float]]


def variance_written_out(
    reference_chw: Tensor,
    sources: list[Tensor],
    a: Tensor,
    b: Tensor,
    inverse_depth_dhw: Tensor,
    origin_xy: tuple[int, int],
) -> Tensor:
    """What :func:`training.model.volume.variance_volume` gives: (C, D, h, w)."""
    total = reference_chw[:, None].repeat(1, inverse_depth_dhw.shape[0], 1, 1)
    squares = total.square()
    for i, source in enumerate(sources):
        warped = sample(source, *project(a[i], b[i], inverse_depth_dhw, origin_xy)).reshape(total.shape)
        total += warped
        squares += warped.square_()
    views = len(sources) + 1
    return squares.div_(views).sub_(total.div_(views).square_())


def mvsnet(views: Views, threads: int, *, written_out: bool) -> Callable[[], Any]:
    """A function that estimates the depth of the first view, with the volume as the module says or as in training.

    In this process the choice holds for every model from then on.
    """
    torch.set_num_threads(threads)
    if written_out:
        setattr(fsmvsnet, "variance_volume", variance_written_out)  # noqa: B010 (it is no name that the module exports)
    model = FSMVSNet(PRESETS["mvsnet"]).eval()
    images, intrinsics, poses, depth_range = views
    nchw = torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).float()
    matrices = torch.from_numpy(intrinsics), torch.from_numpy(poses)

    @torch.no_grad()
    def estimate() -> Any:
        return model(nchw, *matrices, depth_range)

    return estimate

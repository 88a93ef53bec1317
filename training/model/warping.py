"""Differentiable homography warping of source features to the reference frame.

For a plane at depth d, fronto-parallel in the reference frame, a reference pixel p projects into the source view as
``K_s (R K_r^-1 p d + t)``; divided by d this is affine in 1/d: ``a(p) + b / d`` (MVSNet, eq. 1, written for a
point instead of a plane).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def relative_projection(
    intrinsics: Tensor,
    cam_from_world: Tensor,
    stride: int,
    reference_stride: int | None = None,
    dtype: torch.dtype = torch.float32,
) -> tuple[Tensor, Tensor]:
    """Return A (S, 3, 3) and b (S, 3) of every source view against view 0, at a feature stride, made in float64.

    ``intrinsics`` (N, 3, 3) in pixels of the full image, ``cam_from_world`` (N, 4, 4). A source pixel at the
    feature level is ``A [u, v, 1]^T + b / d``, before the perspective division; u and v count pixels of the reference
    at ``reference_stride``, which is the sources' where it is not given.
    """
    pose = cam_from_world.double().cpu()
    k, own = (
        torch.diag(torch.tensor([1 / s, 1 / s, 1.0], dtype=torch.float64)) @ intrinsics.double().cpu()
        for s in (stride, reference_stride or stride)
    )
    relative = pose[1:] @ torch.linalg.inv(pose[0])
    a = k[1:] @ relative[:, :3, :3] @ torch.linalg.inv(own[0])
    b = (k[1:] @ relative[:, :3, 3:])[..., 0]
    return a.to(intrinsics.device, dtype), b.to(intrinsics.device, dtype)


def project(a: Tensor, b: Tensor, inverse_depth_dhw: Tensor, origin_xy: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Source pixel coordinates x, y (D, h, w) of every hypothesis; -1e4 where it lies behind the source view."""
    _, h, w = inverse_depth_dhw.shape
    device = inverse_depth_dhw.device
    v, u = torch.meshgrid(
        torch.arange(h, device=device, dtype=a.dtype) + origin_xy[1],
        torch.arange(w, device=device, dtype=a.dtype) + origin_xy[0],
        indexing="ij",
    )
    far = a[:, 0, None, None] * u + a[:, 1, None, None] * v + a[:, 2, None, None]
    x, y, z = (far[i] + b[i] * inverse_depth_dhw for i in range(3))
    behind = z < 1e-6
    z = torch.where(behind, torch.ones_like(z), z)
    outside = torch.full_like(z, -1e4)
    return torch.where(behind, outside, x / z), torch.where(behind, outside, y / z)


def sample(features_chw: Tensor, x_dhw: Tensor, y_dhw: Tensor) -> Tensor:
    """Bilinear sampling (C, D, h*w) with zeros outside; integer coordinates are pixel centres."""
    channels, height, width = features_chw.shape
    planes, h, w = x_dhw.shape
    grid = torch.stack([x_dhw * (2 / (width - 1)) - 1, y_dhw * (2 / (height - 1)) - 1], dim=-1)
    # PyTorch shares out grid_sample over the batch only, so the planes are cut into as many samples as threads.
    parts = next(n for n in (torch.get_num_threads(), 2, 1) if planes % n == 0)
    grid = grid.reshape(parts, planes // parts, h * w, 2)
    batch = features_chw[None].expand(parts, -1, -1, -1)
    sampled = F.grid_sample(batch, grid, mode="bilinear", padding_mode="zeros", align_corners=True)
    return sampled.transpose(0, 1).reshape(channels, planes, h * w)

"""Parity of the whole depth map: PyTorch against ONNX with the NumPy volume, on real or rendered views.

The network in PyTorch computes in float64, with the weights as they are: what differs is what the deployed path rounds.
In float32 PyTorch rounds, too, and where hypotheses are equally good (sky) either decides by itself.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import torch

from fsinfer.depth.model import DepthModel
from fsinfer.errors import SceneError
from fsinfer.io.images import read_image
from fsinfer.scene import Scene
from training.model import FSMVSNet

#: What passes: 99.9th percentile of the relative difference of the depth, and the share of pixels on the same side of
#: the confidence threshold. Source: ten times finer than the accuracy of the depth itself.
DEPTH_REL_P999, MASK_AGREEMENT = 1e-3, 0.999


@dataclass(frozen=True, kw_only=True)
class Parity:
    """Differences over all pixels of some views.

    depth_rel_p999: 99.9th percentile of |d_onnx - d_torch| / d_torch. depth_rel_p999_sure: of the pixels above the
    confidence threshold in both, 0 where there are none; below it two hypotheses may be equally good, and rounding
    decides. mask_agreement: share of pixels on the same side of the threshold in both.
    """

    views: int
    pixels: int
    depth_rel_p50: float
    depth_rel_p999: float
    depth_rel_p999_sure: float
    mask_agreement: float

    def passes(self) -> bool:
        """Whether both are within :data:`DEPTH_REL_P999` and :data:`MASK_AGREEMENT`."""
        return self.depth_rel_p999 <= DEPTH_REL_P999 and self.mask_agreement >= MASK_AGREEMENT


@torch.no_grad()
def whole_parity(
    model: FSMVSNet,
    deployed: DepthModel,
    scene: Scene,
    *,
    views: int = 3,
    source_views: int = 4,
    dtype: torch.dtype = torch.float64,
) -> Parity:
    """Compare both paths on the first views of a scene at full image size; ``dtype`` is what PyTorch computes in.

    Raises :class:`SceneError` where no view has a source.
    """
    network = copy.deepcopy(model).to(dtype)
    network.eval()
    relative, agree, sure = [], [], []
    threshold = deployed.manifest.parity_confidence_threshold
    chosen = [view for view in scene.views if view.sources][:views]
    if not chosen:
        msg = f"{scene.folder} has no view with a source in pair.txt; give a scene of two views or more"
        raise SceneError(msg)
    for view in chosen:
        group = [view, *(scene.views[i] for i in view.sources[:source_views])]
        images = [read_image(v.image_path) for v in group]
        intrinsics = np.stack([v.camera.intrinsic for v in group])
        poses = np.stack([v.camera.cam_from_world for v in group])
        depth_range = (view.camera.depth_min, view.camera.depth_max)
        estimate = deployed.predict(images, intrinsics, poses, depth_range)
        nchw = torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2).to(dtype)
        output = network(nchw, torch.from_numpy(intrinsics), torch.from_numpy(poses), depth_range)
        depth = output.depth.numpy()
        relative.append((np.abs(estimate.depth - depth) / depth).ravel())
        ours, trained = (c > threshold for c in (estimate.confidence, deployed.calibrated(output.confidence.numpy())))
        agree.append((ours == trained).ravel())
        sure.append((ours & trained).ravel())
    errors, agreement = np.concatenate(relative), np.concatenate(agree)
    above = errors[np.concatenate(sure)]
    return Parity(
        views=len(chosen),
        pixels=len(errors),
        depth_rel_p50=float(np.quantile(errors, 0.5)),
        depth_rel_p999=float(np.quantile(errors, 0.999)),
        depth_rel_p999_sure=float(np.quantile(above, 0.999)) if len(above) else 0.0,
        mask_agreement=float(agreement.mean()),
    )

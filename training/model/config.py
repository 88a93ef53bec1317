"""What can be chosen about the network; every ablation of the paper is one field away from a preset."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

#: Planes of the wide volume. Source: MVSNet (Yao et al. 2018).
DEPTH_PLANES = 192


@dataclass(frozen=True, kw_only=True)
class ModelConfig:
    """The architecture and its loss.

    Attributes
    ----------
    backbone: ``conv`` is the plain feature network of MVSNet, ``bfpn`` the bidirectional pyramid of FS-MVSNet.
    se: squeeze-and-excitation (r = 16): of ``conv3d`` on the channels of the cost volume, as in the paper; of
        ``packed`` on the three levels of its U-Net, whose slabs hold planes and groups in one.
    loss: ``smooth`` is smooth L1 on the depth alone (MVSNet), ``hybrid`` the paper's three terms,
        ``plane`` cross-entropy on the planes with L1 below the plane.
    volume: ``variance`` over the views (paper), or ``correlation`` in ``groups`` weighted by view.
    regularizer: ``conv3d`` U-Net (paper), or ``packed`` 2D convolutions over slabs of ``packed_planes`` planes.
    feature_channels: F, at quarter resolution.
    width: channels of the regularizer's first level.
    refine_planes: hypotheses of the half-resolution refinement volume; 0 = no refinement.
    refine_span: half width of that volume, in intervals of the 192-plane volume.
    wide_stride: image pixels from one pixel of the 192-plane volume to the next: 4, the features' own, or 8, where the
        reference's features are taken at every second pixel and a volume of ``candidates`` at 4 follows.
    inverse_depth: planes uniform in 1/depth (R-MVSNet, Yao et al. 2019) instead of depth. The presets all have it: a
        forest reaches from half a metre to thirty, and planes uniform in depth are too far apart near the camera.
    lambda_smooth, lambda_multiscale, lambda_attention: weights of the three terms of ``hybrid``.
    first_scale: which scale is s = 1 of ``w_s = 1 / 2^(s - 1)``, the weight of a scale in the multi-scale term:
        ``coarsest``, the order in which depth is regressed from scale to scale, or ``finest``.
    optimizer: ``adam``, with weight decay added to the gradient (paper), or ``adamw``, with it taken from the weights.
    """

    name: str
    backbone: Literal["conv", "bfpn"] = "bfpn"
    se: bool = True
    loss: Literal["smooth", "hybrid", "plane"] = "hybrid"
    volume: Literal["variance", "correlation"] = "variance"
    regularizer: Literal["conv3d", "packed"] = "conv3d"
    feature_channels: int = 32
    base_channels: int = 8
    groups: int = 4
    packed_planes: int = 8
    width: int = 8
    refine_planes: int = 0
    refine_span: float = 1.5
    refine_channels: int = 8
    wide_stride: Literal[4, 8] = 4
    inverse_depth: bool = False
    lambda_smooth: float = 1.0
    lambda_multiscale: float = 0.5  # the text of the paper; its Table 4 says 0.8
    lambda_attention: float = 0.2
    first_scale: Literal["coarsest", "finest"] = "coarsest"
    # Checkpoints from before this field was there were trained with AdamW.
    optimizer: Literal["adam", "adamw"] = "adamw"

    @property
    def refine_looked_up(self) -> int:
        """Hypotheses of the refinement volume that are looked up: half, what lies between them is interpolated.

        See :mod:`training.model.between`; all of them bring 0.04 points more pixels within 1 % at most.
        """
        return max(2, self.refine_planes // 2) if self.refine_planes else 0

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values, for checkpoints and manifests."""
        return asdict(self)


PRESETS: dict[str, ModelConfig] = {
    "mvsnet": ModelConfig(
        name="mvsnet", backbone="conv", se=False, loss="smooth", inverse_depth=True, optimizer="adam"
    ),
    "paper": ModelConfig(name="paper", inverse_depth=True, optimizer="adam"),
    "field": ModelConfig(
        name="field",
        loss="plane",
        volume="correlation",
        regularizer="packed",
        feature_channels=16,
        base_channels=16,
        width=32,
        refine_planes=16,
        inverse_depth=True,
    ),
}

PAPER, FIELD = PRESETS["paper"], PRESETS["field"]
PRESETS["cascade"] = replace(FIELD, name="cascade", wide_stride=8)
#: One change each: the ablation of the paper (its Table 8) and ours of what ``field`` does differently.
ABLATIONS: dict[str, ModelConfig] = {
    config.name: config
    for config in (
        replace(PAPER, name="paper-no-bfpn", backbone="conv"),
        replace(PAPER, name="paper-no-se", se=False),
        replace(PAPER, name="paper-no-hybrid", loss="smooth"),
        replace(PAPER, name="paper-plane", loss="plane"),
        replace(FIELD, name="field-conv3d", regularizer="conv3d", width=8),
        replace(FIELD, name="field-no-bfpn", backbone="conv", refine_planes=0),
        replace(FIELD, name="field-no-refine", refine_planes=0),
        replace(FIELD, name="field-no-se", se=False),
        replace(FIELD, name="field-hybrid", loss="hybrid"),
    )
}
CONFIGS = PRESETS | ABLATIONS

"""Between the 192 planes at an eighth of the resolution and the narrow volume at half of it: which surface is it.

A pixel at a quarter of the resolution lies between cells of the wide volume, and at a silhouette the cells round it
hold different surfaces. Its candidates are the planes round what its own cell says, and round the nearest and the
farthest of the nine cells there (the propagation of PatchMatch, Barnes et al. 2009, with two neighbours of nine). Their
correlations at a quarter of the resolution decide.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from training.model.backbone import upsample_like
from training.model.packed import Refiner
from training.model.regression import upsample_index

#: Candidates round each of the three indices, and how far they lie apart, planes of the wide volume. Source: judgement;
#: the wide volume's index is within 1.5 planes of the truth where it has the right surface.
AROUND, STEP = 8, 0.75
#: Candidates of each that are looked up, from the first to the last: what lies between them is interpolated, see
#: :mod:`training.model.between`. Source: numerics; all eight of them bring 0.03
#: points more pixels within 1 % at most (docs/trials-speed.md, "Every other one").
LOOKED_UP = 6
LOOKED_UP_STEP = STEP * (AROUND - 1) / (LOOKED_UP - 1)
#: Candidates of a pixel: round its own index, the nearest and the farthest.
CANDIDATES = 3 * AROUND
#: Channels of what the indices themselves tell: the steps to the nearest and the farthest, and the confidence.
HINTS = 3
#: Difference of two indices that counts as another surface for sure, planes. Source: judgement.
_FAR_APART = 8.0
#: Candidates within this of the best one are of its surface, planes. Source: judgement; two steps.
READ_RADIUS = 1.6


def spread_indices(index_hw: Tensor, height: int, width: int) -> Tensor:
    """Own, least and greatest index (3, height, width) at twice the resolution, from (h, w).

    Own is :func:`training.model.regression.upsample_index`; the others are over the pixel's cell and its eight
    neighbours.
    """

    def doubled(values_hw: Tensor) -> Tensor:
        return values_hw.repeat_interleave(2, dim=0).repeat_interleave(2, dim=1)[:height, :width]

    padded = F.pad(index_hw[None, None], (1, 1, 1, 1), mode="replicate")
    greatest = F.max_pool2d(padded, 3, stride=1)[0, 0]
    least = -F.max_pool2d(-padded, 3, stride=1)[0, 0]
    return torch.stack([upsample_index(index_hw, height, width), doubled(least), doubled(greatest)])


def candidate_planes(centres_3hw: Tensor, around: int = AROUND, step: float = STEP) -> Tensor:
    """(3 ``around``, h, w) plane indices: round the own index, the least and the greatest (:func:`spread_indices`)."""
    offsets = (torch.arange(around, device=centres_3hw.device) - (around - 1) / 2) * step
    return (centres_3hw[:, None] + offsets[None, :, None, None]).flatten(0, 1)


def hints(planes_dhw: Tensor, confidence_hw: Tensor) -> Tensor:
    """(3, H, W) in [0, 1]: how far the least and the greatest candidates lie from the own, and the confidence (h, w).

    The confidence is that of the wide volume, interpolated to the candidates' resolution.
    """
    own, least, greatest = planes_dhw[0], planes_dhw[AROUND], planes_dhw[2 * AROUND]
    steps = torch.stack([own - least, greatest - own]) / _FAR_APART
    sure = upsample_like(confidence_hw[None, None], own)[0]
    return torch.cat([steps.clamp(0, 1), sure])


def read_candidates(scores_dhw: Tensor, planes_dhw: Tensor) -> tuple[Tensor, Tensor]:
    """Plane index (h, w) of the surface of the best candidate, and the probability of its candidates."""
    probability = torch.softmax(scores_dhw, dim=0)
    best = torch.gather(planes_dhw, 0, scores_dhw.detach().argmax(dim=0, keepdim=True))
    inside = probability * ((planes_dhw - best).abs() < READ_RADIUS)
    mass = inside.sum(dim=0)
    return (inside * planes_dhw).sum(dim=0) / (mass + 1e-6), mass


class CandidateHead(nn.Module):
    """Scores of the candidates from the correlations (L*G, h, w) of those that are looked up, the features (C, h, w)
    and the hints (3, h, w).
    """

    def __init__(self, *, groups: int, features: int) -> None:
        super().__init__()
        self.refiner = Refiner(planes=AROUND, looked_up=LOOKED_UP, groups=groups, features=features + HINTS, sets=3)

    def scores(self, volume_chw: Tensor, features_chw: Tensor, hints_chw: Tensor) -> Tensor:
        """(D, h, w)."""
        return torch.as_tensor(self.refiner(volume_chw, torch.cat([features_chw, hints_chw])))

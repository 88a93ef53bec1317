"""The heads as exported against the modules they stand for: same weights, same results."""

from __future__ import annotations

from typing import TypeVar

import pytest
import torch
from torch import nn

from export.fast_heads import (
    FastCandidateHead,
    FastPlaneHead,
    FastRefineHead,
    GatheredMix,
    SubPixels,
    read_best,
    read_peak,
)
from export.graphs import fold_batch_norm
from training.model.candidates import CANDIDATES, LOOKED_UP, CandidateHead, read_candidates
from training.model.config import PRESETS
from training.model.fsmvsnet import PlaneHead, RefineHead
from training.model.packed import DepthMix
from training.model.regression import peak_window

ModuleT = TypeVar("ModuleT", bound=nn.Module)


def _lively(module: ModuleT) -> ModuleT:
    """Weights, biases and batch norm statistics that all matter."""
    torch.manual_seed(0)
    for parameter in module.parameters():
        nn.init.normal_(parameter, std=0.15)
    for layer in module.modules():
        if isinstance(layer, nn.BatchNorm2d):
            assert layer.running_mean is not None
            assert layer.running_var is not None
            nn.init.normal_(layer.running_mean, std=0.3)
            nn.init.uniform_(layer.running_var, 0.5, 2.0)
    return module.eval()


@pytest.mark.parametrize("size", [(16, 24), (17, 23), (9, 8)])
@torch.no_grad()
def test_plane_head_gives_what_the_trained_module_gives(size: tuple[int, int]) -> None:
    head = fold_batch_norm(_lively(PlaneHead(PRESETS["field"])))
    volume = torch.randn(24, 32, *size)
    index, mass = head(volume)
    fast_index, fast_mass = FastPlaneHead(head)(volume)
    assert fast_index.shape == size
    # A tie between planes far apart may fall either way in the last digit.
    assert ((fast_index - index).abs() < 1e-3).float().mean() > 0.99
    assert torch.allclose(fast_mass, mass, atol=1e-4)
    assert mass.std() > 0.01


@torch.no_grad()
def test_refine_head_gives_what_the_trained_module_gives() -> None:
    head = fold_batch_norm(_lively(RefineHead(PRESETS["field"])))
    volume, features = torch.randn(16, 18, 22), torch.randn(8, 18, 22)
    for fast, plain in zip(FastRefineHead(head)(volume, features), head(volume, features), strict=True):
        assert torch.allclose(fast, plain, atol=1e-4)


@torch.no_grad()
def test_candidate_head_gives_what_the_trained_module_gives() -> None:
    head = fold_batch_norm(_lively(CandidateHead(groups=4, features=16)))
    volume, features = torch.randn(3 * LOOKED_UP * 4, 18, 22), torch.randn(16, 18, 22)
    hints, planes = torch.rand(3, 18, 22), 190 * torch.rand(CANDIDATES, 18, 22)
    scores = head.scores(volume, features, hints)
    for fast, plain in zip(
        FastCandidateHead(head)(volume, features, hints, planes), read_candidates(scores, planes), strict=True
    ):
        assert torch.allclose(fast, plain, atol=1e-3, rtol=1e-5)


@torch.no_grad()
def test_the_best_candidates_are_read_as_in_training() -> None:
    torch.manual_seed(4)
    # Far apart and close together; a score of 60 more than others, and all alike.
    planes = 190 * torch.rand(1, 12, 10) + 0.75 * torch.randn(CANDIDATES, 12, 10)
    scores = torch.randn(CANDIDATES, 12, 10) * torch.linspace(0, 60, 10)
    for fast, plain in zip(read_best(scores, planes), read_candidates(scores, planes), strict=True):
        assert torch.allclose(fast, plain, atol=1e-4, rtol=1e-6)


@torch.no_grad()
def test_gathered_slabs_are_the_concatenated_ones() -> None:
    mix = _lively(DepthMix(4))
    slabs = torch.randn(6, 4, 5, 7)
    assert isinstance(mix, DepthMix)
    assert torch.equal(GatheredMix(mix, 6)(slabs), mix(slabs))


@pytest.mark.parametrize("size", [(6, 8), (5, 7)])
@torch.no_grad()
def test_sub_pixels_interleave_to_the_full_resolution_convolution(size: tuple[int, int]) -> None:
    conv = nn.Conv2d(3, 2, 1)
    slabs = torch.randn(4, 3, *size)
    shuffled = nn.functional.pixel_shuffle(SubPixels(conv)(slabs), 2)[..., : size[0], : size[1]]
    assert torch.allclose(shuffled, conv(slabs), atol=1e-6)


def test_peak_is_that_of_the_softmax_even_at_the_ends_and_for_huge_scores() -> None:
    scores = 30 * torch.randn(192, 5, 6) + 500
    scores[0, 0] += 900
    scores[191, 1] += 900
    index, mass = peak_window(torch.softmax(scores, dim=0), 3)
    _, narrow = peak_window(torch.softmax(scores, dim=0), 1)
    fast_index, fast_mass = read_peak(scores, 3, 1)
    assert torch.allclose(fast_index, index, atol=1e-4)
    assert torch.allclose(fast_mass, narrow, atol=1e-5)
    assert torch.allclose(read_peak(scores, 3, 3)[1], mass, atol=1e-5)


def test_other_regularizers_are_refused() -> None:
    with pytest.raises(TypeError, match="packed"):
        FastPlaneHead(PlaneHead(PRESETS["paper"]))

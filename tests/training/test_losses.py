"""The terms of the losses, each by outputs whose error is known in planes."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from training.losses import compute_loss, cross_entropy_two_bins, target_index
from training.model import PRESETS
from training.model.fsmvsnet import DepthOutput, ScaleOutput
from training.model.volume import plane_inverse_depths

NEAR, FAR, PLANES = 1.0, 9.0, 192
PAPER, FIELD = PRESETS["paper"], PRESETS["field"]


def truth_of(height: int = 32, width: int = 48) -> torch.Tensor:
    """A slanted surface without a step."""
    return 3.0 + 0.002 * torch.arange(width).float()[None] + 0.001 * torch.arange(height).float()[:, None]


def scale_of(truth: torch.Tensor, stride: int, off: float | torch.Tensor, *, inverse: bool) -> ScaleOutput:
    """An output at a stride whose index is ``off`` planes beside the truth."""
    step = max(1, stride // 4)
    planes = plane_inverse_depths(torch.tensor(NEAR), torch.tensor(FAR), PLANES, inverse=inverse)[::step, None, None]
    index, mask = target_index(truth[::stride, ::stride], planes)
    assert bool(mask.all())
    scores = -((torch.arange(len(planes))[:, None, None] - index[None]) ** 2)
    return ScaleOutput(stride=stride, scores_dhw=scores, index_hw=index + off, inverse_depth_dhw=planes)


def output_of(scales: list[ScaleOutput]) -> DepthOutput:
    finest = scales[-1].index_hw
    return DepthOutput(depth=finest, confidence=torch.ones_like(finest), stride=scales[-1].stride, scales=tuple(scales))


def paper_loss(off: dict[int, float], truth: torch.Tensor) -> tuple[float, dict[str, float]]:
    """Of outputs whose index is beside the truth by so many planes, by stride."""
    output = output_of([scale_of(truth, stride, off[stride], inverse=False) for stride in (16, 8, 4)])
    total, parts = compute_loss(output, truth, None, PAPER)
    return float(total), parts


def huber(off: float) -> float:
    return float(F.smooth_l1_loss(torch.tensor(off), torch.tensor(0.0)))


def test_the_multi_scale_term_counts_half() -> None:
    # The finest map is exact: of the three terms the multi-scale one alone is left.
    total, parts = paper_loss({16: 2.0, 8: 3.0, 4: 0.0}, truth_of())
    assert parts["smooth"] == pytest.approx(0.0, abs=1e-4)
    assert parts["attention"] == pytest.approx(0.0, abs=1e-4)
    assert parts["multiscale"] > 0.5
    assert total == pytest.approx(0.5 * parts["multiscale"], rel=1e-3)


@pytest.mark.parametrize("off", [0.4, -2.0, 3.0])
def test_the_depth_itself_counts_once(off: float) -> None:
    total, parts = paper_loss({16: 0.0, 8: 0.0, 4: off}, truth_of())
    assert parts["smooth"] == pytest.approx(huber(off), rel=1e-3)
    assert total == pytest.approx(parts["smooth"] + 0.5 * parts["multiscale"] + 0.2 * parts["attention"], rel=1e-5)
    alone = output_of([scale_of(truth_of(), 4, off, inverse=False)])
    assert float(compute_loss(alone, truth_of(), None, PRESETS["mvsnet"])[0]) == pytest.approx(huber(off), rel=1e-3)


def test_pixels_without_truth_do_not_count() -> None:
    truth = truth_of()
    whole, _ = paper_loss({16: 1.0, 8: 1.0, 4: 2.0}, truth)
    output = output_of([scale_of(truth, stride, off, inverse=False) for stride, off in ((16, 1.0), (8, 1.0), (4, 2.0))])
    holes = truth.clone()
    holes[:, 24:] = 0
    holes[:8] = 30.0  # beyond the planes
    assert float(compute_loss(output, holes, None, replace(PAPER, lambda_attention=0.0))[0]) == pytest.approx(
        float(compute_loss(output, truth, None, replace(PAPER, lambda_attention=0.0))[0]), rel=1e-3
    )
    assert whole > 0
    nothing = compute_loss(output, torch.zeros_like(truth), None, PAPER)[0]
    assert float(nothing) == 0.0


def test_a_window_is_compared_with_its_own_part_of_the_truth() -> None:
    truth = truth_of(64, 96) + 0.5 * (torch.arange(96) >= 48)
    part = truth[4 * 4 : 4 * 4 + 4 * 6, 8 * 4 : 8 * 4 + 4 * 10]
    output = output_of([scale_of(part, stride, 0.0, inverse=False) for stride in (8, 4)])
    assert float(compute_loss(output, truth, (8, 4, 10, 6), PAPER)[0]) == pytest.approx(0.0, abs=1e-3)
    assert float(compute_loss(output, truth, (12, 4, 10, 6), PAPER)[0]) > 0.1


@pytest.mark.parametrize("corner", [(0, 0), (2, 0), (0, 2), (6, 10)])
def test_a_window_may_begin_between_the_pixels_of_a_coarse_scale(corner: tuple[int, int]) -> None:
    # Windows begin at even pixels of a quarter, those of the coarsest scale are four of them apart.
    x, y = corner
    truth = truth_of(96, 128)
    part = truth[4 * y : 4 * y + 32, 4 * x : 4 * x + 48]
    output = output_of([scale_of(part, stride, 0.0, inverse=True) for stride in (16, 8, 4)])
    for config in (PAPER, replace(PAPER, loss="plane")):
        exact = compute_loss(output, part, None, config)[1]
        windowed = compute_loss(output, truth, (x, y, 12, 8), config)[1]
        assert windowed == pytest.approx(exact, abs=1e-3)


def test_the_loss_of_field_adds_both_scales_and_stops_where_classes_decide() -> None:
    truth = truth_of()

    def parts_of(off: float) -> tuple[float, dict[str, float]]:
        output = output_of([scale_of(truth, 4, off, inverse=True), scale_of(truth, 2, 0.5 * off, inverse=True)])
        total, parts = compute_loss(output, truth, None, FIELD)
        return float(total), parts

    total, parts = parts_of(1.0)
    assert parts["sub4"] == pytest.approx(1.0, rel=1e-3)
    assert parts["sub2"] == pytest.approx(0.5, rel=1e-3)
    assert total == pytest.approx(sum(parts.values()), rel=1e-4)
    assert parts_of(2.9)[1]["sub4"] == pytest.approx(2.9, rel=1e-3)
    assert parts_of(3.1)[1]["sub4"] == 0.0


def test_cross_entropy_is_the_split_labels_at_every_pixel_with_truth() -> None:
    scores = torch.randn(10, 2, 2, generator=torch.Generator().manual_seed(0))
    index = torch.tensor([[4.25, 9.0], [0.0, 70.0]])  # the last one is unknown: no plane has it
    mask = torch.tensor([[True, True], [True, False]])
    log = torch.log_softmax(scores, dim=0)
    expected = -(0.75 * log[4, 0, 0] + 0.25 * log[5, 0, 0] + log[9, 0, 1] + log[0, 1, 0]) / 3
    assert float(cross_entropy_two_bins(scores, index, mask)) == pytest.approx(float(expected), rel=1e-5)
    assert float(cross_entropy_two_bins(scores, index, torch.zeros_like(mask))) == 0.0


@pytest.mark.parametrize("inverse", [True, False])
def test_the_index_of_a_depth_lies_between_those_of_its_planes(inverse: bool) -> None:
    planes = plane_inverse_depths(torch.tensor(2.0), torch.tensor(8.0), 16, inverse=inverse)[:, None, None]
    flat = planes[:, 0, 0]
    middle = (flat[3] + flat[4]) / 2 if inverse else 1 / ((1 / flat[3] + 1 / flat[4]) / 2)
    index, mask = target_index((1 / middle).reshape(1, 1), planes)
    assert float(index) == pytest.approx(3.5, abs=1e-3)
    assert bool(mask)
    outside = torch.tensor([[1.99, 8.01, 0.0, -1.0, 2.01, 7.99]])
    assert target_index(outside, planes)[1].tolist() == [[False, False, False, False, True, True]]

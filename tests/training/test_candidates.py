"""Candidates of the cascade: what is read off them, what they are taught, and a stem that cells beside it found."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from fsinfer.errors import ModelError
from training.losses import cross_entropy_candidates
from training.model import PRESETS, FSMVSNet
from training.model.candidates import CANDIDATES, candidate_planes, read_candidates, spread_indices
from training.train import Trainer
from training.train_settings import TrainSettings


def planes_of(own: float, least: float, greatest: float) -> torch.Tensor:
    """(K, 1, 1) candidates of a pixel whose cell and the cells round it say this."""
    index = torch.tensor([[own, least], [greatest, own]], dtype=torch.float32)
    return candidate_planes(spread_indices(index, 4, 4))[:, :1, :1]


def test_what_is_read_lies_on_one_surface() -> None:
    planes = planes_of(20, 5, 90)
    truth = 90.4
    near = (planes - truth).abs() < 0.8
    # Nearly as much speaks for the surface behind: a mean over all would lie between the two.
    scores = torch.where(near, 5.0, torch.where((planes - 20).abs() < 0.8, 4.5, 0.0))
    index, mass = read_candidates(scores, planes)
    assert float(index) == pytest.approx(truth, abs=0.3)
    assert 0.4 < float(mass) < 0.7


def test_candidates_of_one_plane_count_together() -> None:
    # Where all nine cells agree, each plane has three candidates.
    planes = planes_of(30, 30, 30)
    scores = torch.where((planes - 30.375).abs() < 0.01, 10.0, 0.0)
    index, mass = read_candidates(scores, planes)
    assert float(index) == pytest.approx(30.375, abs=0.01)
    assert float(mass) > 0.99


def test_the_label_is_shared_by_the_candidates_near_the_truth() -> None:
    planes = planes_of(30, 30, 90)
    known = torch.ones(1, 1, dtype=torch.bool)
    away = (planes - 30.1).abs()
    share = (1 - away).clamp_min(0)
    best = torch.log((share / share.sum(dim=0)).clamp_min(1e-9))
    least, mask = cross_entropy_candidates(best, away, known)
    assert bool(mask.all())
    for other in (best + torch.randn(CANDIDATES, 1, 1), torch.zeros(CANDIDATES, 1, 1)):
        assert float(cross_entropy_candidates(other, away, known)[0]) > float(least)
    # A surface that no cell knows teaches nothing.
    loss, mask = cross_entropy_candidates(torch.randn(CANDIDATES, 1, 1), (planes - 60).abs(), known)
    assert not bool(mask.any())
    assert float(loss) == 0


def test_a_network_with_candidates_begins_with_the_weights_of_one_without(tmp_path: Path) -> None:
    def trainer(preset: str, name: str, init: Path | None = None) -> Trainer:
        return Trainer(TrainSettings(data=(tmp_path,), out=tmp_path / name, preset=preset, init=init))

    field = trainer("field", "field")
    with torch.no_grad():
        for parameter in field.average.module.parameters():
            parameter.add_(0.25)
    field.save()
    begun = trainer("cascade", "cascade", field.checkpoint)
    for name, value in field.average.module.state_dict().items():
        torch.testing.assert_close(begun.model.state_dict()[name], value)
        torch.testing.assert_close(begun.average.module.state_dict()[name], value)
    # The other way round something would be lost; a network of another kind, or one that lacks more, has too little.
    begun.save()
    wrong = [("field", begun.checkpoint)]
    for preset, other in (("cascade", "paper"), ("field", "field-no-refine")):
        given = trainer(other, other)
        given.save()
        wrong.append((preset, given.checkpoint))
    for number, (preset, init) in enumerate(wrong):
        with pytest.raises(ModelError, match="does not fit"):
            trainer(preset, f"again-{number}", init)


def test_the_volume_at_an_eighth_looks_at_every_second_feature() -> None:
    torch.manual_seed(0)
    model = FSMVSNet(PRESETS["cascade"]).eval()
    images = torch.rand(2, 3, 64, 96) * 255
    intrinsics = torch.tensor([[90.0, 0, 47.5], [0, 90.0, 31.5], [0, 0, 1]]).repeat(2, 1, 1)
    poses = torch.eye(4).repeat(2, 1, 1)
    poses[1, 0, 3] = -0.2
    with torch.no_grad():
        output = model(images, intrinsics, poses, (1.0, 9.0))
    assert [scale.stride for scale in output.scales] == [8, 4, 2]
    assert output.scales[0].scores_dhw.shape == (192, 8, 12)
    assert output.scales[1].scores_dhw.shape == (CANDIDATES, 16, 24)
    assert output.depth.shape == (32, 48)

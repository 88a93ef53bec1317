"""FS-MVSNet in PyTorch: shapes of all presets, warping against the deployed NumPy path, losses that fall."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

from fsinfer.depth.cost_volume import Features, upsample_index, variance_volume
from fsinfer.depth.cost_volume import plane_inverse_depths as numpy_planes
from fsinfer.depth.plane_volume import plane_correlation_volume
from fsinfer.depth.warping import relative_projection as numpy_projection
from training.losses import compute_loss, cross_entropy_two_bins, edge_attention, target_index
from training.model import CONFIGS, PRESETS, DepthOutput, FSMVSNet, regression
from training.model.attention import SqueezeExcitation
from training.model.backbone import BFPN
from training.model.config import DEPTH_PLANES
from training.model.fsmvsnet import PlaneHead, ScaleOutput, Window
from training.model.packed import pack, with_neighbours
from training.model.regression import peak_window, soft_argmin
from training.model.regularizer3d import Regularizer3D, upsample_voxels_like
from training.model.volume import GroupCorrelation, correlation, plane_inverse_depths
from training.model.volume import correlation_volume as torch_correlation
from training.model.volume import variance_volume as torch_variance
from training.model.warping import project, relative_projection, sample


def views(count: int = 3, height: int = 64, width: int = 96) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(count, 3, height, width, generator=generator) * 255
    intrinsics = torch.tensor([[90.0, 0, 48], [0, 90, 32], [0, 0, 1]]).repeat(count, 1, 1)
    poses = torch.eye(4).repeat(count, 1, 1)
    poses[:, 0, 3] = torch.arange(count) * 0.2
    poses[:, 2, 3] = torch.arange(count) * 0.05
    return images, intrinsics, poses


@pytest.mark.parametrize(("preset", "stride"), [("mvsnet", 4), ("paper", 4), ("field", 2), ("cascade", 2)])
def test_presets_forward_and_learn(preset: str, stride: int) -> None:
    torch.manual_seed(0)
    model = FSMVSNet(PRESETS[preset])
    images, intrinsics, poses = views()
    window = Window(x=4, y=2, width=16, height=12)
    truth = torch.full((64, 96), 3.0)
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    losses = []
    for _ in range(4):
        output = model(images, intrinsics, poses, (1.0, 9.0), window)
        loss, parts = compute_loss(output, truth, (4, 2, 16, 12), model.config)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        # Candidates say nothing while no cell of the wide volume is near the truth: their loss grows before it falls.
        losses.append(parts.get("ce8", float(loss.detach())))
    assert output.stride == stride
    assert output.depth.shape == (12 * 4 // stride, 16 * 4 // stride)
    assert output.scales[-1].stride == stride
    assert bool(((output.depth > 0.9) & (output.depth < 10)).all())
    assert bool(((output.confidence >= 0) & (output.confidence <= 1.001)).all())
    assert losses[-1] < losses[0]
    # The plain baseline takes no loss at the coarser scales: their heads are the only parameters without a gradient.
    idle = ("heads.1", "heads.2") if model.config.loss == "smooth" else ()
    for name, parameter in model.named_parameters():
        if not any(part in name for part in idle):
            assert parameter.grad is not None, name
            assert torch.isfinite(parameter.grad).all(), name


def test_ablation_switches_change_the_network() -> None:
    paper = PRESETS["paper"]
    configs = {
        "full": paper,
        "no_bfpn": dataclasses.replace(paper, backbone="conv"),
        "no_se": dataclasses.replace(paper, se=False),
    }
    kinds = {name: {type(m).__name__ for m in FSMVSNet(config).modules()} for name, config in configs.items()}
    assert {"BFPN", "SqueezeExcitation"} <= kinds["full"]
    assert "BFPN" not in kinds["no_bfpn"]
    assert "SqueezeExcitation" not in kinds["no_se"]


def test_paper_has_multi_scale_heads_and_192_planes() -> None:
    model = FSMVSNet(PRESETS["paper"]).eval()
    with torch.no_grad():
        output = model(*views(), (1.0, 9.0))
    assert [(s.stride, s.scores_dhw.shape[0]) for s in output.scales] == [(16, 48), (8, 96), (4, 192)]


def test_pyramid_keeps_pixels_in_place() -> None:
    pyramid = BFPN(base=8, channels=8, refine_channels=8).eval()
    with torch.no_grad():
        # Even kernels: the answer to one bright pixel is then symmetric about the place where that pixel is kept.
        for name, parameter in pyramid.named_parameters():
            if parameter.dim() == 4:
                parameter.fill_(1 / parameter[0].numel())
            elif "bias" in name:
                parameter.zero_()
        image = torch.zeros(1, 3, 1024, 1024)  # wide enough that no border is felt
        base = pyramid(image)
        image[..., 512, 512] = 1000.0
        moved = pyramid(image)
    for level, stride in zip(range(2), (4, 2), strict=True):
        change = (moved[level] - base[level]).abs().sum(dim=(0, 1))
        where = torch.arange(change.shape[0], dtype=torch.float32)
        centre = [float((change.sum(dim=1 - axis) * where).sum() / change.sum()) for axis in (0, 1)]
        assert centre == pytest.approx([512 / stride] * 2, abs=0.02)


@pytest.mark.parametrize("preset", ["mvsnet", "paper", "field"])
@pytest.mark.parametrize("plane", [0, 77, 191])
def test_a_volume_with_one_good_plane_gives_the_depth_of_that_plane(
    preset: str, plane: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = dataclasses.replace(PRESETS[preset], refine_planes=0)
    model = FSMVSNet(config).eval()
    scores = torch.zeros(192, 16, 24)
    scores[plane] = 60.0
    monkeypatch.setattr(model.plane_head, "scores", lambda _: [scores])
    with torch.no_grad():
        output = model(*views(), (1.0, 9.0))
    near_to_far = np.linspace(1.0, 9.0, 192)[plane]
    expected = 1 / np.linspace(1 / 9.0, 1.0, 192)[plane] if config.inverse_depth else near_to_far
    np.testing.assert_allclose(output.depth.numpy(), expected, rtol=2e-4)
    np.testing.assert_allclose(output.confidence.numpy(), 1.0, atol=1e-4)


def test_soft_argmin_of_the_paper_is_the_mean_over_the_planes() -> None:
    model = FSMVSNet(PRESETS["paper"])
    scores = torch.full((192, 1, 1), -60.0)
    scores[10], scores[40] = np.log(3.0), 0.0
    index, _ = model.plane_head.read(scores)
    assert float(index) == pytest.approx(0.75 * 10 + 0.25 * 40, abs=1e-3)


def test_the_pyramid_hands_what_is_fine_on_to_what_is_coarse() -> None:
    """Bottom-up: each of the three steps adds to the next coarser level, and reaches the features."""
    torch.manual_seed(0)
    pyramid = BFPN(base=8, channels=8, refine_channels=0).eval()
    image = torch.rand(1, 3, 64, 64)
    levels: dict[int, torch.Tensor] = {}
    for number, after in enumerate(pyramid.after_bottom_up):
        after.register_forward_pre_hook(lambda _module, given, number=number: levels.update({number: given[0]}))
    with torch.no_grad():
        sound, _ = pyramid(image)
        before = dict(levels)
        for number, down in enumerate(pyramid.down):
            kept = {name: value.clone() for name, value in down.state_dict().items()}
            for parameter in down.parameters():
                parameter.zero_()
            without, _ = pyramid(image)
            down.load_state_dict(kept)
            assert not torch.allclose(without, sound, atol=1e-6), number
            assert not torch.allclose(levels[number], before[number], atol=1e-6), number
            # What the level has of its own stays: the step adds, it does not replace.
            assert float(levels[number].abs().max()) > 0, number


def test_volumes_equal_the_deployed_numpy_volumes() -> None:
    _, intrinsics, poses = views()
    torch.manual_seed(1)
    maps = torch.randn(3, 8, 16, 24)
    inverse = plane_inverse_depths(torch.tensor(1.0), torch.tensor(9.0), 12, inverse=True)[:, None, None]
    hypotheses = inverse.expand(-1, 16, 24)
    a, b = relative_projection(intrinsics, poses, 4)
    k, p = intrinsics.double().numpy(), poses.double().numpy()
    projections = [numpy_projection(k[0], p[0], k[i], p[i], 4) for i in (1, 2)]
    features = [Features.from_chw(m.numpy()) for m in maps]
    planes = inverse.numpy()
    torch_volume, torch_weights = torch_correlation(maps[0], list(maps[1:]), a, b, hypotheses, (0, 0), 2)
    volume, weights = plane_correlation_volume(features[0], features[1:], projections, planes[:, 0, 0])
    np.testing.assert_allclose(volume, torch_volume.numpy(), atol=3e-5)
    np.testing.assert_allclose(weights, torch_weights.numpy(), atol=3e-5)
    expected = torch_variance(maps[0], list(maps[1:]), a, b, hypotheses, (0, 0)).numpy()
    np.testing.assert_allclose(variance_volume(features[0], features[1:], projections, planes), expected, atol=3e-5)


@pytest.mark.parametrize("chunk_bytes", [1, 2**30])
def test_chunked_correlation_equals_the_plain_one_with_its_gradients(
    chunk_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.model.volume.CHUNK_BYTES", chunk_bytes)
    _, intrinsics, poses = views()
    torch.manual_seed(4)
    reference = torch.randn(8, 16, 24, requires_grad=True)
    source = torch.randn(8, 16, 24, requires_grad=True)
    inverse = plane_inverse_depths(torch.tensor(1.0), torch.tensor(9.0), 12, inverse=True)[:, None, None]
    a, b = relative_projection(intrinsics, poses, 4)
    x, y = project(a[0], b[0], inverse.expand(-1, 16, 24), (0, 0))
    plain = correlation(reference, sample(source, x, y).reshape(8, 12, 16, 24), 2)
    toward = torch.randn_like(plain)
    expected = torch.autograd.grad((plain * toward).sum(), (reference, source))
    chunked = GroupCorrelation.apply(reference, source, x, y, 2)  # type: ignore[no-untyped-call]
    found = torch.autograd.grad((chunked * toward).sum(), (reference, source))
    torch.testing.assert_close(chunked, plain, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("chunk_bytes", [1, 2**30])
def test_chunked_variance_equals_its_definition_with_its_gradients(
    chunk_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.model.volume.CHUNK_BYTES", chunk_bytes)
    _, intrinsics, poses = views()
    torch.manual_seed(5)
    maps = [torch.randn(8, 16, 24, requires_grad=True) for _ in range(3)]
    inverse = plane_inverse_depths(torch.tensor(1.0), torch.tensor(9.0), 12, inverse=True)[:, None, None]
    planes = inverse.expand(-1, 16, 24)
    a, b = relative_projection(intrinsics, poses, 4)
    warped = [sample(maps[i + 1], *project(a[i], b[i], planes, (0, 0))).reshape(8, 12, 16, 24) for i in range(2)]
    plain = torch.stack([maps[0][:, None].expand(-1, 12, -1, -1), *warped]).var(dim=0, unbiased=False)
    toward = torch.randn_like(plain)
    expected = torch.autograd.grad((plain * toward).sum(), maps)
    chunked = torch_variance(maps[0], maps[1:], a, b, planes, (0, 0))
    found = torch.autograd.grad((chunked * toward).sum(), maps)
    torch.testing.assert_close(chunked, plain, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("preset", ["paper", "field", "cascade"])
def test_fewer_planes_span_the_same_depths(preset: str) -> None:
    model = FSMVSNet(PRESETS[preset]).eval()
    images, intrinsics, poses = views()
    with torch.no_grad():
        output = model(images, intrinsics, poses, (1.0, 9.0), planes=48)
    wide = output.scales[-1 if preset == "paper" else 0]
    assert wide.scores_dhw.shape[0] == 48
    ends = sorted(1 / float(wide.inverse_depth_dhw[i].mean()) for i in (0, -1))
    assert ends == pytest.approx([1.0, 9.0])
    # The depth is the index's place between the ends, whatever the number of planes.
    if preset == "paper":
        torch.testing.assert_close(output.depth, 1 / (1 / 9 + wide.index_hw / 47 * (1 - 1 / 9)))


@pytest.mark.parametrize("inverse", [True, False])
def test_planes_go_from_one_end_of_the_depths_to_the_other_in_equal_steps(inverse: bool) -> None:
    planes = plane_inverse_depths(torch.tensor(2.0), torch.tensor(8.0), 7, inverse=inverse)
    values = planes if inverse else 1 / planes
    assert values[[0, -1]].tolist() == pytest.approx([1 / 8, 1 / 2] if inverse else [2.0, 8.0])
    torch.testing.assert_close(values.diff(), values.diff()[:1].expand(6))
    deployed = numpy_planes(2.0, 8.0, 7, inverse=inverse)
    np.testing.assert_allclose(planes.numpy(), deployed, rtol=1e-6)


def test_a_window_is_a_cut_of_the_whole_volume() -> None:
    _, intrinsics, poses = views()
    torch.manual_seed(2)
    maps = torch.randn(3, 8, 16, 24)
    inverse = plane_inverse_depths(torch.tensor(1.0), torch.tensor(9.0), 12, inverse=True)[:, None, None]
    a, b = relative_projection(intrinsics, poses, 4)
    whole = torch_variance(maps[0], list(maps[1:]), a, b, inverse.expand(-1, 16, 24), (0, 0))
    part = torch_variance(maps[0][:, 4:9, 6:13], list(maps[1:]), a, b, inverse.expand(-1, 5, 7), (6, 4))
    torch.testing.assert_close(part, whole[:, :, 4:9, 6:13], atol=1e-5, rtol=1e-5)


def test_upsampled_index_equals_the_deployed_one() -> None:
    index = torch.rand(9, 13) * 20
    np.testing.assert_allclose(
        regression.upsample_index(index, 17, 26).numpy(), upsample_index(index.numpy(), 17, 26), atol=1e-5
    )


def test_squeeze_excitation_over_slabs_is_one_volume() -> None:
    torch.manual_seed(0)
    se = SqueezeExcitation(32)
    slabs = torch.randn(6, 32, 5, 7)
    volume = slabs.transpose(0, 1)[None]
    torch.testing.assert_close(se.over_slabs(slabs), se(volume)[0].transpose(0, 1))


def test_squeeze_excitation_hears_channels_below_zero_and_hides_what_the_hidden_layer_has_below_zero() -> None:
    torch.manual_seed(0)
    se = SqueezeExcitation(32)
    means = torch.zeros(2, 32, 1, 1, 1)
    means[0, 0], means[1, 0] = -1.0, -2.0
    with torch.no_grad():
        shares = [se(means + one) / (means + one) for one in (3.0, -3.0)]
        assert not torch.allclose(shares[1][0], shares[1][1], atol=1e-4)  # both below zero, and not the same
        first = se.fc[0]
        assert isinstance(first, torch.nn.Linear)
        first.weight.fill_(0.02)
        first.bias.fill_(0.0)
        # All hidden values are the sum over the channels: below zero they say nothing, above zero they do.
        below, above = (se(torch.full((1, 32, 1, 1, 1), value)) / value for value in (-1.0, 1.0))
        torch.testing.assert_close(below, se(torch.full((1, 32, 1, 1, 1), -5.0)) / -5.0)
        assert not torch.allclose(above, below, atol=1e-3)
        assert float(above.min()) > 0.0
        assert float(above.max()) < 1.0


def test_packing_and_neighbours() -> None:
    volume = torch.arange(16.0).reshape(8, 2, 1, 1)
    slabs = pack(volume, 4)
    assert slabs.flatten(1).tolist() == [list(range(8)), list(range(8, 16))]
    mixed = with_neighbours(slabs)
    assert mixed[0].flatten().tolist() == [*range(8), *range(8), *range(8, 16)]


def test_soft_argmin_blurs_two_peaks_and_the_window_does_not() -> None:
    probability = torch.zeros(20, 1, 1)
    probability[4], probability[5], probability[15] = 0.3, 0.3, 0.4
    probability[3] = 0.0
    index, mass = peak_window(probability, 1)
    assert float(index) == pytest.approx(15, abs=1e-3)
    assert float(mass) == pytest.approx(0.4, abs=1e-5)
    assert float(soft_argmin(probability, torch.arange(20.0))) == pytest.approx(8.7, abs=1e-4)


@pytest.mark.parametrize("inverse", [True, False])
def test_target_index_of_a_plane_is_its_number(inverse: bool) -> None:
    planes = plane_inverse_depths(torch.tensor(2.0), torch.tensor(8.0), 192, inverse=inverse)[:, None, None]
    truth = (1 / planes[[0, 77, 191]]).reshape(1, 3)
    index, mask = target_index(torch.cat([truth, torch.tensor([[0.0, 20.0, 1.0]])]), planes)
    torch.testing.assert_close(index[0], torch.tensor([0.0, 77, 191]), atol=0.02, rtol=0)
    assert mask[1].tolist() == [False, False, False]


def test_cross_entropy_is_least_at_the_split_label() -> None:
    index = torch.tensor([[4.25]])
    label = torch.zeros(10, 1, 1)
    label[4], label[5] = 0.75, 0.25
    best = cross_entropy_two_bins((label + 1e-9).log(), index, torch.tensor([[True]]))
    entropy = -(0.75 * np.log(0.75) + 0.25 * np.log(0.25))
    assert float(best) == pytest.approx(entropy, abs=1e-3)
    shifted = cross_entropy_two_bins((label.roll(1, 0) + 1e-9).log(), index, torch.tensor([[True]]))
    assert float(shifted) > float(best) + 1


def test_attention_is_between_0_on_walls_and_1_at_edges() -> None:
    truth = torch.full((6, 8), 2.0)
    truth[:, 4:] = 4.0
    truth[:, 6:] = 4.1  # a step of 2.5 %
    attention = edge_attention(truth)
    assert float(attention[2, 3]) == pytest.approx(1.0)
    assert float(attention[2, 1]) == 0.0
    assert float(attention[2, 5]) == pytest.approx(0.5, rel=1e-3)
    assert 0 <= float(attention.min()) <= float(attention.max()) <= 1


def test_attention_does_not_look_at_unknown_depth() -> None:
    truth = torch.full((6, 8), 2.0)
    truth[2:4, 3:5] = 0.0
    assert float(edge_attention(truth).max()) == 0.0


def _scale(stride: int, error_planes: float) -> ScaleOutput:
    """A scale of 16 / stride pixels a side that is off by so many of its planes everywhere; the truth is 3."""
    planes = 4 * DEPTH_PLANES // stride
    inverse = plane_inverse_depths(torch.tensor(1.0), torch.tensor(9.0), planes, inverse=False)[:, None, None]
    size = 16 // stride
    truth, _ = target_index(torch.full((size, size), 3.0), inverse)
    return ScaleOutput(
        stride=stride,
        scores_dhw=torch.zeros(planes, size, size),
        index_hw=truth + error_planes,
        inverse_depth_dhw=inverse,
    )


@pytest.mark.parametrize(("first_scale", "weights"), [("coarsest", (1, 0.5, 0.25)), ("finest", (0.25, 0.5, 1))])
def test_the_hybrid_loss_is_that_of_the_paper(first_scale: Any, weights: tuple[float, ...]) -> None:
    config = dataclasses.replace(PRESETS["paper"], first_scale=first_scale)
    # Smooth L1 of an error of e planes is e - 0.5 from 1 on.
    scales = (_scale(16, 11.5), _scale(8, 5.5), _scale(4, 2.5))
    output = DepthOutput(depth=torch.zeros(4, 4), confidence=torch.zeros(4, 4), stride=4, scales=scales)
    truth = torch.full((16, 16), 3.0)
    total, parts = compute_loss(output, truth, None, config)
    multiscale = weights[0] * 11 + weights[1] * 5 + weights[2] * 2
    assert parts == pytest.approx({"smooth": 2, "multiscale": multiscale, "attention": 0}, rel=1e-3)
    assert float(total) == pytest.approx(1.0 * 2 + 0.5 * multiscale, rel=1e-3)
    truth = truth.clone()
    truth[:, 12:] = 3.2  # an edge: the third term is there
    moved, parts = compute_loss(output, truth, None, config)
    assert parts["attention"] > 0.2 * parts["smooth"]
    expected = parts["smooth"] + 0.5 * parts["multiscale"] + 0.2 * parts["attention"]
    assert float(moved) == pytest.approx(expected, rel=1e-5)
    assert PRESETS["paper"].first_scale == "coarsest"


@pytest.mark.parametrize(("channels", "hidden"), [(32, 2), (48, 3), (64, 4), (16, 2), (4, 2)])
def test_squeeze_excitation_reduces_by_16_down_to_its_floor(channels: int, hidden: int) -> None:
    first, second = (layer for layer in SqueezeExcitation(channels).fc if isinstance(layer, torch.nn.Linear))
    assert (first.in_features, first.out_features, second.in_features) == (channels, hidden, hidden)


def test_the_papers_squeeze_excitation_weighs_the_channels_of_the_cost_volume() -> None:
    model = FSMVSNet(PRESETS["paper"]).eval()
    found = [module for module in model.modules() if isinstance(module, SqueezeExcitation)]
    assert len(found) == 1
    seen: list[torch.Size] = []
    found[0].register_forward_hook(lambda _module, inputs, _output: seen.append(inputs[0].shape))
    with torch.no_grad():
        model(*views(), (1.0, 9.0))
    assert seen == [torch.Size([1, 32, 192, 16, 24])]


def test_soft_argmin_of_a_sharp_peak_is_its_plane() -> None:
    for name, plane in (("paper", 0), ("paper", 77), ("mvsnet", 191), ("field", 77)):
        scores = torch.zeros(192, 2, 3)
        scores[plane] = 60.0
        index, confidence = PlaneHead(PRESETS[name]).read(scores)
        torch.testing.assert_close(index, torch.full((2, 3), float(plane)), atol=1e-3, rtol=0)
        torch.testing.assert_close(confidence, torch.ones(2, 3), atol=1e-3, rtol=0)


def test_each_step_of_the_pyramid_up_and_down_carries_something() -> None:
    torch.manual_seed(3)
    pyramid = BFPN(base=8, channels=8, refine_channels=0).eval()
    images = torch.rand(1, 3, 64, 96)
    with torch.no_grad():
        whole, _ = pyramid(images)
        for step in (*pyramid.down, *pyramid.after_bottom_up, *pyramid.after_top_down):
            kept = {name: value.clone() for name, value in step.state_dict().items()}
            for parameter in step.parameters():
                parameter.zero_()
            assert not torch.equal(pyramid(images)[0], whole)
            step.load_state_dict(kept)
        assert torch.equal(pyramid(images)[0], whole)


def _even_regularizer() -> Regularizer3D:
    """All kernels 1, 2, 1 in every direction: no plane's middle moves, wherever the strides fall."""
    regularizer = Regularizer3D(2, 4, se=False).eval()
    along = torch.tensor([0.25, 0.5, 0.25])
    kernel = along[:, None, None] * along[:, None] * along
    with torch.no_grad():
        for name, parameter in regularizer.named_parameters():
            if parameter.dim() == 5:
                parameter.copy_((kernel / parameter.shape[1]).expand_as(parameter))
            elif "bias" in name:
                parameter.zero_()
    return regularizer


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_shifted_plane_comes_back_where_it_was(axis: int) -> None:
    regularizer = _even_regularizer()
    # Longer than all that the network sees in one direction; in the others the plane is the same everywhere.
    shape = [2, 2, 2]
    shape[axis] = 192
    with torch.no_grad():
        base = regularizer(torch.zeros(1, 2, *shape))
        for where in (60, 61, 62, 64, 131):  # not about the middle, where errors of both ends cancel
            volume = torch.zeros(1, 2, *shape)
            volume.select(2 + axis, where).fill_(1000.0)
            for level, (scores, before) in enumerate(zip(regularizer(volume), base, strict=True)):
                change = (scores - before)[0]
                profile = change.sum(dim=[other for other in (0, 1, 2) if other != axis])
                centre = float((profile * torch.arange(len(profile))).sum() / profile.sum())
                # Voxel i of a coarse scale is voxel 2^level i of the volume.
                assert 2**level * centre == pytest.approx(where, abs=0.01)


def test_coarse_voxels_go_to_even_ones() -> None:
    coarse = torch.arange(24.0).reshape(1, 1, 2, 3, 4)
    for size in ((4, 6, 8), (3, 5, 7)):
        fine = upsample_voxels_like(coarse, torch.empty(1, 1, *size))
        assert fine.shape[2:] == size
        torch.testing.assert_close(fine[:, :, ::2, ::2, ::2], coarse)
        torch.testing.assert_close(fine[0, 0, 1, 1, 1], coarse[0, 0, :2, :2, :2].mean())


@pytest.mark.parametrize("preset", sorted(CONFIGS))
def test_every_preset_learns_in_16_bits(preset: str) -> None:
    images, intrinsics, poses = views()
    truth = torch.full((64, 96), 3.0)
    ratios = []
    # What an untrained network says hangs on the weights that it happens to have: of one it may differ by a third.
    for seed in range(3):
        torch.manual_seed(seed)
        model = FSMVSNet(CONFIGS[preset])
        found = {}
        for amp in (False, True):
            model.zero_grad()
            with torch.autocast("cpu", dtype=torch.bfloat16, enabled=amp):
                output = model(images, intrinsics, poses, (1.0, 9.0), Window(x=4, y=2, width=16, height=12))
            assert output.depth.dtype == output.scales[0].scores_dhw.dtype == torch.float32
            loss, _ = compute_loss(output, truth, (4, 2, 16, 12), model.config)
            loss.backward()
            found[amp] = float(loss.detach())
            assert all(torch.isfinite(p.grad).all() for p in model.parameters() if p.grad is not None)
        ratios.append(found[True] / found[False])
    assert np.median(ratios) == pytest.approx(1.0, rel=0.1)


@pytest.mark.parametrize("preset", ["mvsnet", "paper", "field", "cascade"])
def test_another_device_has_all_that_it_computes_with(preset: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the device without values a tensor that stays on the processor is an error, as it is on a GPU."""
    monkeypatch.setattr(torch, "autocast", lambda *_args, **_options: contextlib.nullcontext())  # unknown there
    model = FSMVSNet(PRESETS[preset]).to("meta")
    images, intrinsics, poses = views()
    output = model(images.to("meta"), intrinsics, poses, (1.0, 9.0), Window(x=4, y=2, width=16, height=12))
    assert output.depth.device.type == output.scales[0].scores_dhw.device.type == "meta"

"""What the model card says of ``paper`` is what the code does: a deviation that moves must move in the card, too."""

from __future__ import annotations

import re

import pytest

from tests.support.places import ROOT
from training.data.samples import SamplingSettings
from training.losses import EDGE_GRADIENT
from training.model import PRESETS
from training.model.attention import LEAST_HIDDEN, REDUCTION, SqueezeExcitation
from training.model.config import DEPTH_PLANES
from training.train_settings import TrainSettings

PAPER, SAMPLES = PRESETS["paper"], SamplingSettings()
WEIGHTS = (PAPER.lambda_smooth, PAPER.lambda_multiscale, PAPER.lambda_attention)
HIDDEN = SqueezeExcitation(PAPER.feature_channels).fc[0].out_features


@pytest.fixture(scope="module")
def card() -> dict[str, str]:
    """The rows of the table by their first cell, and the words before it."""
    text = (ROOT / "models" / "README.md").read_text(encoding="utf-8")
    (part,) = re.findall(r"### Where `paper` departs from the paper\n(.*?)\n## ", text, flags=re.DOTALL)
    before, _, table = part.partition("| part |")
    rows = {row.split("|")[1].strip(): row for row in table.splitlines() if row.startswith("| ")}
    return {"as published": before} | rows


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("as published", f"{DEPTH_PLANES} planes, {PAPER.volume} over the views, r = {REDUCTION}"),
        ("as published", "the weights {:g}, {:g} and {:g}".format(*WEIGHTS)),
        ("as published", f"{PAPER.optimizer.capitalize()} with 1e-3 and weight decay 1e-5"),
        ("squeeze-and-excitation", f"{PAPER.feature_channels} channels, {HIDDEN} hidden values"),
        ("squeeze-and-excitation", f"The floor of {LEAST_HIDDEN} (`LEAST_HIDDEN`)"),
        ("squeeze-and-excitation", f"below {REDUCTION * LEAST_HIDDEN} channels"),
        ("multi-scale depth", f"with {DEPTH_PLANES}, {DEPTH_PLANES // 2} and {DEPTH_PLANES // 4} planes"),
        ("multi-scale weight", f"{PAPER.lambda_multiscale:g} (`lambda_multiscale`)"),
        ("order of `w_s`", f"s = 1 is the {PAPER.first_scale} scale"),
        ("A_p", f"whole from {EDGE_GRADIENT:.0%} a pixel on, in [0, 1]".replace("%", " %")),
        ("samples", f"{SAMPLES.min_sources} to {SAMPLES.max_sources} random sources"),
        ("samples", f"{SAMPLES.turn:.0%} turned".replace("%", " %")),
        ("samples", f"off by up to {SAMPLES.pose_noise_px:g} px"),
        ("samples", f"drawn in by up to {SAMPLES.near_pull:g} times"),
    ],
)  # fmt: skip
def test_the_card_names_what_the_code_does(card: dict[str, str], row: str, words: str) -> None:
    assert words in " ".join(card[row].split())


def test_training_is_the_papers_where_the_card_says_so() -> None:
    settings = TrainSettings(data=(), out=ROOT)
    assert (settings.learning_rate, settings.weight_decay, SAMPLES.mirror) == (1e-3, 1e-5, 0.5)

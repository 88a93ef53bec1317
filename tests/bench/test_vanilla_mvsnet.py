"""The rival of the speed benchmark computes what our own code does."""

from __future__ import annotations

import pytest
import torch

from tests.bench.speed import make_views
from tests.bench.vanilla_mvsnet import mvsnet, variance_written_out
from training.model import fsmvsnet


def test_both_ways_to_the_volume_give_the_same_depth(monkeypatch: pytest.MonkeyPatch) -> None:
    # So that the function that is put there is taken away again.
    monkeypatch.setattr(fsmvsnet, "variance_volume", vars(fsmvsnet)["variance_volume"])
    threads = torch.get_num_threads()
    views = make_views(3, 64, 96)
    torch.manual_seed(0)
    chunked = mvsnet(views, threads, written_out=False)()
    torch.manual_seed(0)
    plain = mvsnet(views, threads, written_out=True)()
    assert vars(fsmvsnet)["variance_volume"] is variance_written_out
    torch.testing.assert_close(plain.depth, chunked.depth, rtol=1e-4, atol=0)
    assert plain.depth.std() > 0

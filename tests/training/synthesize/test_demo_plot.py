"""The demo's photographs are taken evenly from a rendered plot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.images import read_image, write_image
from fsinfer.io.photo_folders import list_images
from training.synthesize.demo_plot import main


@pytest.fixture
def plot(tmp_path: Path) -> Path:
    for index in range(9):
        write_image(tmp_path / "plot" / "images" / f"{index:08d}.png", np.full((60, 80, 3), 20 * index, np.uint8))
    (tmp_path / "plot" / "truth.csv").write_text("tree_id,x_m,y_m,dbh_cm\n1,0,0,30\n", encoding="utf-8")
    return tmp_path / "plot"


def test_photos_are_even_and_small(plot: Path, tmp_path: Path) -> None:
    out = tmp_path / "demo"
    for _ in range(2):  # a second time replaces the first
        main([str(plot), str(out), "--photos", "5", "--width", "40"])
    photos = [read_image(path) for path in list_images(out / "photos")]
    assert [photo.shape for photo in photos] == [(30, 40, 3)] * 5
    assert [round(float(photo.mean()) / 20) for photo in photos] == [0, 2, 4, 6, 8]
    assert (out / "truth.csv").read_bytes() == (plot / "truth.csv").read_bytes()


def test_too_large_a_demo_is_refused(plot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("training.synthesize.demo_plot.MAX_BYTES", 100)
    with pytest.raises(SystemExit, match="fewer --photos"):
        main([str(plot), str(tmp_path / "demo")])

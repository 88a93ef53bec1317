"""The ablation trains, exports and judges its variants, and does finished ones only once."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import pytest

from tests.bench.ablation import UNFINISHED, main
from tests.support.plane_scene import write_plane_scene
from training.model import ABLATIONS, CONFIGS, PRESETS, FSMVSNet


def test_every_ablation_is_one_change_and_can_be_built() -> None:
    for name, config in ABLATIONS.items():
        base = PRESETS[name.split("-")[0]].to_dict()
        changed = {key for key, value in config.to_dict().items() if base[key] != value} - {"name", "width"}
        assert len(changed) == (2 if name == "field-no-bfpn" else 1), name  # without the pyramid nothing to refine on
        FSMVSNet(config)


def test_a_variant_goes_on_gives_a_row_and_is_not_trained_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_plane_scene(tmp_path / "data" / "a")
    write_plane_scene(tmp_path / "test" / "b", seed=1)
    arguments = ["--data", str(tmp_path / "data"), "--test", str(tmp_path / "test"), "--out", str(tmp_path / "out")]
    arguments += ["--steps", "2", "--crop", "16", "12", "--every", "3", "--variants", "field-no-refine"]
    kept = tmp_path / "out" / "field-no-refine" / "row.json"
    assert main([*arguments, "--stop-after", "0.00001"]) == UNFINISHED
    assert "field-no-refine is not finished" in capsys.readouterr().out
    assert not kept.exists()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own deprecations
        assert main(arguments) == 0
    row = json.loads(kept.read_text())["row"]
    assert row["parameters"] == sum(p.numel() for p in FSMVSNet(CONFIGS["field-no-refine"]).parameters())
    assert row["steps"] == 2
    assert f"| field-no-refine | {row['parameters']:,} |" in capsys.readouterr().out
    before = kept.stat().st_mtime_ns
    assert main(arguments) == 0
    assert kept.stat().st_mtime_ns == before
    # Judged on others it is another row, of the same weights.
    write_plane_scene(tmp_path / "others" / "c", seed=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert main([*arguments, "--test", str(tmp_path / "others")]) == 0
    other = json.loads(kept.read_text())["row"]
    assert other["depth"]["median_abs"] != row["depth"]["median_abs"]
    assert {key: other[key] for key in ("steps", "parameters")} == {key: row[key] for key in ("steps", "parameters")}


def test_a_missing_folder_is_one_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_plane_scene(tmp_path / "data")
    empty = tmp_path / "none"
    arguments = ["--data", str(empty), "--test", str(tmp_path), "--out", str(tmp_path / "out"), "--steps", "1"]
    assert main(arguments) == 2
    assert "Error: " in capsys.readouterr().out

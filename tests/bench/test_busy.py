"""The ratios of the benchmark of a busy machine, and that its ways differ in what they say."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from tests.bench.busy import BY_HAND, depth_seconds, figures_of


def test_installed_is_held_against_the_best_environment_and_the_hog_against_installed() -> None:
    taken = {"installed": [13.0, 10.0, 12.0], "one_blas_thread": [12.5, 14.0, 8.0], "hog": [21.0, 40.0, 30.0]}
    figures = figures_of(taken)
    assert figures["installed_to_best"] == pytest.approx(1.25)
    assert figures["hog_ratio"] == pytest.approx(2.1)
    assert (figures["installed_s"], figures["installed_most_s"]) == (10, 13)
    assert figures_of({"installed": [7.0], "one_blas_thread": [8.0], "hog": [7.0]})["installed_to_best"] == 1


def test_one_lucky_run_of_another_way_does_not_move_the_ratio_of_the_medians() -> None:
    quiet = {"installed": [10.0, 10.2, 10.1], "one_blas_thread": [10.1, 10.2, 10.3], "hog": [13.0, 13.0, 13.0]}
    lucky = quiet | {"one_blas_thread": [10.1, 8.0, 10.3]}
    assert figures_of(quiet)["medians_to_best"] == figures_of(lucky)["medians_to_best"] == 1
    assert figures_of(lucky)["installed_to_best"] == pytest.approx(1.25)
    slow = quiet | {"installed": [11.0, 12.0, 11.5]}
    assert figures_of(slow)["medians_to_best"] == pytest.approx(11.5 / 10.2)


def test_a_run_gets_its_variables_and_no_developers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[dict[str, str]] = []

    def run(command: list[str], *, env: dict[str, str], check: bool) -> None:
        assert check
        assert Path(command[0]).parent == Path(sys.executable).parent
        assert command[1:4] == ["depth", str(tmp_path / "scene"), str(tmp_path / "out")]
        seen.append(env)

    monkeypatch.setattr("tests.bench.busy.subprocess.run", run)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    for variables in ({}, *BY_HAND.values()):
        depth_seconds(tmp_path / "scene", tmp_path / "out", variables, hogs=0)
    assert "OPENBLAS_NUM_THREADS" not in seen[0]
    assert [env["OPENBLAS_NUM_THREADS"] for env in seen[1:]] == [v["OPENBLAS_NUM_THREADS"] for v in BY_HAND.values()]
    assert len({json.dumps(env, sort_keys=True) for env in seen}) == len(seen)

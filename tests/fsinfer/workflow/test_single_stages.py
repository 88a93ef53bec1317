"""Which scale a cloud file of its own gets, and what that does to the unit in plot.json."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsinfer.output.plot_json import read_plot
from fsinfer.scale.find import FoundScale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import Scale
from fsinfer.workflow import measure_cloud
from fsinfer.workflow.summary import update_plot
from tests.support.synthetic_plot import write_scene_folder


@pytest.mark.parametrize(("cloud_per_scene", "factor"), [(1.0, 0.5), (0.5, 1.0), (0.25, 2.0)])
def test_markers_scale_the_scene_and_the_cloud_follows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cloud_per_scene: float, factor: float
) -> None:
    write_scene_folder(tmp_path / "scene")
    found = Scale(m_per_unit=0.5, source="aruco", rel_std=0.01)
    monkeypatch.setattr(measure_cloud, "find_scale", lambda *_, **__: FoundScale(scale=found))
    turn = np.array([[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.0, 1.0]])
    similarity = np.diag([cloud_per_scene] * 3 + [1.0]) @ turn
    origin = measure_cloud._Origin(cloud_from_scene=similarity, units="model units")
    given = measure_cloud._cloud_scale(ScaleRequest(aruco_length_m=0.25), tmp_path / "cloud.ply", tmp_path, origin)
    assert given.scale.m_per_unit == pytest.approx(factor)
    assert (given.scale.source, given.scale.rel_std, given.warnings) == ("aruco", 0.01, ())


def test_plot_json_of_single_commands_keeps_what_others_wrote(tmp_path: Path) -> None:
    update_plot(tmp_path, source="scene", stage="fuse", seconds=2.0, values={"points": 7, "units": "m"})
    update_plot(tmp_path, source="cloud.ply", stage="trees", seconds=1.0, values={"trees": 3})
    plot = read_plot(tmp_path)
    assert (plot["source"], plot["points"], plot["trees"]) == ("scene", 7, 3)
    assert plot["seconds"] == {"fuse": 2.0, "trees": 1.0, "total": 3.0}
    # Every key of the contract is there, empty where nothing is known.
    for key in ("photos", "registered", "scale_m_per_unit", "density_per_m2", "peak_rss_mb", "model_sha256"):
        assert plot[key] is None
    assert plot["warnings"] == []

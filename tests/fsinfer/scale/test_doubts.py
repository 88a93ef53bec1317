"""A board that stands at two places in the scene is told by the run, not by the check alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fsinfer.scale.find import find_scale
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import Scale
from fsinfer.scene import Scene


def board(number: int, center: list[float], views: list[str]) -> dict[str, Any]:
    return {"id": number, "center": center, "views": views, "length_m": 0.25}


@pytest.mark.parametrize("twice", [False, True])
def test_a_run_warns_of_a_board_at_two_places(monkeypatch: pytest.MonkeyPatch, twice: bool) -> None:
    markers = [board(1, [0.0, 0.0, 0.0], ["a", "b", "c"]), board(2, [3.0, 0.0, 0.0], ["a", "b"])]
    if twice:
        markers.append(board(1, [0.0, 2.0, 0.0], ["q", "p"]))
    scale = Scale(m_per_unit=1.5, source="aruco", rel_std=0.001, details={"markers": markers})
    monkeypatch.setattr("fsinfer.scale.aruco.scale_from_aruco", lambda *_args, **_kwargs: scale)
    scene = Scene(folder=Path("scene"), views=())
    for request in (ScaleRequest(aruco_length_m=0.25), ScaleRequest()):
        found, warnings = find_scale(request, scene=scene)
        assert found is scale
        assert len(warnings) == int(twice)
        if twice:
            assert warnings[0].startswith("Board 1 was found at two places 3.0 m apart.")
            assert "p to q" in warnings[0]

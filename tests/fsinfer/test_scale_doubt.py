"""Scales that can hardly be right are doubted, those that may be right are not."""

from __future__ import annotations

import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsinfer.scale_doubt import LIKELY_HEIGHTS_M, doubt_endpoints, doubt_height, unknown_error
from fsinfer.scale_request import ScaleRequest

ENDS = ((0.0, 0.0, 0.0), (0.0, 3.0, 4.0))


def plot_of(**values: Any) -> dict[str, Any]:
    return {"scale_m_per_unit": 0.4, **values}


def test_end_points_read_off_a_metric_cloud_are_told_with_the_scale_that_is_meant() -> None:
    # A bar of 5.1 m that reads 5 m in a cloud whose cameras hang at 1.5 m: it was in metres, a little too small.
    request = ScaleRequest(endpoints=ENDS, length_m=5.1)
    (warning,) = doubt_endpoints(request, plot_of(camera_height=1.5))
    (factor,) = re.findall(r"give --scale (\S+) instead", warning)
    assert float(factor) == pytest.approx(0.4 * 5.1 / 5)
    assert doubt_endpoints(request, plot_of())[0] == warning


def test_end_points_read_off_the_cloud_in_model_units_are_believed() -> None:
    # In model units the cameras hang at 1.5 / 0.4; a bar of 2 m reads 5 units.
    assert doubt_endpoints(ScaleRequest(endpoints=ENDS, length_m=2.0), plot_of(camera_height=1.5)) == ()


@pytest.mark.parametrize(
    ("request_", "plot"),
    [
        (ScaleRequest(factor=0.4), plot_of(camera_height=1.5)),
        (ScaleRequest(endpoints=ENDS, length_m=5.1), {}),
        (ScaleRequest(endpoints=ENDS, length_m=5.1), {"scale_m_per_unit": None, "camera_height": 1.5}),
        (
            ScaleRequest(endpoints=ENDS, length_m=5.1),
            plot_of(camera_height=1.5, scale_details={"endpoints": [[0, 0, 0], [0, 3, 4]]}),
        ),
    ],
    ids=["a factor", "no earlier run", "no scale before", "the same end points again"],
)
def test_without_cause_nothing_is_said(request_: ScaleRequest, plot: dict[str, Any]) -> None:
    assert doubt_endpoints(request_, plot) == ()


@given(height_m=st.floats(*LIKELY_HEIGHTS_M))
def test_heights_at_which_people_hold_a_phone_are_believed(height_m: float) -> None:
    assert doubt_height(height_m) == ()


@pytest.mark.parametrize(
    ("height_m", "shown", "centimetres"),
    [(0.39, "0.39 m", False), (3.6, "3.6 m", False), (150.0, "150 m", True), (20.0, "20 m", False)],
)
def test_heights_at_which_nobody_does_are_told(height_m: float, shown: str, centimetres: bool) -> None:
    (warning,) = doubt_height(height_m)
    assert f"taken {shown} above the ground" in warning
    assert ("centimetres" in warning) == centimetres
    assert doubt_height(None) == ()


def test_only_a_bare_factor_has_an_unknown_error() -> None:
    assert "not known" in unknown_error("factor", None)[0]
    assert unknown_error("factor", 0.01) == ()
    assert unknown_error("aruco", None) == ()

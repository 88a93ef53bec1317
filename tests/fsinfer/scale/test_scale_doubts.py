"""Scales that can hardly be right are doubted, those that may be right are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsinfer.errors import ScaleError
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.sentences import sentence, sentences
from fsinfer.scale.doubts import (
    LIKELY_HEIGHTS_M,
    EarlierScale,
    doubt_endpoints,
    doubt_ends,
    doubt_height,
    unknown_error,
)
from fsinfer.scale.request import Point, ScaleRequest
from fsinfer.scale.scale import Scale

ENDS = ((0.0, 0.0, 0.0), (0.0, 3.0, 4.0))


def earlier(*, camera_height: float | None = None, endpoints: tuple[Point, Point] | None = None) -> EarlierScale:
    return EarlierScale(m_per_unit=0.4, camera_height=camera_height, endpoints=endpoints)


def test_end_points_read_off_a_metric_cloud_are_told_with_the_scale_that_is_meant() -> None:
    # A bar of 5.1 m that reads 5 m in a cloud whose cameras hang at 1.5 m: it was in metres, a little too small.
    request = ScaleRequest(endpoints=ENDS, length_m=5.1)
    (warning,) = doubt_endpoints(request, earlier(camera_height=1.5))
    assert warning.values["factor"] == pytest.approx(0.4 * 5.1 / 5)
    assert "give --scale 0.408 instead" in sentence(warning)
    assert doubt_endpoints(request, earlier())[0] == warning


def test_end_points_read_off_the_cloud_in_model_units_are_believed() -> None:
    # In model units the cameras hang at 1.5 / 0.4; a bar of 2 m reads 5 units.
    assert doubt_endpoints(ScaleRequest(endpoints=ENDS, length_m=2.0), earlier(camera_height=1.5)) == ()


@pytest.mark.parametrize(
    ("request_", "plot"),
    [
        (ScaleRequest(factor=0.4), earlier(camera_height=1.5)),
        (ScaleRequest(endpoints=ENDS, length_m=5.1), EarlierScale()),
        (ScaleRequest(endpoints=ENDS, length_m=5.1), EarlierScale(camera_height=1.5)),
        (
            ScaleRequest(endpoints=ENDS, length_m=5.1),
            earlier(camera_height=1.5, endpoints=ENDS),
        ),
    ],
    ids=["a factor", "no earlier run", "no scale before", "the same end points again"],
)
def test_without_cause_nothing_is_said(request_: ScaleRequest, plot: EarlierScale) -> None:
    assert doubt_endpoints(request_, plot) == ()


CLOUD = np.array([[-6.5, 0.0, 4.0], [0.0, -6.5, -0.2]])


def test_ends_farther_apart_than_the_cloud_is_large_are_refused() -> None:
    ends = ((-300.7, -1.0, 0.0), (-1.0, -1.0, 0.0))
    with pytest.raises(
        ScaleError, match=r"--endpoints -300\.7,-1,0 -1,-1,0: they are 299\.7 apart, .* only 10\.11 from"
    ):
        doubt_ends(ScaleRequest(endpoints=ends, length_m=2.0), CLOUD)


@pytest.mark.parametrize(
    ("ends", "told"),
    [
        (((-3.0, -1.0, 0.0), (-1.0, -1.0, 0.0)), None),
        # The top of a pole that has no point, on one that stands at the cloud's edge.
        (((-6.5, -3.0, 0.0), (-6.5, -3.0, 4.9)), None),
        # A sign that was lost.
        (((-3.0, -1.0, 0.0), (3.0, -1.0, 0.0)), "3,-1,0"),
        # Read off in a viewer that had moved the cloud.
        (((497.0, -1.0, 0.0), (499.0, -1.0, 0.0)), None),
    ],
)
def test_one_end_beside_the_cloud_is_told(ends: tuple[Point, Point], told: str | None) -> None:
    found = doubt_ends(ScaleRequest(endpoints=ends, length_m=2.0), CLOUD)
    assert [item.values["end"] for item in found] == ([] if told is None else [told])
    assert all(f"{told} lies beside the cloud" in line for line in sentences(found))
    assert doubt_ends(ScaleRequest(factor=1.0), CLOUD) == ()


@given(height_m=st.floats(*LIKELY_HEIGHTS_M))
def test_heights_at_which_people_hold_a_phone_are_believed(height_m: float) -> None:
    assert doubt_height(height_m) == ()


@pytest.mark.parametrize(
    ("height_m", "shown", "centimetres"),
    [(0.39, "0.39 m", False), (3.6, "3.6 m", False), (150.0, "150 m", True), (20.0, "20 m", False)],
)
def test_heights_at_which_nobody_does_are_told(height_m: float, shown: str, centimetres: bool) -> None:
    (warning,) = sentences(doubt_height(height_m))
    assert f"taken {shown} above the ground" in warning
    assert ("centimetres" in warning) == centimetres
    assert doubt_height(None) == ()


def test_only_a_bare_factor_has_an_unknown_error() -> None:
    bare = Scale(m_per_unit=0.4, source="factor", rel_std=None)
    assert [item.code for item in unknown_error(bare)] == [CaptureCode.scale_error_unknown]
    assert unknown_error(replace(bare, rel_std=0.01)) == ()
    assert unknown_error(replace(bare, source="aruco")) == ()

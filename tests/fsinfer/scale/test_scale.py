"""Scale from a factor."""

from __future__ import annotations

import pytest

from fsinfer.errors import ScaleError
from fsinfer.scale.scale import scale_from_factor


def test_factor() -> None:
    scale = scale_from_factor(0.4)
    assert (scale.m_per_unit, scale.source, scale.rel_std) == (0.4, "factor", None)


@pytest.mark.parametrize("value", [0.0, -2.0, float("nan"), float("inf")])
def test_numbers_that_are_no_scale(value: float) -> None:
    with pytest.raises(ScaleError, match="above 0"):
        scale_from_factor(value)

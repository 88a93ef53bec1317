"""Settings of the depth stage that make no depth."""

from __future__ import annotations

import pytest

from fsinfer.depth.settings import DepthSettings
from fsinfer.errors import InputError


@pytest.mark.parametrize("given", [{"source_views": 0}, {"source_views": -2}, {"max_size_px": 0}, {"max_size_px": -1}])
def test_no_source_view_and_no_photograph_are_refused(given: dict[str, int]) -> None:
    with pytest.raises(InputError, match=next(iter(given))):
        DepthSettings(**given)  # type: ignore[arg-type]
    assert DepthSettings(source_views=1, max_size_px=160).source_views == 1

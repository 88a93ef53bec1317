"""A stem without a diameter still has a place, a size to be drawn with, and the points that were looked at."""

from __future__ import annotations

import numpy as np

from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees.diameter.section import unmeasured_section

WHY = (notice(StemCode.too_few_on_bark, points=3),)


def test_a_bare_place_has_neither_diameter_nor_points() -> None:
    section = unmeasured_section(np.array([3.0, -2.0]), 1.3, WHY, radius_m=0.2)
    assert section.dbh_m is None
    assert (section.status, section.reasons) == ("unmeasured", WHY)
    assert np.isnan([section.sd_m, section.residual_m, section.tau_m]).all()
    assert section.offsets_m.shape == (0, 2)
    assert section.kept.shape == (0,)
    assert section.outline is None
    # Seen no higher than where it was to be measured, and upright as far as one knows.
    assert section.top_m == section.bh_m == 1.3
    np.testing.assert_array_equal(section.slope, [0.0, 0.0])
    np.testing.assert_array_equal(section.circle_m, [0.0, 0.0, 0.2])


def test_points_that_were_there_are_shown_but_none_was_used() -> None:
    offsets = np.array([[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0]])
    section = unmeasured_section(
        np.zeros(2), 1.3, (), radius_m=0.1, slope=np.array([0.1, 0.0]), lean_deg=5.7, top_m=2.4, offsets_m=offsets,
        half_slice_m=0.05,
    )  # fmt: skip
    np.testing.assert_array_equal(section.offsets_m, offsets)
    assert section.kept.tolist() == [False, False, False]
    assert (section.points, section.half_slice_m, section.top_m, section.lean_deg) == (0, 0.05, 2.4, 5.7)
    np.testing.assert_array_equal(section.slope, [0.1, 0.0])

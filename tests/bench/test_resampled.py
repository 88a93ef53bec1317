"""Pieces of a real scan, from the file to the figures; and the class of each stem."""

from __future__ import annotations

import pytest

from tests.bench.resampled import GROUPS, find_pieces, reference_figures, run
from tests.bench.stems import figures_of
from tests.support.places import DATA
from training.simulate.resampled_scan import VIEWS, ResampleSpec, ScanSpec
from training.simulate.scanned_section import SectionLimits
from training.simulate.stem_cloud import StemTruth

SCAN = DATA / "clouds" / "pine_plot.laz"


def test_every_view_and_every_share_has_its_class() -> None:
    for tag in [view.name for view in VIEWS] + [f"thinned to {100 * share:.0f} %" for share in ResampleSpec().shares]:
        stem = StemTruth(x_m=0.0, y_m=0.0, z_ground_m=0.0, dbh_cm=20.0, tree_id=1, seen_deg=360.0, tags=(tag,))
        assert [name for name, (_, chosen) in GROUPS.items() if chosen(stem)][1:-1], tag


def test_a_real_scan_from_the_file_to_the_figures() -> None:
    if not SCAN.exists():
        pytest.skip("shared/data/clouds is missing")
    spec = ScanSpec(heights_m=(1.0, 1.0), above_m=0.9, half_m=0.3, limits=SectionLimits(std_m=0.003))
    pieces = find_pieces(SCAN, spec)
    assert 2 <= len(pieces) <= 8
    assert all(20.0 < 100.0 * piece.section.tape_m < 30.0 for piece in pieces)
    matches = run(pieces, 0, 1, echo=False)
    figures = figures_of(matches, GROUPS) | reference_figures(pieces, matches)
    assert figures["stems"] == 16
    assert figures["rmse_cm"] < 3.0
    assert figures["sections"] == len(pieces)

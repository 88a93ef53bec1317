"""The estimates in the batch's report, in a real browser: above the table of plots, and no wider than the screen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fsinfer.batch.outcome import State
from fsinfer.batch.report import write_report
from fsinfer.batch.rows import PlotRow
from tests.support.browser import why_not

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not() or "a browser is there")
NAME = "old_beech_of_the_northern_slopes" * 8


@pytest.mark.parametrize("width", [1280, 390])
def test_the_forest_stands_above_the_plots(chromium: Browser, tmp_path: Path, width: int) -> None:
    rows = [
        PlotRow(
            plot=f"plot {number}", state=State.done, stratum=NAME, stratum_ha=12.5, has_border=True, units="m",
            area_m2=500.0, stems_per_ha=400.0 + 100.0 * number, basal_area_m2_per_ha=25.0 + number, mean_dbh_cm=24.0,
        )
        for number in range(3)
    ]  # fmt: skip
    rows.append(PlotRow(plot="x" * 80, state=State.failed, stratum=NAME, stratum_ha=12.5))
    page = chromium.new_page(viewport={"width": width, "height": 844})
    page.goto(write_report(tmp_path, rows, title="Plots").as_uri())
    text = page.locator("#forest").inner_text()
    for shown in ("Stems/ha", "500", "58", "252 – 748", "20.0 %", "49.7 %", "left out: 1 of 4 plots", "12.5 ha"):
        assert shown in text
    assert [one.inner_text() for one in page.locator("h2").all()][-2:] == ["Forest", "Plots"]
    seen, inner = page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
    assert seen <= inner
    # A long name is broken, not the table stretched by it; rows are one line high.
    table = page.locator("#forest table").bounding_box()
    row = page.locator("#forest td").first.bounding_box()
    assert table is not None
    assert row is not None
    assert table["width"] < 1280
    assert row["height"] < 40
    page.close()

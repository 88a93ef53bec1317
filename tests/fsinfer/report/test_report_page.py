"""The report in a real browser: it renders, sorts, shows the picked tree, colours the cloud, and prints."""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.report import make_report
from tests.support.browser import why_not
from tests.support.report_plot import write_report_folder

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not() or "a browser is there")
WIDTHS = (1280, 390)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_report(write_report_folder(tmp_path_factory.mktemp("plot")))


@pytest.fixture(scope="module", params=WIDTHS)
def page(request: pytest.FixtureRequest, chromium: Browser, report: Path) -> Iterator[Page]:
    opened = chromium.new_page(viewport={"width": request.param, "height": 844})
    opened.set_default_timeout(30_000)
    said, asked = [], []
    opened.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    opened.on("pageerror", lambda error: said.append(str(error)))
    opened.on("request", lambda request: asked.append(request.url))
    opened.goto(report.as_uri())
    yield opened
    assert said == []
    assert [url for url in asked if not url.startswith("data:")] == [report.as_uri()]
    opened.close()


def numbers(page: Page) -> list[str]:
    return page.locator("table.sortable tbody tr td:first-child").all_inner_texts()


def test_sorts_by_dbh_both_ways(page: Page) -> None:
    assert numbers(page) == ["1", "2", "3"]
    head = page.get_by_role("button", name="DBH (cm)", exact=True)
    head.click()
    assert numbers(page) == ["2", "1", "3"]
    head.focus()
    page.keyboard.press("Enter")
    assert numbers(page) == ["3", "1", "2"]
    assert page.locator("th[aria-sort=descending]").inner_text() == "DBH (cm)"


def test_a_tree_picked_on_the_map_shows_its_card(page: Page) -> None:
    card = page.locator("#tree-3")
    assert not card.is_visible()
    page.locator(".map .tree[data-tree='3']").click()
    assert card.is_visible()
    assert "DBH 40.0 cm" in card.inner_text()
    assert not page.locator("#tree-1").is_visible()
    pictures = card.locator(".photos img")
    assert pictures.count() == 3
    assert all(pictures.evaluate_all("all => all.map(one => one.complete && one.naturalWidth === 320)"))
    # The card can be reached by keys and from table and warnings too.
    page.locator(".map .tree[data-tree='1']").focus()
    page.keyboard.press("Enter")
    assert page.locator("#tree-1").is_visible()
    page.get_by_role("button", name="Next tree").click()
    assert page.locator("#tree-2").is_visible()
    page.get_by_role("button", name="Show tree 3", exact=True).click()
    assert card.is_visible()
    page.locator("#warnings a[data-card='2']").click()
    assert page.locator("#tree-2").is_visible()


def pixels(page: Page) -> NDArray[np.int_]:
    import cv2

    picture = cv2.imdecode(np.frombuffer(page.locator("#viewer canvas").screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture.reshape(-1, 3).astype(int)


def wait_for_cloud(page: Page) -> None:
    page.locator("#viewer canvas").scroll_into_view_if_needed()
    page.wait_for_function("Number(document.getElementById('viewer').dataset.drawn) > 20000")
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def test_the_cloud_is_drawn_coloured_and_turned(page: Page) -> None:
    wait_for_cloud(page)
    seen = {}
    for mode in ("rgb", "height", "tree", "confidence"):
        page.locator(f"[data-mode={mode}]").click()
        assert page.locator(f"[data-mode={mode}]").get_attribute("aria-pressed") == "true"
        page.wait_for_timeout(150)
        seen[mode] = pixels(page)
        background = np.array([26, 29, 23])
        drawn = (np.abs(seen[mode] - background).sum(axis=1) > 20).mean()
        assert drawn > 0.05, mode
    names = list(seen)
    for index, name in enumerate(names):
        for other in names[index + 1 :]:
            changed = (np.abs(seen[name] - seen[other]).sum(axis=1) > 30).mean()
            assert changed > 0.03, (name, other)
    page.locator("#viewer canvas").focus()
    for _ in range(4):
        page.keyboard.press("ArrowLeft")
    page.wait_for_timeout(400)
    assert (np.abs(pixels(page) - seen["confidence"]).sum(axis=1) > 30).mean() > 0.03
    assert page.locator("#viewer .names span").count() == 3


def test_a_tree_is_shown_in_the_cloud(page: Page) -> None:
    wait_for_cloud(page)
    before = pixels(page)
    page.locator(".map .tree[data-tree='1']").click()
    wait_for_cloud(page)
    page.evaluate("document.querySelector('#tree-1 [data-cloud]').click()")
    page.wait_for_timeout(400)
    assert (np.abs(pixels(page) - before).sum(axis=1) > 30).mean() > 0.05
    assert page.locator("#viewer .names span.picked").inner_text() == "1"


def test_nothing_is_wider_than_the_screen(page: Page) -> None:
    page.evaluate("document.querySelectorAll('details').forEach(one => { one.open = true; })")
    width, inner = page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
    assert width <= inner
    wide = page.evaluate(
        """() => Array.from(document.querySelectorAll('main *'))
             .filter(one => !one.closest('.wide, pre, svg, .names'))
             .filter(one => one.getBoundingClientRect().right > window.innerWidth + 1)
             .map(one => one.outerHTML.slice(0, 80))"""
    )
    assert wide == []


def test_everything_that_acts_has_a_name(page: Page) -> None:
    nameless = page.evaluate(
        """() => Array.from(document.querySelectorAll('button, select, input, a, canvas, img, [role], [tabindex]'))
             .filter(one => !(one.getAttribute('aria-label') || one.textContent.trim() || one.alt ||
                              (one.labels && one.labels.length)))
             .map(one => one.outerHTML.slice(0, 80))"""
    )
    assert nameless == []
    assert page.locator("html").get_attribute("lang") == "en"


def test_prints_every_card_with_text(chromium: Browser, report: Path, tmp_path: Path) -> None:
    page = chromium.new_page(viewport={"width": 1280, "height": 900})
    page.goto(report.as_uri())
    page.emulate_media(media="print")
    for number in (1, 2, 3):
        assert page.locator(f"#tree-{number}").is_visible()
    assert page.locator(".still img").first.is_visible()
    assert not page.locator("#viewer").is_visible()
    path = tmp_path / "report.pdf"
    page.pdf(path=str(path), format="A4")
    data = path.read_bytes()
    assert len(re.findall(rb"/Type\s*/Page\b", data)) >= 2
    # Text operators in the pages' streams: a page of pictures only has none.
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, flags=re.DOTALL)
    text = 0
    for stream in streams:
        try:
            text += len(re.findall(rb"T[jJ]\b", zlib.decompress(stream)))
        except zlib.error:
            continue
    assert text > 100
    assert page.evaluate("document.querySelectorAll('details:not([open])').length") >= 0
    page.close()


def test_without_webgl_the_still_pictures_are_shown(chromium: Browser, report: Path) -> None:
    page = chromium.new_page(viewport={"width": 800, "height": 900})
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto(report.as_uri())
    page.locator("#cloud").scroll_into_view_if_needed()
    page.locator(".still img").first.wait_for(state="visible")
    assert not page.locator("#viewer").is_visible()
    page.close()


def test_a_long_name_in_a_warning_does_not_widen_a_phone_s_page(chromium: Browser, tmp_path: Path) -> None:
    out = write_report_folder(tmp_path)
    plot = json.loads((out / "plot.json").read_text(encoding="utf-8"))
    plot["warnings"] = [f"left out: {'Forstrevier_Nord_' * 5}.jpg cannot be read"]
    (out / "plot.json").write_text(json.dumps(plot), encoding="utf-8")
    opened = chromium.new_page(viewport={"width": 390, "height": 844})
    opened.goto(make_report(out).as_uri())
    width, inner = opened.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
    opened.close()
    assert width <= inner

"""The click page in a real browser: clicking, the loupe, arrow keys, other photographs, and the end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

from fsinfer.scale.clicks.file import SavedClicks
from fsinfer.scale.clicks.server import ClickServer
from fsinfer.scene import Scene, read_scene
from tests.fsinfer.scale.test_click_server import true_clicks
from tests.support.browser import why_not
from tests.support.synthetic_plot import M_PER_UNIT, SIZE, write_scene_folder

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not() or "a browser is there")
WIDTHS = (1280, 390)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    folder = tmp_path_factory.mktemp("plot")
    write_scene_folder(folder)
    return read_scene(folder)


class Opened:
    """The page, its server, and what it kept."""

    def __init__(self, page: Page, server: ClickServer, kept: list[SavedClicks]) -> None:
        self.page, self.server, self.kept = page, server, kept

    def pane(self, number: int) -> Locator:
        return self.page.locator(".pane").nth(number)

    def click(self, number: int, place: list[float]) -> None:
        """Click in the photograph where this pixel is shown."""
        image = self.pane(number).locator("img")
        # In the middle of the screen: the line with the result stands at its lower edge.
        image.evaluate("one => one.scrollIntoView({block: 'center'})")
        box = image.bounding_box()
        assert box is not None
        u, v = ((place[axis] + 0.5) / SIZE[axis] for axis in range(2))
        image.click(position={"x": u * box["width"], "y": v * box["height"]}, force=True)

    def mark(self, number: int, clicks: list[list[float]]) -> None:
        for end, place in enumerate(clicks):
            self.pane(number).locator(".end").nth(end).click()
            self.click(number, place)

    @staticmethod
    def expect(locator: Locator) -> Any:
        from playwright.sync_api import expect

        return expect(locator)

    def expect_told(self, text: str) -> None:
        self.expect(self.page.locator("#told")).to_contain_text(text, timeout=20_000)

    def told(self) -> str:
        return self.page.locator("#told").inner_text()


@pytest.fixture(params=WIDTHS)
def opened(request: pytest.FixtureRequest, chromium: Browser, scene: Scene) -> Iterator[Opened]:
    kept: list[SavedClicks] = []
    said, asked = [], []
    page = chromium.new_page(viewport={"width": request.param, "height": 844})
    page.set_default_timeout(30_000)
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda given: asked.append(given.url))
    with ClickServer(scene, 1.0, SavedClicks(), kept.append) as server:
        page.goto(server.url)
        yield Opened(page, server, kept)
        page.close()
        told_by_browser = ("422", "ERR_CONNECTION_REFUSED")
        assert [line for line in said if not any(known in line for known in told_by_browser)] == []
        assert [url for url in asked if not url.startswith((server.url, "data:"))] == []


def test_two_photographs_give_the_scale(opened: Opened, scene: Scene) -> None:
    page = opened.page
    assert page.locator(".pane").count() == 2
    assert page.locator("#use").is_disabled()
    names = [opened.pane(number).get_attribute("data-photo") or "" for number in range(2)]
    number = {view.name: index for index, view in enumerate(scene.views)}
    clicks = true_clicks(scene, *(number[name] for name in names))
    opened.mark(0, clicks[names[0]])
    opened.expect_told("1 of at least 2")
    opened.mark(1, clicks[names[1]])
    opened.expect(page.locator("#use")).to_be_enabled()
    assert "by 2 photographs" in opened.told()
    page.locator("#use").click()
    clicked = opened.server.wait()
    # To a hundredth by clicks on whole pixels of the screen, which are fractions of the photograph's.
    assert clicked.scale.m_per_unit == pytest.approx(M_PER_UNIT, rel=0.02)
    for ends in clicked.clicks.views:
        for got, wanted in zip((ends.first, ends.second), clicks[ends.view], strict=True):
            assert got == pytest.approx(wanted, abs=0.6)
    opened.expect_told("Done: ")
    assert opened.kept[-1].used == clicked.clicks
    # Nothing can be changed any more.
    before = len(opened.kept)
    opened.click(0, [10.0, 10.0])
    page.wait_for_timeout(200)
    assert len(opened.kept) == before


def test_the_loupe_makes_a_click_exact(opened: Opened) -> None:
    page, pane = opened.page, opened.pane(0)
    name = pane.get_attribute("data-photo") or ""
    opened.click(0, [80.0, 60.0])
    opened.expect(pane.locator(".where")).not_to_contain_text("End 1: not yet")

    def mark() -> tuple[float, float]:
        page.wait_for_timeout(250)
        place = opened.kept[-1].draft[name][0]
        assert place is not None
        return place

    start = mark()
    assert start == pytest.approx((80, 60), abs=0.6)
    # The loupe has the keyboard after the first click.
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowDown")
    assert mark() == pytest.approx((start[0] + 0.5, start[1] + 5))
    loupe = pane.locator("canvas")
    for _ in range(2):
        pane.locator(".in").click()
    assert pane.locator(".times").inner_text() == "8×"
    before = mark()
    box = loupe.bounding_box()
    assert box is not None
    shown = 320 / box["width"]
    loupe.click(position={"x": box["width"] / 2 + 16 / shown, "y": box["height"] / 2 - 24 / shown})
    assert mark() == pytest.approx((before[0] + 2, before[1] - 3), abs=0.3)
    loupe.hover()
    page.mouse.wheel(0, 200)
    opened.expect(pane.locator(".times")).to_have_text("6×")
    # It shows the photograph, magnified, not black.
    light = loupe.evaluate("c => c.getContext('2d').getImageData(0, 0, 320, 240).data.filter(v => v > 60).length")
    assert light > 320 * 240
    pane.locator(".clear").click()
    page.wait_for_timeout(250)
    assert opened.kept[-1].draft == {}


def test_other_photographs_and_more_of_them(opened: Opened, scene: Scene) -> None:
    page = opened.page
    clicks = true_clicks(scene, 1, 5, 9)
    for pane, view in ((0, 1), (1, 5)):
        opened.pane(pane).locator(".which").select_option(str(view))
    page.locator("#add").click()
    assert page.locator(".pane").count() == 3
    third = opened.pane(2).locator(".which")
    assert third.input_value() == "6"
    for _ in range(3):
        opened.pane(2).locator(".next").click()
    assert third.input_value() == "9"
    for pane, name in enumerate(("view_01", "view_05", "view_09")):
        opened.mark(pane, clicks[name])
    opened.expect_told("by 3 photographs")
    assert "That is much" not in opened.told()
    # Another place in one of them shows, and what cannot be is refused.
    u, v = clicks["view_09"][0]
    opened.mark(2, [[u + 20, v], clicks["view_09"][1]])
    opened.expect_told("That is much")
    opened.mark(2, [[1.0, 1.0], [158.0, 118.0]])
    opened.expect(page.locator("#told.error")).to_be_visible()
    assert "click the same spot" in opened.told()
    assert page.locator("#use").is_disabled()
    # What was clicked is there again when the page is loaded anew.
    page.reload()
    assert page.locator(".pane").count() == 3
    assert opened.pane(0).locator("circle").count() == 2


def test_a_page_whose_program_was_ended_says_so(opened: Opened) -> None:
    """Clicks in it are lost; "Failed to fetch", a browser's own words, said neither that nor the way out."""
    opened.server._server.shutdown()
    opened.server._server.socket.close()
    opened.click(0, [80.0, 60.0])
    opened.expect_told("Run fsinfer scale again")


def test_nothing_is_wider_than_the_screen(opened: Opened) -> None:
    width, inner = opened.page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
    assert width <= inner

"""A headless Chromium of this machine, driven by Playwright; ``python -m tests.support.browser`` says if it is there.

Playwright's own browsers are not downloaded: the tests use the one that is installed.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Browser

NAMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome", "microsoft-edge")
# No graphics card is needed: WebGL is computed by SwiftShader. CI runs as root, where Chromium's sandbox refuses.
ARGUMENTS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


def find_browser() -> str | None:
    """Path of the browser: the environment variable CHROMIUM, or the first usual name on the search path."""
    given = os.environ.get("CHROMIUM")
    return given or next((path for name in NAMES if (path := shutil.which(name))), None)


def why_not() -> str:
    """Why the browser tests cannot run here; empty when they can."""
    if importlib.util.find_spec("playwright") is None:
        return "playwright is not installed (pip install playwright)"
    if find_browser() is None:
        return f"no browser found: none of {', '.join(NAMES)} (install Debian's chromium, or set CHROMIUM to its path)"
    return ""


@contextmanager
def browser() -> Iterator[Browser]:
    """Start the browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=find_browser(), args=list(ARGUMENTS))
        try:
            yield started
        finally:
            started.close()


if __name__ == "__main__":
    missing = why_not()
    print(f"NO BROWSER: the report is NOT tested in one: {missing}" if missing else f"browser found: {find_browser()}")

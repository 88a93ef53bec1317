"""Settings of all tests, and the browser of those that look at pages."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from tests.support.browser import browser

if TYPE_CHECKING:
    from playwright.sync_api import Browser

    from tests.support.command_line import Call

# A test is right or wrong, however busy the machine is, and the same today and tomorrow: a change is judged by what it
# changed. New examples are looked for with ``pytest --hypothesis-profile exploring``; what they find becomes a test.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("exploring", deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    with browser() as started:
        yield started


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Call:
    """Run the command line as a shell would."""
    # Not at the top: most tests need no command line, and it takes its time to load.
    from tests.support.command_line import caller

    return caller(monkeypatch, capfd)

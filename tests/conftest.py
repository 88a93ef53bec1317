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

#: The files that take longest, begun first: at the end the processes have small ones left to share, and none waits long
#: for the other.
LONGEST = (
    "tests/faults/test_faults.py",
    "tests/fsinfer/batch/test_cluster.py",
    "tests/fuzz/test_fuzz.py",
    "tests/fsinfer/test_demo.py",
    "tests/fsinfer/test_killed.py",
    "tests/fsinfer/workflow/test_pipeline.py",
    "tests/training/test_train.py",
    "tests/training/test_timed_run.py",
    "tests/training/test_processes.py",
    "tests/training/synthesize/test_demo_plot.py",
    "tests/training/synthesize/test_synthesize.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: not item.nodeid.startswith(LONGEST))


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

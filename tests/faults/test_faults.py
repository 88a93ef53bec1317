"""Faults in some stages; ``python -m tests.faults`` has all of them in every stage."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.faults.__main__ import Undisturbed, inject, undisturbed
from tests.faults.runs import Injection

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot copy a process")

# What is quick and what has found something: copies that were cut, writers with errors of their own, no lock.
CHAINS = {
    "power cut": ["frames", "poses", "cloud"],
    "file limit": ["frames", "cloud", "trees"],
    "read-only": ["fuse"],
    "Ctrl-C in a stall": ["trees"],
    "second run": ["depth"],
    "no memory": ["fuse"],
    "clock": ["depth", "report"],
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    return undisturbed(tmp_path_factory.mktemp("sound"))


@pytest.mark.parametrize("fault", CHAINS)
def test_a_fault_costs_no_result(tmp_path: Path, sound: Undisturbed, fault: str) -> None:
    injections: list[Injection] = inject([fault], CHAINS[fault], tmp_path, sound)
    assert [one.stage for one in injections] == CHAINS[fault]
    assert {one.stage: one.problems for one in injections if one.problems} == {}

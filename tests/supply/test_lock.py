"""What CI installs is locked, whole, with hashes."""

from __future__ import annotations

import importlib.metadata
import re

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.supply.lock import DEV, SLIM, faults, needed, pins, pyproject

HASH = " \\\n    --hash=sha256:" + 64 * "a"


@pytest.mark.parametrize(
    ("path", "development"), [(DEV, True), (SLIM, False)], ids=lambda value: getattr(value, "name", "")
)
def test_the_lock_holds_what_pyproject_asks_for(path: object, development: bool) -> None:
    text = (DEV if development else SLIM).read_text(encoding="utf-8")
    asked = needed(pyproject(), development=development)
    assert len(asked) > 10
    assert faults(text, asked) == [], "python -m tests.supply lock"
    # No server: everybody installs from where they install from.
    assert "://" not in text
    assert not re.search(r"^\s*-(?!-hash)", text, flags=re.MULTILINE)


def test_the_wheel_is_tried_with_the_versions_that_are_tested() -> None:
    tested = {f"{pin.name}{pin.specifier}" for pin, _ in pins(DEV.read_text(encoding="utf-8"))}
    slim = {f"{pin.name}{pin.specifier}" for pin, _ in pins(SLIM.read_text(encoding="utf-8"))}
    assert len(slim) > 20
    assert slim < tested


def test_the_lock_holds_for_other_systems_and_pythons() -> None:
    markers = [pin.marker for pin, _ in pins(DEV.read_text(encoding="utf-8")) if pin.name == "pycolmap" and pin.marker]
    (pycolmap,) = markers
    linux = {"sys_platform": "linux", "platform_machine": "x86_64"}
    assert pycolmap.evaluate(linux)
    assert not pycolmap.evaluate(linux | {"platform_machine": "aarch64"})


def test_what_packages_ask_for_with_an_extra_is_locked_with_it() -> None:
    # pip takes `coverage==7` for no pin of `coverage[toml]` as soon as there is a newer version than 7.
    locked = {(canonicalize_name(pin.name), frozenset(pin.extras)) for pin, _ in pins(DEV.read_text(encoding="utf-8"))}
    names = {name for name, _ in locked}
    asked = {
        (canonicalize_name(requirement.name), frozenset(requirement.extras))
        for name in names
        for requirement in map(Requirement, _requires(name))
        if requirement.extras and (requirement.marker is None or requirement.marker.evaluate({"extra": ""}))
    }
    assert ("coverage", frozenset({"toml"})) in asked
    assert asked <= locked


def _requires(name: str) -> list[str]:
    """What an installed package asks for; nothing where it is not installed here."""
    try:
        return importlib.metadata.requires(name) or []
    except importlib.metadata.PackageNotFoundError:
        return []


def test_faults_of_a_lock_are_found() -> None:
    lock = f"numpy==2.1.0{HASH}{HASH}\nscipy==1.13 ; python_version < '3.12'{HASH}\n"
    assert [(str(pin), hashes) for pin, hashes in pins(lock)] == [
        ("numpy==2.1.0", 2),
        ('scipy==1.13; python_version < "3.12"', 1),
    ]
    assert faults(lock, ["numpy>=2", "scipy"]) == []
    assert faults(lock, ["numpy>=2.2"]) == ["numpy>=2.2 is asked for, locked is 2.1.0"]
    assert faults(lock, ["rich>=1"]) == ["rich>=1 is not in it"]
    assert faults(lock + "rich==1\n", []) == ["rich==1 has no hash"]
    assert faults(lock + f"torch==2.13.0{HASH}\n", []) == ["torch==2.13.0 cannot be locked"]
    with pytest.raises(ValueError, match="neither a version nor a hash: --extra-index-url"):
        pins("--extra-index-url somewhere\n" + lock)
    with pytest.raises(ValueError, match="neither a version nor a hash: rich>=1"):
        pins("rich>=1\n")


def test_pytorch_is_asked_for_and_not_locked() -> None:
    everything = pyproject()["project"]["optional-dependencies"]["train"]
    assert "torch" in {Requirement(line).name for line in everything}
    assert "torch" not in {Requirement(line).name for line in needed(pyproject(), development=True)}

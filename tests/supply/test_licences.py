"""Licences are read from metadata; one that is not on the list, or none, is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.supply.installed import MissingPackage, closure, compiled_in, installed
from tests.supply.licences import Package, faults, groups, is_allowed, licences_of, page
from tests.supply.lock import SLIM, pins
from tests.support.places import ROOT


def install(folder: Path, name: str, *lines: str, files: tuple[str, ...] = ()) -> None:
    """A made-up package with these lines of metadata."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(
        "\n".join(["Metadata-Version: 2.4", f"Name: {name}", "Version: 1.0", *lines, "", ""])
    )
    (info / "RECORD").write_text("".join(f"{file},,\n" for file in files))
    for file in files:
        # importlib_metadata, once anything has loaded it, lists only files that there are.
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).touch()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """fsinfer with a package, which needs another one, and one more with an extra."""
    needs = ("Requires-Dist: near>=1", "Requires-Dist: maps; extra == 'gis'", "Provides-Extra: gis")
    install(tmp_path, "fsinfer", "License-Expression: Apache-2.0", *needs)
    install(tmp_path, "near", "License: MIT", "Requires-Dist: far[fast]", "Requires-Dist: nt; sys_platform == 'none'")
    install(tmp_path, "far", "License-Expression: MIT OR GPL-3.0-only", "Requires-Dist: quick; extra == 'fast'")
    install(tmp_path, "quick", "Classifier: License :: OSI Approved :: BSD License", "License: BSD-3-Clause")
    install(tmp_path, "maps", "Classifier: License :: OSI Approved :: ISC License (ISCL)", "Requires-Dist: near")
    install(tmp_path, "other", "License: AGPL-3.0-only")
    return tmp_path


def found_in(folder: Path) -> dict[str, list[Package]]:
    return groups(installed([str(folder)]), extras=("", "gis"))


def test_all_that_is_needed_is_listed_once(folder: Path) -> None:
    found = found_in(folder)
    names = {extra: [(one.name, one.licences) for one in members] for extra, members in found.items()}
    # The alternative of MIT or GPL is MIT; the GPL of what nobody asks for does not matter.
    near, far, quick = ("near", ("MIT",)), ("far", ("MIT OR GPL-3.0-only",)), ("quick", ("BSD-3-Clause",))
    assert names == {"": [far, near, quick], "gis": [("maps", ("ISC",))]}
    assert [fault for members in found.values() for fault in faults(members)] == []
    text = page(found)
    assert "| far | 1.0 | MIT OR GPL-3.0-only |  |" in text
    assert "| maps | 1.0 | ISC |  |" in text


@pytest.mark.parametrize(
    ("lines", "fault"),
    [
        (["License-Expression: GPL-3.0-or-later"], "'GPL-3.0-or-later' is not allowed"),
        (["License-Expression: MIT AND AGPL-3.0-only"], "'MIT AND AGPL-3.0-only' is not allowed"),
        (["License: MIT", "Classifier: License :: OSI Approved :: GNU General Public License v3 (GPLv3)"], "(GPLv3)'"),
        (["License: our own, ask us"], "'our own, ask us' is not allowed"),
        ([], "tells no licence"),
        (["License: UNKNOWN"], "tells no licence"),
        (["Classifier: License :: OSI Approved"], "tells no licence"),
    ],
    ids=["gpl", "and", "classifier", "own", "none", "unknown", "approved"],
)
def test_a_licence_that_is_not_on_the_list_is_refused(folder: Path, lines: list[str], fault: str) -> None:
    (folder / "quick-1.0.dist-info" / "METADATA").unlink()
    (folder / "quick-1.0.dist-info" / "RECORD").unlink()
    (folder / "quick-1.0.dist-info").rmdir()
    install(folder, "quick", *lines)
    wrong = [fault for members in found_in(folder).values() for fault in faults(members)]
    assert len(wrong) == 1
    assert wrong[0].startswith("quick 1.0")
    assert fault in wrong[0]


def test_a_missing_package_is_named_with_who_asks_for_it(folder: Path) -> None:
    packages = {name: found for name, found in installed([str(folder)]).items() if name != "quick"}
    with pytest.raises(MissingPackage, match="quick is not installed, which far asks for"):
        closure(packages, "fsinfer")
    assert "quick" not in closure(packages, "fsinfer", unknown=["far"])


def test_libraries_in_a_wheel_are_seen(tmp_path: Path) -> None:
    files = (
        "a.libs/libx265-4883ecb5.so.217",
        "a.libs/libavif-1.so.16",
        "a.libs/libavcodec-1.so.6",
        "a/core.so",
        "a/x.py",
    )
    install(tmp_path, "a", "License-Expression: MIT", files=files)
    install(tmp_path, "fsinfer", "License-Expression: Apache-2.0", "Requires-Dist: a")
    packages = installed([str(tmp_path)])
    assert compiled_in(packages["a"]) == ["libavcodec", "libavif", "libx265"]  # type: ignore[index]
    (one,) = groups(packages, extras=("",))[""]
    assert one.libraries == ("libavcodec", "libx265")
    assert faults([one]) == ["a 1.0 brings libx265: GPL-2.0-or-later is not allowed"]


def test_expressions() -> None:
    assert is_allowed("Apache-2.0 WITH LLVM-exception AND (MIT OR GPL-2.0-only)")
    assert not is_allowed("GPL-2.0-only WITH Classpath-exception-2.0")
    assert not is_allowed("MIT AND")
    assert not is_allowed("")


def test_what_is_installed_here_is_allowed() -> None:
    packages = installed()
    names = set(closure(packages, "fsinfer")) - {"fsinfer"}
    assert len(names) > 20
    assert {name for name in names if licences_of(packages[name]) == ()} == set()


def test_the_page_lists_the_locked_versions() -> None:
    text = (ROOT / "docs" / "licences.md").read_text(encoding="utf-8")
    here = [pin for pin, _ in pins(SLIM.read_text(encoding="utf-8")) if pin.marker is None]
    assert len(here) > 20
    told = [f"| {pin.name} | {next(iter(pin.specifier)).version} |" for pin in here]
    assert [line for line in told if line not in text] == [], "python -m tests.supply licences --write"

"""The versions that CI installs, with the hashes of their files: tests/locked/requirements-*.txt.

``requirements-slim.txt`` holds what the wheel needs, ``requirements-dev.txt`` what development needs on top, with what
builds the wheel. Each file holds for Linux, macOS and Windows and for every Python that pyproject.toml allows: markers
tell which line is for whom, and a version's hashes are those of all its files.

PyTorch stays out. The same release is other files elsewhere: the package index has a build for NVIDIA's GPUs, which
needs gigabytes of further packages, PyTorch's own index and many mirrors have one for processors. No one set of hashes
holds for both. Its version is pinned in pyproject.toml, and what it needs besides is locked here.
"""

from __future__ import annotations

import re
import subprocess
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests.support.places import ROOT

FOLDER = ROOT / "tests" / "locked"
DEV, SLIM = FOLDER / "requirements-dev.txt", FOLDER / "requirements-slim.txt"
#: Not in the lock: see above.
WITHOUT = "torch"
#: What nothing else asks for: hatchling's editable installation, and what PyTorch's build for processors needs.
BESIDES = ("editables>=0.5", "filelock", "fsspec>=0.8.5", "networkx>=2.5.1", "sympy>=1.13.3", "typing-extensions>=4.10")
#: The first Python that the lock holds for.
PYTHON = "3.11"

_HEADER = """\
# {what}
# Made by: python -m tests.supply lock. PyTorch is not in it: tests/supply/lock.py says why.
# pip install --require-hashes -r {file}
"""
# A version, its marker, and the hashes below it.
_PIN = re.compile(
    r"^(?P<pin>[A-Za-z0-9][\w.-]*(?:\[[\w.,-]+\])?==[^\s;\\]+(?: ; [^\\\n]+?)?)"
    r"(?P<hashes>(?: *\\\n +--hash=sha256:[0-9a-f]{64})*) *$",
    flags=re.MULTILINE,
)


def needed(project: Mapping[str, Any], *, development: bool) -> list[str]:
    """What pyproject.toml asks for by name: the dependencies; with ``development`` all extras and the build as well."""
    asked = list(project["project"]["dependencies"])
    if development:
        for extra in project["project"]["optional-dependencies"].values():
            asked += extra
        asked += [*project["build-system"]["requires"], *BESIDES]
    own = {canonicalize_name(project["project"]["name"]), WITHOUT}
    return [line for line in dict.fromkeys(asked) if canonicalize_name(Requirement(line).name) not in own]


def pyproject(root: Path = ROOT) -> dict[str, Any]:
    """What pyproject.toml says."""
    return tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))


def pins(text: str) -> list[tuple[Requirement, int]]:
    """The versions of a lock, with the number of hashes of each.

    Raises
    ------
    ValueError
        A line that is neither a version nor a hash nor a comment.
    """
    lines = "".join(line for line in text.splitlines(keepends=True) if not line.startswith("#"))
    rest = _PIN.sub("", lines).strip()
    if rest:
        msg = f"neither a version nor a hash: {rest.splitlines()[0]}"
        raise ValueError(msg)
    return [(Requirement(found["pin"]), found["hashes"].count("--hash")) for found in _PIN.finditer(lines)]


def faults(text: str, asked: Iterable[str]) -> list[str]:
    """What is wrong with a lock: a version without a hash, something that was asked for and is not in it."""
    found: list[str] = []
    versions: dict[str, list[Version]] = {}
    for pin, hashes in pins(text):
        name = canonicalize_name(pin.name)
        (specifier,) = pin.specifier
        versions.setdefault(name, []).append(Version(specifier.version))
        if hashes == 0:
            found.append(f"{pin} has no hash")
        if name == WITHOUT:
            found.append(f"{pin} cannot be locked")
    for line in asked:
        requirement = Requirement(line)
        locked = versions.get(canonicalize_name(requirement.name), [])
        if not locked:
            found.append(f"{requirement} is not in it")
        found += [f"{requirement} is asked for, locked is {v}" for v in locked if v not in requirement.specifier]
    return found


def write_locks(*, upgrade: bool) -> None:
    """Write both files; versions that are locked already stay where nothing asks for others, without ``upgrade``.

    Raises
    ------
    FileNotFoundError
        uv, which chooses the versions, is not installed.
    subprocess.CalledProcessError
        There is no choice of versions, or no network.
    """
    project = pyproject()
    _compile(
        DEV, "What CI installs to test fsinfer and to build its wheel.", needed(project, development=True), upgrade
    )
    # The same versions: what is tested is what the wheel is tried with.
    slim = needed(project, development=False)
    _compile(SLIM, "What the wheel of fsinfer needs.", slim, upgrade=True, constraints=("--constraints", str(DEV)))


def _compile(path: Path, what: str, asked: Sequence[str], upgrade: bool, constraints: Sequence[str] = ()) -> None:
    path.parent.mkdir(exist_ok=True)
    command = ["uv", "pip", "compile", "-", "--output-file", path.name, "--universal", "--python-version", PYTHON]
    # Extras stay: where another package asks for `coverage[toml]` and there is a newer version than the locked one, pip
    # takes `coverage==7.1` for a pin of something else and refuses.
    command += ["--no-strip-extras", "--generate-hashes", "--no-header", "--no-annotate"]
    command += ["--no-emit-index-url", "--no-emit-find-links"]
    command += ["--quiet", "--no-config", *constraints, *(["--upgrade"] if upgrade else [])]
    subprocess.run(command, input="\n".join(asked), text=True, cwd=path.parent, check=True)
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    header = _HEADER.format(what=what, file=path.relative_to(ROOT).as_posix())
    path.write_text(header + "\n".join(lines) + "\n", encoding="utf-8", newline="\n")

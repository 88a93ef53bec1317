"""What is installed beside fsinfer, as its metadata tells: which package asks for which."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import PurePosixPath

from packaging.requirements import Requirement
from packaging.utils import NormalizedName, canonicalize_name

Installed = Mapping[NormalizedName, metadata.Distribution]


class MissingPackage(Exception):
    """A package that another one asks for is not installed."""


def installed(path: list[str] | None = None) -> Installed:
    """The packages of this environment, or of the folders of ``path``, by name."""
    found = metadata.distributions() if path is None else metadata.distributions(path=path)
    packages: dict[NormalizedName, metadata.Distribution] = {}
    for distribution in found:
        # The first one is the one that is imported.
        packages.setdefault(canonicalize_name(distribution.name), distribution)
    return packages


def asked_by(distribution: metadata.Distribution, extras: Iterable[str] = ()) -> Iterator[Requirement]:
    """What a package asks for here, with these extras of it."""
    for line in distribution.requires or ():
        requirement = Requirement(line)
        if requirement.marker is None or any(requirement.marker.evaluate({"extra": e}) for e in ("", *extras)):
            yield requirement


def closure(
    packages: Installed, root: str, extras: Iterable[str] = (), *, unknown: Iterable[str] = ()
) -> dict[NormalizedName, set[NormalizedName]]:
    """What ``root`` needs with these extras, and what that needs, and so on; ``root`` comes first.

    What the packages of ``unknown`` ask for and is not installed is left out.

    Returns
    -------
    The names of all packages, each with the names of those it asks for itself.

    Raises
    ------
    MissingPackage
        Something that is asked for is not installed.
    """
    needs: dict[NormalizedName, set[NormalizedName]] = {}
    seen: set[tuple[NormalizedName, frozenset[str]]] = set()
    open_ = deque([(canonicalize_name(root), frozenset(extras), "")])
    while open_:
        name, with_extras, by = open_.popleft()
        if (name, with_extras) in seen:
            continue
        seen.add((name, with_extras))
        if name not in packages:
            msg = f"{name} is not installed{f', which {by} asks for' if by else ''}; pip install -e '.[dev]' brings it"
            raise MissingPackage(msg)
        below = needs.setdefault(name, set())
        for requirement in asked_by(packages[name], with_extras):
            asked = canonicalize_name(requirement.name)
            if asked not in packages and name in unknown:
                continue
            if asked != name:
                below.add(asked)
            open_.append((asked, frozenset(requirement.extras), name))
    return needs


def compiled_in(distribution: metadata.Distribution) -> list[str]:
    """Names of the shared libraries that a package brings along, without hashes and versions (``libheif``)."""
    names = set()
    for file in distribution.files or ():
        path = PurePosixPath(file)
        beside = any(folder.endswith(".libs") or folder == ".dylibs" for folder in path.parts[:-1])
        if beside and (path.name.endswith((".dll", ".dylib")) or ".so" in path.name):
            names.add(path.name.split(".")[0].split("-")[0])
    return sorted(names)

"""The licences of all that fsinfer needs: docs/licences.md, and a refusal of what is not on the list.

A licence is what the metadata of the installed package tells: its ``License-Expression``; without one its classifiers
and its ``License``, where that is a name and not a text.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import metadata

from license_expression import ExpressionError, LicenseSymbol, LicenseWithExceptionSymbol, Licensing
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests.supply.installed import Installed, closure, compiled_in
from tests.supply.lock import WITHOUT

#: What may be used without a word: permissive ones, and the MPL, which asks for changes of its own files alone.
ALLOWED = frozenset(
    {
        "0BSD", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "BSD-2-Clause", "BSD-3-Clause", "BSL-1.0", "CC0-1.0",
        "HPND", "ISC", "LicenseRef-BSD", "MIT", "MIT-0", "MIT-CMU", "MPL-2.0", "PSF-2.0", "Python-2.0", "Unlicense",
        "Zlib",
    }
)  # fmt: skip
#: Extras of fsinfer in the order of the page, and whom they are for; the first is fsinfer without any.
GROUPS = {
    "": "What `pip install fsinfer` brings",
    "gis": "With the extra `gis`",
    "cluster": "With the extra `cluster`",
    "train": "With the extra `train`: training and export",
    "docs": "With the extra `docs`: the site",
    "dev": "With the extra `dev`: tests and checks",
}
#: Shared libraries under a licence that asks for more, which wheels bring along; the beginning of their file names.
LIBRARIES = {
    "libx264": "GPL-2.0-or-later",
    "libx265": "GPL-2.0-or-later",
    "libcgal": "GPL-3.0-or-later",
    "libav": "LGPL-2.1-or-later",
    "libsw": "LGPL-2.1-or-later",
    "libavif": "BSD-2-Clause",
    "libheif": "LGPL-3.0-or-later",
    "libde265": "LGPL-3.0-or-later",
    "libgomp": "GPL-3.0-or-later WITH GCC-exception-3.1",
    "libgfortran": "GPL-3.0-or-later WITH GCC-exception-3.1",
    "libquadmath": "LGPL-2.1-or-later",
}
#: May come along as a library of its own, which the user can replace.
ALLOWED_LIBRARIES = ALLOWED | {
    "GPL-3.0-or-later WITH GCC-exception-3.1",
    "LGPL-2.1-or-later",
    "LGPL-3.0-or-later",
}
#: Libraries under another licence that are known and told on the page: package and library.
TOLD = {("pillow-heif", "libx265")}

_NAMES = {
    "apache software license": "Apache-2.0", "apache 2.0": "Apache-2.0", "apache-2.0": "Apache-2.0",
    "psfl": "PSF-2.0", "bsd": "LicenseRef-BSD", "bsd license": "LicenseRef-BSD", "3-clause bsd license": "BSD-3-Clause",
    "bsd 2-clause license": "BSD-2-Clause", "bsd 3-clause license": "BSD-3-Clause",
    "isc license": "ISC", "isc license (iscl)": "ISC", "mit license": "MIT", "the unlicense (unlicense)": "Unlicense",
    "mozilla public license 2.0 (mpl 2.0)": "MPL-2.0", "python software foundation license": "PSF-2.0",
}  # fmt: skip
# Packages whose metadata hold the text of a licence and not its name: what the text is.
_BY_HAND = {"embreex": "BSD-2-Clause"}
_LICENSING = Licensing()


@dataclass(frozen=True, kw_only=True)
class Package:
    """One installed package; ``licences`` all hold at once, each an SPDX expression or what the package calls it."""

    name: str
    version: str
    licences: tuple[str, ...]
    libraries: tuple[str, ...]


def licences_of(distribution: metadata.Distribution) -> tuple[str, ...]:
    """The licences that a package tells; none where it tells none."""
    told = distribution.metadata
    expression = (told.get_all("License-Expression") or [""])[0]
    if expression:
        return (expression,)
    by_hand = _BY_HAND.get(canonicalize_name(distribution.name))
    if by_hand is not None:
        return (by_hand,)
    classifiers = [line for line in told.get_all("Classifier") or [] if line.startswith("License ::")]
    names = [line.split(" :: ")[-1] for line in classifiers if line != "License :: OSI Approved"]
    text = (told.get_all("License") or [""])[0].strip()
    if text and text != "UNKNOWN" and (len(text) < 60 and "\n" not in text):
        names.append(text)
    found = dict.fromkeys(_NAMES.get(name.lower(), name) for name in names)
    if any(name.startswith("BSD-") for name in found):
        found.pop("LicenseRef-BSD", None)  # the classifier does not tell which
    return tuple(found)


def is_allowed(licence: str, allowed: Iterable[str] = ALLOWED) -> bool:
    """Whether an SPDX expression can be kept with licences of the list alone; what is no expression cannot."""
    try:
        return _holds(_LICENSING.parse(licence), frozenset(allowed))
    except ExpressionError:
        return False


def _holds(expression: object, allowed: frozenset[str]) -> bool:
    if isinstance(expression, (LicenseSymbol, LicenseWithExceptionSymbol)):
        return str(expression) in allowed
    if isinstance(expression, _LICENSING.AND):
        return all(_holds(part, allowed) for part in expression.args)
    if isinstance(expression, _LICENSING.OR):
        return any(_holds(part, allowed) for part in expression.args)
    return False


def library_licence(library: str) -> str | None:
    """The licence of a shared library that asks for more; ``None`` for others."""
    known = [prefix for prefix in LIBRARIES if library.startswith(prefix)]
    return LIBRARIES[max(known, key=len)] if known else None


def package(distribution: metadata.Distribution) -> Package:
    """What the metadata tell of a package."""
    return Package(
        name=canonicalize_name(distribution.name),
        # A build for processors or for GPUs is the same release.
        version=Version(distribution.version).public,
        licences=licences_of(distribution),
        libraries=tuple(
            library for library in compiled_in(distribution) if library_licence(library) not in {None, *ALLOWED}
        ),
    )


def groups(
    packages: Installed, root: str = "fsinfer", extras: Sequence[str] = tuple(GROUPS)
) -> dict[str, list[Package]]:
    """The packages that ``root`` needs, by the first extra that brings them, without ``root`` itself."""
    seen = {canonicalize_name(root)}
    found: dict[str, list[Package]] = {}
    for extra in extras:
        # PyTorch's build for GPUs asks for NVIDIA's packages; they are not looked at where they are not installed.
        names = closure(packages, root, [extra] if extra else [], unknown=[WITHOUT])
        found[extra] = [package(packages[name]) for name in sorted(names) if name not in seen]
        seen |= set(names)
    return found


def faults(found: Iterable[Package]) -> list[str]:
    """What is refused: a licence that is not on the list, a package that tells none, a library nobody was told of."""
    wrong: list[str] = []
    for one in found:
        what = f"{one.name} {one.version}"
        if not one.licences:
            wrong.append(f"{what} tells no licence")
        wrong += [f"{what}: {licence!r} is not allowed" for licence in one.licences if not is_allowed(licence)]
        for library in one.libraries:
            licence = library_licence(library)
            if licence not in ALLOWED_LIBRARIES and (one.name, library) not in TOLD:
                wrong.append(f"{what} brings {library}: {licence} is not allowed")
    return wrong


def table(found: Iterable[Package]) -> str:
    """A table in Markdown."""
    lines = ["| package | version | licence | libraries in its wheel that ask for more |", "|---|---|---|---|"]
    for one in found:
        libraries = ", ".join(f"`{library}` ({library_licence(library)})" for library in one.libraries)
        told = " and ".join(licence.replace("LicenseRef-BSD", "BSD") for licence in one.licences) or "not told"
        lines.append(f"| {one.name} | {one.version} | {told} | {libraries} |")
    return "\n".join(lines)


def page(found: dict[str, list[Package]]) -> str:
    """docs/licences.md."""
    parts = [_HEAD]
    parts += [f"## {GROUPS[extra]}\n\n{table(members)}" for extra, members in found.items() if members]
    return "\n\n".join(parts) + "\n"


_HEAD = """\
<!-- Written by `python -m tests.supply licences --write`; changes here are lost. -->
# Licences

fsinfer is under the Apache License 2.0, and so are the networks in its wheel. The wheel holds no code of others; `pip`
brings what it needs as packages of their own, each under its own licence. This page lists them all, with the versions
that fsinfer is tested with (Linux, x86-64, Python 3.11), as the packages' metadata tell. A check refuses a package
whose licence is not on the list of `tests/supply/licences.py`, or that tells none: permissive licences and the MPL are
on it, GPL, AGPL and LGPL are not.

**For whoever passes fsinfer on together with its packages** (an installer, an image of a computer): some wheels hold
compiled libraries under licences that ask for more than the wheel's own.

- **pillow-heif** reads the photographs of iPhones (HEIC). Its wheel holds x265, a video encoder under the GPL 2, and
  its makers say that the wheel as a whole is under the GPL 2 for that. fsinfer only decodes, which needs no encoder.
- **pycolmap** has SuiteSparse's CHOLMOD compiled in, whose supernodal part is under the GPL 2 or later. CGAL (GPL) is
  not in it.
- **opencv-python-headless** brings FFmpeg, and pillow-heif brings libheif and libde265: LGPL, as libraries that can be
  replaced.
- The run-time libraries of GCC (`libgfortran`, `libgomp`) are under the GPL with an exception for what is
  built with GCC.

PyTorch is needed for training alone. Its build for NVIDIA's GPUs brings NVIDIA's packages under NVIDIA's licence; they
are not in the tables, and nothing here needs them.

The parts of a wheel are listed for machines, too (CycloneDX): `python -m tests.supply sbom DIST.whl OUT.json`, see
[CONTRIBUTING.md](../CONTRIBUTING.md)."""

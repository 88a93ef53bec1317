"""Figures of ``docs/results`` in the documents: ``python -m tests.bench.tables``, and ``--check`` to compare only.

A document carries two kinds of marks, which nobody sees on the page::

    RMSE <!-- f:stems-photo.rmse_cm:.2f -->0.24<!-- /f --> cm        one figure, with Python's format
    <!-- figures: headline plot-900101 stems-photo -->               a table of tests.bench.templates
    | measured on | result |
    <!-- /figures -->

What stands between the marks is written from the files. Besides a result's figures ``set``, ``commit``, ``date``,
``command``, ``note`` and ``processor`` can be named. With ``--check`` nothing is written; where a text differs from
its file, document, line, text and the file's value are named, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.bench.results import RESULTS, ROOT, Result, read_result
from tests.bench.templates import TEMPLATES

DOCUMENTS = ("README.md", "CHANGELOG.md", "docs/**/*.md", "models/*.md")
#: A mark opens, then comes the text up to the next mark that closes. A figure stays within a line.
INLINE = re.compile(
    r"<!-- f:(?P<name>[a-z0-9-]+)\.(?P<key>[a-z0-9_]+)(?::(?P<format>[^ ]+))? -->(?P<text>.*?)<!-- /f -->"
)
BLOCK = re.compile(
    r"<!-- figures: (?P<template>[a-z-]+)(?P<names>(?: [a-z0-9-]+)*) -->\n(?P<text>.*?)<!-- /figures -->", re.DOTALL
)
OPENS = re.compile(r"<!-- (?:f:|figures:)")
#: What may stand before a figure only: Markdown takes a line or list item that begins with a comment for HTML.
LINE_BEGINS = re.compile(r"[\s>*+-]*(?:\d+[.)]\s*)?")
#: What a document may quote of a result besides its figures.
ATTRIBUTES = ("set", "commit", "date", "command", "note", "processor")


class TableError(Exception):
    """A mark that cannot be filled: no such file, figure or template, or not closed."""


@dataclass(frozen=True, kw_only=True)
class Mark:
    """One mark of a document: where its text stands, what it says and what the files say."""

    document: str
    line: int
    start: int
    end: int
    label: str
    text: str
    expected: str


def figure(result: Result, key: str, spec: str | None) -> str:
    """One figure as text, with a real minus sign; raises :class:`TableError` where the result has none of that name."""
    if key in ATTRIBUTES:
        return attribute(result, key)
    if key not in result.figures:
        raise TableError(f"{result.name} has no figure {key!r}; it has {', '.join(result.figures)}")
    return format(result.figures[key], spec or "").replace("-", "\N{MINUS SIGN}")


def attribute(result: Result, key: str) -> str:
    """What a result says of itself."""
    if key == "set":
        return result.kind
    if key == "processor":
        cores, model, wide = (result.processor[name] for name in ("cores", "model", "instructions"))
        return f"{cores} cores, {model}, {wide.upper()}{' with VNNI' if result.processor['vnni'] else ''}"
    return result.short_commit if key == "commit" else str(getattr(result, key))


def marks(text: str, document: str, folder: Path = RESULTS) -> Iterator[Mark]:
    """Every mark of a document, in order.

    Raises
    ------
    TableError
        A mark that cannot be filled, with document and line.
    """
    found = sorted([*INLINE.finditer(text), *BLOCK.finditer(text)], key=lambda match: match.start())
    starts = {match.start() for match in found}
    for opening in OPENS.finditer(text):
        within = any(match.start() < opening.start() < match.end() for match in found)
        if opening.start() not in starts and not within:
            raise TableError(f"{document}:{line_of(text, opening.start())}: this mark is not closed or not well formed")
    for match in found:
        line = line_of(text, match.start())
        before = text[text.rfind("\n", 0, match.start()) + 1 : match.start()]
        if match.re is INLINE and LINE_BEGINS.fullmatch(before):
            raise TableError(
                f"{document}:{line}: this mark begins a line, which Markdown takes for HTML; put a word before"
            )
        try:
            label, expected = fill(match.groupdict(), folder)
        except (TableError, KeyError, ValueError) as error:
            raise TableError(f"{document}:{line}: {error}") from error
        yield Mark(
            document=document,
            line=line,
            start=match.start("text"),
            end=match.end("text"),
            label=label,
            text=match["text"],
            expected=expected,
        )


def fill(groups: Mapping[str, str | None], folder: Path) -> tuple[str, str]:
    """What a mark asks for, and the text that the files give."""
    if template := groups.get("template"):
        names = (groups["names"] or "").split()
        if template not in TEMPLATES:
            raise TableError(f"there is no table {template!r}; there are {', '.join(TEMPLATES)}")
        lines = TEMPLATES[template]([load(name, folder) for name in names])
        # Blank lines about the table: not every renderer lets one follow a comment.
        return f"{template} {' '.join(names)}".strip(), "\n" + "".join(f"{line}\n" for line in lines) + "\n"
    name, key = groups["name"], groups["key"]
    if name is None or key is None:
        raise TableError("a mark names a result and a figure")
    return f"{name}.{key}", figure(load(name, folder), key, groups["format"])


def load(name: str, folder: Path) -> Result:
    """Read a result; raises :class:`TableError` where there is none."""
    try:
        return read_result(name, folder)
    except FileNotFoundError as error:
        raise TableError(f"there is no {folder.name}/{name}.json; the benchmark's --result {name} writes it") from error


def line_of(text: str, position: int) -> int:
    """The line of a position, from 1."""
    return text.count("\n", 0, position) + 1


def filled(text: str, found: Sequence[Mark]) -> str:
    """The document with the files' texts between its marks."""
    for mark in reversed(found):
        text = text[: mark.start] + mark.expected + text[mark.end :]
    return text


def differences(found: Sequence[Mark]) -> list[str]:
    """One line for each mark whose text is not what the files give; of a table, its first line that differs."""
    told = []
    for mark in found:
        if mark.text == mark.expected:
            continue
        old, new = mark.text.splitlines(), mark.expected.splitlines()
        at = next((i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), min(len(old), len(new)))
        # The text of a table begins in the line below its mark.
        line = mark.line + (at + 1 if mark.expected.endswith("\n") else 0)
        here, there = (lines[at] if at < len(lines) else "(no such line)" for lines in (old, new))
        told.append(f"{mark.document}:{line}: {mark.label}: the text says {here!r}, the file {there!r}")
    return told


def documents(root: Path = ROOT) -> list[Path]:
    """The documents that may carry marks."""
    return sorted({path for pattern in DOCUMENTS for path in root.glob(pattern)})


def main(argv: list[str] | None = None) -> int:
    """Write or compare."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.tables", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="write nothing, name what differs")
    args = parser.parse_args(argv)
    told: list[str] = []
    for path in documents():
        text = path.read_text(encoding="utf-8")
        try:
            found = list(marks(text, path.relative_to(ROOT).as_posix()))
        except TableError as error:
            print(error, file=sys.stderr)
            return 1
        told += differences(found)
        if not args.check and (new := filled(text, found)) != text:
            path.write_text(new, encoding="utf-8")
    print("\n".join(told) if told else "every figure is that of its file")
    return 1 if told and args.check else 0


if __name__ == "__main__":
    raise SystemExit(main())

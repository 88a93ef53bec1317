"""Docstrings as the reference shows them: one-line entries made numpydoc's, reStructuredText's roles made Markdown.

In the sources an entry of a section is ``name: text``, which reads better than a name, a type that the signature says
anyway, and a text on three lines.
"""

from __future__ import annotations

import re
import textwrap
from typing import Any

import griffe

_ROLE = re.compile(r":\w+:`~?\.?([^`]+)`")
_SECTION = re.compile(r"^(Parameters|Attributes)\n-+\n", flags=re.MULTILINE)
_ENTRY = re.compile(r"^(\w+(?:, \w+)*): (.*)$")


def numpydoc(text: str) -> str:
    """Return a docstring of ours as numpydoc's, for the reader of the reference."""
    text = _ROLE.sub(r"`\1`", text).replace("``", "`")
    pieces = _SECTION.split(text)
    # split: text before, then name and text of each section in turn.
    result = pieces[0]
    for name, body in zip(pieces[1::2], pieces[2::2], strict=True):
        result += f"{name}\n{'-' * len(name)}\n{_entries(body)}"
    return _returns(result)


def _entries(body: str) -> str:
    lines, inside = [], True
    for line in body.split("\n"):
        entry = _ENTRY.match(line) if inside else None
        if entry:
            lines += [entry[1], f"    {entry[2]}"]
        else:
            # The first line after an empty one that is no entry begins something else: another section, or text.
            inside = inside and (not line or line.startswith(" "))
            lines.append(line)
    return "\n".join(lines)


def _returns(text: str) -> str:
    # An entry of no name and no type: else the first line of the text would be taken for a type.
    return re.sub(
        r"^(Returns|Yields)\n(-+)\n((?:.+\n?)+)",
        lambda found: f"{found[1]}\n{found[2]}\n:\n{textwrap.indent(found[3], '    ')}",
        text,
        flags=re.MULTILINE,
    )


class OwnDocstrings(griffe.Extension):
    """Lets every docstring pass through :func:`numpydoc`."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Change the docstring where there is one."""
        if obj.docstring:
            obj.docstring.value = numpydoc(obj.docstring.value)

"""Notices in words, for the terminal, the tables and the report: lower case, no full stop, the way out included."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fsinfer.notices import capture, stems
from fsinfer.notices.notice import Notice

_TEMPLATES: Mapping[str, str] = {
    code.value: text for part in (capture.SENTENCES, stems.SENTENCES) for code, text in part.items()
}
_REMARKS = frozenset(code.value for code in (*capture.REMARKS, *stems.REMARKS))
_ADVISES_REVISIT = frozenset(code.value for code in stems.ADVISES_REVISIT)


def sentence(given: Notice) -> str:
    """What a notice says; that of an unknown code, of a later version, is the code with its values."""
    template = _TEMPLATES.get(given.code)
    if template is None:
        values = ", ".join(f"{key} {value}" for key, value in given.items)
        return f"{given.code}: {values}" if values else given.code
    listed = {key: ", ".join(value) if isinstance(value, tuple) else value for key, value in given.items}
    return template.format(**listed)


def sentences(given: Iterable[Notice]) -> tuple[str, ...]:
    """What each notice says."""
    return tuple(sentence(item) for item in given)


def joined(given: Iterable[Notice]) -> str:
    """All in one cell of a table, with semicolons between."""
    return "; ".join(sentences(given))


def is_remark(given: Notice) -> bool:
    """Of use to those who look closely, nothing to act upon."""
    return given.code in _REMARKS


def advises_revisit(given: Notice) -> bool:
    """Whether its sentence says already that the stem has to be walked round again."""
    return given.code in _ADVISES_REVISIT

"""Notices in words, for the terminal, the tables and the report: lower case, no full stop, the way out included."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from fsinfer.notices import capture, plots, sample, stems
from fsinfer.notices.notice import Notice, Value
from fsinfer.notices.numbers import Counting

_SAID: dict[str, str | Callable[[Mapping[str, Any]], str]] = {
    **{code.value: text for code, text in capture.SENTENCES.items()},
    **{code.value: text for code, text in stems.SENTENCES.items()},
    **{code.value: text for code, text in plots.SENTENCES.items()},
    **{code.value: text for code, text in sample.SENTENCES.items()},
}
_ADVICE: Mapping[str, str] = {code.value: text for code, text in stems.ADVICE.items()}
_REMARKS = frozenset(code.value for code in (*capture.REMARKS, *stems.REMARKS))
_TEMPLATES = Counting()
#: Names that a sentence has at most; the notice itself keeps all. Source: layout; of a hectare's stems it would fill
#: screens.
_MOST_NAMES = 60
_ADVISES_REVISIT = frozenset(code.value for code in stems.ADVISES_REVISIT)


def sentence(given: Notice) -> str:
    """What a notice says, with the advice that follows; an unknown code, of a later version, stands for itself."""
    advice = _ADVICE.get(given.code)
    said = headline(given)
    return said if advice is None else f"{said}; {advice}"


def headline(given: Notice) -> str:
    """What a notice says, without the advice that follows."""
    said = _SAID.get(given.code)
    if said is None:
        values = ", ".join(f"{key} {value}" for key, value in given.items)
        return f"{given.code}: {values}" if values else given.code
    if not isinstance(said, str):
        return said(given.values)
    return _TEMPLATES.format(said, **{key: _in_words(value) for key, value in given.items})


def _in_words(value: Value) -> str | int | float | None:
    if isinstance(value, tuple):
        names = [headline(item) if isinstance(item, Notice) else item for item in value[:_MOST_NAMES]]
        return ", ".join(names) + (f" and {len(value) - _MOST_NAMES} more" if len(value) > _MOST_NAMES else "")
    return headline(value) if isinstance(value, Notice) else value


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

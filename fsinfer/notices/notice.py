"""A notice: a code with the values that belong to it.

Stages return notices, never sentences: a program decides by the code, and :mod:`fsinfer.notices.sentences` says it in
words. A notice is either a *warning* of a stage or the *reason* for a tree's status.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeAlias

from fsinfer.errors import InputError

#: What a notice may hold: JSON scalars, other notices, and tuples of texts or of notices.
Value: TypeAlias = "str | int | float | bool | Notice | tuple[str, ...] | tuple[Notice, ...] | None"


@dataclass(frozen=True, kw_only=True)
class Notice:
    """A code with its values.

    Attributes
    ----------
    code: one of the enums of this package, such as :class:`fsinfer.notices.stems.StemCode`.
    items: values by name, as pairs, so that notices can be compared and hashed.
    """

    code: str
    items: tuple[tuple[str, Value], ...] = ()

    @property
    def values(self) -> dict[str, Value]:
        """The values by name."""
        return dict(self.items)


def notice(code: StrEnum, **values: Value) -> Notice:
    """Make a notice."""
    return Notice(code=code.value, items=tuple(values.items()))


def notice_json(given: Notice) -> dict[str, object]:
    """``{"code", "values"}`` of a notice as JSON values."""
    return {"code": given.code, "values": {key: _value_json(value) for key, value in given.items}}


def _value_json(value: Value) -> object:
    if isinstance(value, tuple):
        return [_value_json(item) for item in value]
    return notice_json(value) if isinstance(value, Notice) else value


def notice_of_json(entry: object) -> Notice:
    """Read what :func:`notice_json` wrote; :class:`InputError` for anything else."""
    if not isinstance(entry, Mapping) or not isinstance(entry.get("code"), str):
        msg = f"{entry!r} is no notice; delete the output folder's .fsinfer and run the command again"
        raise InputError(msg)
    values = entry.get("values") or {}
    return Notice(code=entry["code"], items=tuple((str(key), _value_of_json(v)) for key, v in values.items()))


def _value_of_json(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_value_of_json(item) for item in value)
    return notice_of_json(value) if isinstance(value, Mapping) else value

"""JSON as people and damaged disks leave it: what cannot be read is a ValueError, and what was read can be written."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

#: Digits of a whole number: one of more is no number of ours, and none that a float can hold. Source: format; IEEE 754.
_MOST_DIGITS = 300
#: Lists and objects within one another: functions that call themselves get so far. Source: judgement; ours have ten.
_MOST_DEEP = 100


def parse_json(text: str) -> Any:
    """The value of a JSON text.

    Raises
    ------
    ValueError
        It is no JSON, is nested deeper than Python reads, or holds a number or a text that nothing can be done with.
    """
    try:
        value = json.loads(text, parse_int=_whole)
    except RecursionError:
        msg = "its values are nested too deeply"
        raise ValueError(msg) from None
    _check_depth(value)
    if "\\ud" in text.lower():
        # Half of a letter of two codes: it can be read, but never be written as UTF-8.
        try:
            json.dumps(value, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            msg = "a text in it holds half of a letter"
            raise ValueError(msg) from None
    return value


def read_json(path: Path, *, encoding: str = "utf-8") -> Any:
    """The value of a JSON file; raises OSError, and ValueError as :func:`parse_json` does."""
    return parse_json(path.read_text(encoding=encoding))


def _check_depth(value: Any) -> None:
    level = [value]
    for _ in range(_MOST_DEEP):
        level = [item for one in level if isinstance(one, (dict, list)) for item in _inside(one)]
        if not level:
            return
    msg = "its values are nested too deeply"
    raise ValueError(msg)


def _inside(value: dict[str, Any] | list[Any]) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value


def _whole(digits: str) -> int:
    if len(digits) > _MOST_DIGITS:
        msg = f"a number of {len(digits)} digits"
        raise ValueError(msg)
    return int(digits)

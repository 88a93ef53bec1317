"""Settings and results as JSON values, and results back from them."""

from __future__ import annotations

import types
import typing
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fsinfer.notices.notice import Notice, notice_json, notice_of_json

T = TypeVar("T")


def as_json(value: Any, *, folder: Path | None = None) -> Any:
    """Turn settings and results (frozen dataclasses, notices, enums, paths, tuples, NumPy values) into JSON values.

    ``folder``: paths below it are written relative to it, so that the folder may be moved.
    """
    if isinstance(value, Notice):
        return notice_json(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: as_json(getattr(value, field.name), folder=folder) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): as_json(item, folder=folder) for key, item in value.items()}
    if isinstance(value, Enum):
        return as_json(value.value, folder=folder)
    if isinstance(value, Path):
        return value.relative_to(folder).as_posix() if folder and value.is_relative_to(folder) else str(value)
    if hasattr(value, "tolist"):
        return as_json(value.tolist(), folder=folder)
    if isinstance(value, (list, tuple)):
        return [as_json(item, folder=folder) for item in value]
    if isinstance(value, (set, frozenset)):
        return sorted(as_json(item, folder=folder) for item in value)
    if value is None or isinstance(value, (str, int, float, bool)):
        return value
    msg = f"cannot write a {type(value).__name__} into a stage record"
    raise TypeError(msg)


def of_json(kind: type[T], value: Any, *, folder: Path | None = None) -> T:
    """Read a result of type ``kind`` back from what :func:`as_json` made of it.

    Raises
    ------
    TypeError, ValueError, KeyError, OverflowError
        The value is not of this type: it was written by another version.
    """
    result: T = _read(kind, value, folder)
    return result


def _read(kind: Any, value: Any, folder: Path | None) -> Any:
    origin = typing.get_origin(kind)
    # From NumPy 2.5 on NDArray is an alias (PEP 695), which only stands for the type.
    origin = typing.get_origin(getattr(origin, "__value__", None)) or origin
    if origin in (typing.Union, types.UnionType):
        return _read_union(typing.get_args(kind), value, folder)
    if kind is Notice:
        return notice_of_json(value)
    if isinstance(kind, type) and is_dataclass(kind):
        hints = _hints(kind)
        if not isinstance(value, dict) or set(value) != set(hints):
            msg = f"{value!r} is no {kind.__name__}"
            raise TypeError(msg)
        return kind(**{name: _read(hint, value[name], folder) for name, hint in hints.items()})
    if origin is tuple:
        parts = typing.get_args(kind)
        each = [parts[0]] * len(value) if len(parts) == 2 and parts[1] is Ellipsis else list(parts)
        return tuple(_read(part, item, folder) for part, item in zip(each, value, strict=True))
    if origin in (dict, Mapping):
        return {key: _read(typing.get_args(kind)[1], item, folder) for key, item in value.items()}
    if origin is np.ndarray:
        return np.asarray(value, dtype=np.float64)
    if kind is Path:
        return _path(folder, value)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if kind is not Any and not isinstance(value, kind):
        msg = f"{value!r} is no {kind}"
        raise TypeError(msg)
    return value


def _path(folder: Path | None, value: Any) -> Path:
    """A path as :func:`as_json` writes it: below the folder, whatever a record says that somebody has sent."""
    path = Path(value)
    if folder is None:
        return path
    if path.is_absolute() or ".." in path.parts:
        msg = f"{value!r} leads out of {folder}"
        raise ValueError(msg)
    return folder / path


def _read_union(kinds: tuple[Any, ...], value: Any, folder: Path | None) -> Any:
    if value is None and type(None) in kinds:
        return None
    for kind in kinds:
        try:
            return _read(kind, value, folder)
        except (TypeError, ValueError, KeyError, OverflowError):
            continue
    msg = f"{value!r} is none of {kinds}"
    raise TypeError(msg)


@cache
def _hints(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)

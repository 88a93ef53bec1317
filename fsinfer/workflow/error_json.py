"""Errors as JSON values, from one process of ours to another, so that both end alike: same words, same exit code."""

from __future__ import annotations

import builtins
import traceback
from collections.abc import Mapping
from typing import Any

from fsinfer import errors
from fsinfer.errors import FsinferError


class TraceThereError(Exception):
    """The trace of an error in the process where it was raised; the cause of what is raised here."""

    def __str__(self) -> str:
        return "\n" + super().__str__()


def error_json(error: Exception) -> dict[str, Any]:
    """Class, arguments, message and trace of an error, as JSON values."""
    # A class of its own somewhere counts as the next one that everybody knows.
    known = next((kind.__name__ for kind in type(error).__mro__ if kind.__module__ == errors.__name__), None)
    arguments = list(error.args)
    if isinstance(error, OSError) and isinstance(error.filename, str):
        arguments = [*arguments[:2], error.filename]
    return {
        "kind": known or type(error).__name__,
        "module": errors.__name__ if known else type(error).__module__,
        "arguments": arguments if all(_is_scalar(value) for value in arguments) else None,
        "message": str(error),
        "trace": "".join(traceback.format_exception(error)),
    }


def error_of_json(entry: Mapping[str, Any]) -> Exception:
    """The error to be raised here, with the trace from there as its cause.

    Ours and Python's own come back as what they were, those of other libraries as ``RuntimeError`` with their name.
    """
    kind, message, arguments = entry["kind"], entry["message"], entry["arguments"]
    error: Exception = RuntimeError(f"{kind}: {message}")
    home = {errors.__name__: errors, builtins.__name__: builtins}.get(entry["module"])
    of_kind = getattr(home, kind, None)
    if isinstance(of_kind, type) and issubclass(of_kind, FsinferError):
        error = of_kind(message)
    elif isinstance(of_kind, type) and issubclass(of_kind, Exception) and arguments is not None:
        error = of_kind(*arguments)
    error.__cause__ = TraceThereError(entry["trace"])
    return error


def _is_scalar(value: Any) -> bool:
    return value is None or isinstance(value, (str, int, float, bool))

"""Minutes after capture, from poses and a quick look at the depth: what has to be photographed again.

The names are loaded when they are first used, so that the command line shows the settings' defaults at once.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fsinfer.check.result import CheckResult
    from fsinfer.check.run import CheckSettings, check_capture

_HOME = {
    "CheckResult": "fsinfer.check.result",
    "CheckSettings": "fsinfer.check.run",
    "check_capture": "fsinfer.check.run",
}

__all__ = ["CheckResult", "CheckSettings", "check_capture"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        msg = f"module 'fsinfer.check' has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(import_module(_HOME[name]), name)

"""``plot.json``: read and written."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from fsinfer._version import __version__
from fsinfer.errors import InputError
from fsinfer.io.files import write_text
from fsinfer.io.json_text import read_json
from fsinfer.output.json_values import as_json
from fsinfer.output.layout import OutputFolder

#: Where ``plot.json`` keeps unit and scale of the cloud's file, when the trees were measured at another scale. Source:
#: format; ours.
OF_FILE = "cloud"
_PACKAGES = ("fsinfer", "numpy", "scipy", "onnxruntime", "opencv-python-headless", "pycolmap", "laspy")


def write_plot(out: Path, plot: Mapping[str, Any]) -> Path:
    """Write ``plot.json`` into ``out`` unless it holds the same already."""
    path = OutputFolder(out).plot_json
    text = json.dumps(finite(as_json(plot)), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    if not path.is_file() or path.read_bytes() != text.encode():
        write_text(path, text)
    return path


def read_plot(out: Path) -> dict[str, Any]:
    """Read ``plot.json`` of ``out``; an empty dict when there is none.

    Raises :class:`InputError` when it is damaged.
    """
    path = OutputFolder(out).plot_json
    try:
        plot = read_json(path)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        msg = f"{path} cannot be read ({error}); delete it and run the command that wrote it again"
        raise InputError(msg) from error
    if not isinstance(plot, dict):
        msg = f"{path} is no plot summary; delete it and run the command that wrote it again"
        raise InputError(msg)
    return plot


def of_file(plot: dict[str, Any]) -> dict[str, Any]:
    """A ``plot.json`` in which unit and scale are those of the cloud's file, where the trees have others."""
    own = plot.get(OF_FILE)
    return plot | own if isinstance(own, dict) else plot


@cache
def package_versions() -> dict[str, str | None]:
    """Versions of Python and of the packages that decide the result; None for one that is not installed."""
    versions: dict[str, str | None] = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            versions[package] = None
    # In a source tree that is not installed there are no metadata of fsinfer itself.
    return versions | {"fsinfer": __version__}


def finite(value: Any) -> Any:
    """Replace NaN and infinities, which JSON does not have, by None."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value

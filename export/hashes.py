"""The hashes in a model's manifest, which tell its graphs from any others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fsinfer.depth.manifest import hash_files
from fsinfer.depth.surface import SURFACE


def rehash(data: dict[str, Any], folder: Path) -> None:
    """Bring the hashes of both precisions in a manifest up to the graphs in ``folder`` that it names now."""
    exact = {role: entry["file"] for role, entry in data["graphs"].items()}
    if SURFACE in data:
        exact[SURFACE] = data[SURFACE]["file"]
    data["sha256"] = hash_files([folder / name for name in exact.values()])
    if "int8" in data:
        quick = [data["int8"].get(role, name) for role, name in exact.items()]
        data["int8"]["sha256"] = hash_files([folder / name for name in quick])

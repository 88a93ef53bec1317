"""Photographs on the disk of a worker that does not see ours: each is sent once, before a view that needs it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fsinfer.cluster.pieces import make_scratch, pieces_of, write_pieces
from fsinfer.cluster.workers import scratch_of_worker
from fsinfer.scene import View

#: Calls a function on the worker and returns what it returns.
Call = Callable[..., Any]


class SentPhotos:
    """Those of one worker, in a folder of its own there."""

    def __init__(self, call: Call) -> None:
        self._call = call
        self._sent: set[str] = set()
        self.folder: str = call(make_scratch, call(scratch_of_worker))

    def send(self, views: Sequence[View]) -> list[View]:
        """The views with paths on the worker, where their photographs are afterwards."""
        missing = {view.image_path.name: view.image_path for view in views if view.image_path.name not in self._sent}
        for pieces in pieces_of(missing):
            self._call(write_pieces, self.folder, pieces)
        self._sent |= set(missing)
        return [replace(view, image_path=Path(self.folder) / view.image_path.name) for view in views]

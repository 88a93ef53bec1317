"""A scene whose views have a true depth map, whatever its layout on disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fsinfer.io.pfm import read_pfm
from fsinfer.scene import Scene, View, read_scene

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")


class TrueScene(Protocol):
    """A scene whose views have a true depth map."""

    @property
    def name(self) -> str:
        """Name for messages and tables."""
        ...

    def read(self) -> Scene:
        """Cameras, photographs and sources, intrinsics in pixels of the photographs; SceneError where incomplete."""
        ...

    def true_depth(self, view: View) -> NDArray[np.float32] | None:
        """(H, W) float32 z depth, 0 where unknown: of the photograph's size or an integer part of it. None: no map."""
        ...


@dataclass(frozen=True, kw_only=True)
class DepthsFolder:
    """A scene in MVSNet format with ``depths/NAME.pfm``, as ``training.synthesize`` writes it."""

    folder: Path

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.name

    def read(self) -> Scene:
        """Read the scene; SceneError where it is incomplete."""
        return read_scene(self.folder)

    def true_depth(self, view: View) -> NDArray[np.float32] | None:
        """Read ``depths/NAME.pfm``, None where the view has none."""
        path = self.folder / "depths" / f"{view.name}.pfm"
        return read_pfm(path) if path.is_file() else None

"""Where scenes with true depth lie on disk: our own folders, the DTU release for training, BlendedMVS.

Each layout is a :class:`TrueScene`; the kind of a folder is seen from what it holds, so that every command that
takes folders of scenes takes any of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fsinfer.pfm import read_pfm
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


def find_true_scenes(roots: Sequence[Path], split: Split = "train") -> list[TrueScene]:
    """Every scene with true depth in or below ``roots``.

    A root is taken for the DTU training release where it holds ``Cameras/pair.txt`` and ``Rectified``, for BlendedMVS
    where it holds ``HASH/blended_images``; of those only the scenes of ``split`` are listed. Of any other root it is
    every folder with ``pair.txt`` and ``depths``, whatever the split.
    """
    from training.blendedmvs import blendedmvs_scenes, is_blendedmvs
    from training.dtu import dtu_root, dtu_scans

    found: list[TrueScene] = []
    folders: set[Path] = set()
    for root in roots:
        dtu = dtu_root(root)
        if dtu is not None:
            found += dtu_scans(dtu, split)
        elif is_blendedmvs(root):
            found += blendedmvs_scenes(root, split)
        else:
            folders |= {p.parent for p in root.rglob("pair.txt") if (p.parent / "depths").is_dir()}
    return [*found, *(DepthsFolder(folder=folder) for folder in sorted(folders))]

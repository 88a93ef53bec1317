"""BlendedMVS (Yao et al., CVPR 2020) as it is released, low (768x576) or high resolution.

The release::

    BlendedMVS_training.txt, validation_list.txt      one HASH a line (also found in ``project_lists``)
    HASH/blended_images/00000000.jpg                  and 00000000_masked.jpg, which is not used
    HASH/cams/00000000_cam.txt                        depth line "min interval planes max"; HASH/cams/pair.txt
    HASH/rendered_depth_maps/00000000.pfm             of the photograph's size, 0 = nothing there

Its README warns of views with a depth range that is not positive, of fewer than ten sources and of empty depth maps;
such views are left out here, or are drawn again by :class:`training.data.samples.SceneSamples`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.io.pfm import read_pfm
from fsinfer.scene import Scene, View, read_camera, read_pairs
from training.data.true_scene import Split

TRAINING_LISTS = ("BlendedMVS_training.txt", "training_list.txt", "BlendedMVG_training.txt")
VALIDATION_LISTS = ("validation_list.txt",)
# The release's own validation scenes, so that a download without the lists is not trained on them.
VALIDATION_SCENES = (
    "5b7a3890fc8fcf6781e2593a", "5c189f2326173c3a09ed7ef3", "5b950c71608de421b1e7318f", "5a6400933d809f1d8200af15",
    "59d2657f82ca7774b1ec081d", "5ba19a8a360c7c30c1c169df", "59817e4a1bd4b175e7038d19",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class BlendedScene:
    """One scene of the release."""

    folder: Path

    @property
    def name(self) -> str:
        """The scene's hash."""
        return self.folder.name

    def read(self) -> Scene:
        """All usable views; SceneError where the pair list is missing or no view can be used."""
        return _read(self.folder)

    def true_depth(self, view: View) -> NDArray[np.float32]:
        """(H, W) float32 in the scene's unit, 0 outside of the camera's depth range; SceneError without a map."""
        path = self.folder / "rendered_depth_maps" / f"{view.name}.pfm"
        depth = np.nan_to_num(read_pfm(path), nan=0.0, posinf=0.0, neginf=0.0)
        inside = (depth >= view.camera.depth_min) & (depth <= view.camera.depth_max)
        return np.where(inside, depth, np.float32(0))


def is_blendedmvs(root: Path) -> bool:
    """Whether ``root`` holds ``HASH/blended_images``."""
    return root.is_dir() and any((child / "blended_images").is_dir() for child in root.iterdir())


def blendedmvs_scenes(root: Path, split: Split) -> list[BlendedScene]:
    """Scenes of a split that are there.

    Without a training list every scene that is not for validation is for training. There is no test split.

    Raises
    ------
    SceneError
        No scene of the split is there, or the split is ``test``.
    """
    if split == "test":
        msg = f"{root}: BlendedMVS has no test split; use the validation split"
        raise SceneError(msg)
    there = sorted(child.name for child in root.iterdir() if (child / "blended_images").is_dir())
    validation = set(_listed(root, VALIDATION_LISTS) or VALIDATION_SCENES)
    wanted = validation if split == "validation" else set(_listed(root, TRAINING_LISTS) or there) - validation
    found = [BlendedScene(folder=root / name) for name in there if name in wanted]
    if not found:
        msg = f"{root} holds none of the {len(wanted)} scenes of the {split} split; check its lists, or unpack it again"
        raise SceneError(msg)
    return found


def _listed(root: Path, names: tuple[str, ...]) -> list[str]:
    """Hashes in the first of the lists that is there; empty without one."""
    for folder in (root, root / "project_lists", root.parent):
        for name in names:
            if (folder / name).is_file():
                return (folder / name).read_text(encoding="utf-8").split()
    return []


@lru_cache(maxsize=512)
def _read(folder: Path) -> Scene:
    cameras = {}
    pairs = read_pairs(folder / "cams" / "pair.txt")
    for number in sorted(pairs):
        try:
            cameras[number] = read_camera(folder / "cams" / f"{number:08d}_cam.txt")
        except SceneError:
            continue  # a missing camera, or one of the few whose depth range is not positive
    rank = {number: i for i, number in enumerate(cameras)}
    views = [
        View(
            name=f"{number:08d}",
            image_path=folder / "blended_images" / f"{number:08d}.jpg",
            camera=camera,
            sources=tuple(rank[s] for s in pairs[number] if s in rank and s != number),
        )
        for number, camera in cameras.items()
    ]
    if not views:
        msg = f"{folder / 'cams'} holds no camera with a positive depth range; unpack the scene again"
        raise SceneError(msg)
    return Scene(folder=folder, views=tuple(views))

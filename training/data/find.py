"""Where scenes with true depth lie on disk: our own folders, the DTU release for training, BlendedMVS.

Each layout is a :class:`TrueScene`; the kind of a folder is seen from what it holds, so that every command that
takes folders of scenes takes any of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from training.data.true_scene import DepthsFolder, Split, TrueScene


def find_true_scenes(roots: Sequence[Path], split: Split = "train") -> list[TrueScene]:
    """Every scene with true depth in or below ``roots``.

    A root is taken for the DTU training release where it holds ``Cameras/pair.txt`` and ``Rectified``, for BlendedMVS
    where it holds ``HASH/blended_images``; of those only the scenes of ``split`` are listed. Of any other root it is
    every folder with ``pair.txt`` and ``depths``, whatever the split.
    """
    from training.data.blendedmvs import blendedmvs_scenes, is_blendedmvs
    from training.data.dtu import dtu_root, dtu_scans

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


def in_both(roots: Sequence[Path], others: Sequence[Path]) -> list[Path]:
    """The folders of scenes in or below ``roots`` that are in or below ``others``, too, sorted.

    Of the DTU release and of BlendedMVS there are none: their splits are kept apart.
    """
    ours, theirs = (
        {scene.folder.resolve() for scene in find_true_scenes(part) if isinstance(scene, DepthsFolder)}
        for part in (roots, others)
    )
    return sorted(ours & theirs)

"""The sparse points of structure from motion."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import SceneError
from fsinfer.poses.colmap_calls import require_pycolmap
from fsinfer.poses.model_files import why_damaged

_log = logging.getLogger(__name__)

#: Photos that see a point which can be trusted. Source: a third one is the first that can contradict two.
LONG_TRACK = 3


@dataclass(frozen=True, kw_only=True)
class SparseModel:
    """Points of structure from motion, in the coordinates of the scene.

    Attributes
    ----------
    points: (N, 3) float64, scene units.
    errors_px: (N,) float64, mean reprojection error.
    track_lengths: (N,) int64, in how many photos each was seen.
    observations: ``{view name: (M,) int64}``, sorted indices into ``points``.
    """

    points: NDArray[np.float64]
    errors_px: NDArray[np.float64]
    track_lengths: NDArray[np.int64]
    observations: Mapping[str, NDArray[np.int64]]


def read_sparse(folder: Path | str) -> SparseModel:
    """Read a COLMAP model; views are called by the image name without its suffix.

    Raises
    ------
    SceneError
        The folder is missing or holds no model.
    """
    folder = Path(folder)
    if not (folder / "points3D.bin").is_file() and not (folder / "points3D.txt").is_file():
        msg = f"{folder} holds no COLMAP model (points3D.bin); make the scene with: fsinfer poses"
        raise SceneError(msg)
    require_pycolmap()
    import pycolmap

    try:
        why = why_damaged(folder)
        if why:
            raise ValueError(why)
        model = pycolmap.Reconstruction(folder)
        return sparse_of(model)
    except (OSError, RuntimeError, ValueError, IndexError, KeyError, TypeError) as error:
        msg = f"{folder} is no complete COLMAP model ({error}); make the scene again with: fsinfer poses"
        raise SceneError(msg) from error


def sparse_of(model: Any) -> SparseModel:
    """Take the points out of a ``pycolmap.Reconstruction``."""
    ids = sorted(model.points3D)
    rank = {point_id: index for index, point_id in enumerate(ids)}
    points = [model.points3D[point_id] for point_id in ids]
    observations = {}
    for image_id in model.reg_image_ids():
        image = model.images[image_id]
        seen = {rank[point.point3D_id] for point in image.get_observation_points2D()}
        observations[Path(image.name).stem] = np.array(sorted(seen), dtype=np.int64)
    return SparseModel(
        points=np.array([point.xyz for point in points], dtype=np.float64).reshape(-1, 3),
        errors_px=np.array([point.error for point in points], dtype=np.float64),
        track_lengths=np.array([point.track.length() for point in points], dtype=np.int64),
        observations=observations,
    )

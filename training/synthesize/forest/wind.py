"""A breeze: from photograph to photograph leaves, undergrowth and thin stems stand elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.mesh import Mesh
from training.synthesize.forest.terrain import Terrain

#: Stems thinner than this sway, metres. Source: judgement; poles of the understorey.
SWAYING_DBH_M = 0.12
#: A thin stem's top sways so many times as far as a leaf flutters, growing from its foot with this power of the
#: height. Source: about that of a bending cantilever.
STEM_SWAY, STEM_POWER = 5.0, 1.5
#: Height above the ground at which undergrowth moves as far as a leaf in a crown, metres. Source: judgement.
FREE_HEIGHT_M = 0.5
#: Wavelength of a gust, metres: neighbouring leaves move together. Source: judgement.
GUST_M = 3.0
#: Waves that a gust is made of, and the share of the movement that is each leaf's own. Source: numerics; judgement.
_WAVES, _OWN = 6, 0.6


def plant_weights(mesh: Mesh, terrain: Terrain) -> NDArray[np.float32]:
    """How far each vertex moves, (N,) 0..1: not at all at the ground, so that litter lies still."""
    x, y, z = mesh.vertices.T
    return np.asarray(np.clip((z - terrain.height(x, y) - 0.02) / FREE_HEIGHT_M, 0, 1), np.float32)


def stem_weights(mesh: Mesh, z_ground_m: float, height_m: float) -> NDArray[np.float32]:
    """The same for a swaying stem, (N,), in times of a leaf's movement."""
    share = np.clip((mesh.vertices[:, 2] - z_ground_m) / height_m, 0, 1)
    return np.asarray(STEM_SWAY * share**STEM_POWER, np.float32)


def blown(
    rng: np.random.Generator,
    vertices: NDArray[np.float32],
    weights: NDArray[np.float32],
    strength_m: float,
    *,
    own: int,
) -> NDArray[np.float32]:
    """The vertices (N, 3) where the wind holds them at one moment.

    Parameters
    ----------
    strength_m: root mean square displacement where the weight is 1.
    own: so many vertices in a row (the corners of a card) have a movement of their own; 0 = only the gust.
    """
    turn = rng.uniform(0, 2 * np.pi, _WAVES)
    wave = 2 * np.pi / GUST_M * np.stack([np.cos(turn), np.sin(turn)]) * rng.uniform(0.5, 1.5, _WAVES)
    phase = vertices[:, :2].astype(np.float64) @ wave + rng.uniform(0, 2 * np.pi, _WAVES)
    # Mostly sideways; the mean square of a sine is a half.
    push = rng.standard_normal((_WAVES, 3)) * [1.0, 1.0, 0.4]
    push *= np.sqrt(2 / (push**2).sum())
    share = np.sqrt(1 - _OWN**2) if own else 1.0
    moved = share * (np.sin(phase) @ push)
    if own:
        flutter = rng.standard_normal((len(vertices) // own, 3)) * [1.0, 1.0, 0.4] / np.sqrt(2.16)
        moved += _OWN * np.repeat(flutter, own, axis=0)
    result: NDArray[np.float32] = vertices + (strength_m * weights[:, None] * moved).astype(np.float32)
    return result

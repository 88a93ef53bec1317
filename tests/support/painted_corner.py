"""Photos of a wall and a floor with paint on them, by a phone that moves while it reads them out; all exactly known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fsinfer.poses.adjustment.problem import Observations, Unknowns
from fsinfer.poses.adjustment.projection import DRIFT, FOCAL, LENS, OWN, PRINCIPAL, TURN, Floats, read_at
from tests.support.phone_walk import FOCAL_PX, HEIGHT, WIDTH, look_at, observations

#: Metres of a texel, and metres of the wall and the floor.
_TEXEL, _SIDE = 0.004, 9.0
#: How far the wall is from the middle of the walk, and the floor below it.
_WALL_M, _FLOOR_M = 4.0, 1.5


def painted_corner(
    folder: Path,
    *,
    photos: int = 10,
    effects: Floats | None = None,
    noise_px: float = 0.4,
    shifted_px: float = 0.0,
    painted: bool = True,
    seed: int = 0,
) -> tuple[Observations, Unknowns]:
    """Write photos ``00000.jpg`` and so on; features with ``noise_px``, and the truth behind them.

    ``effects``: (9,) standard deviations of each photo's own. ``shifted_px``: of each photo's paint against its
    features, standard deviation; ``painted``: else there is nothing but noise in the photos.
    """
    rng = np.random.default_rng(seed)
    centers = np.stack(
        [np.linspace(-1.5, 1.5, photos), rng.normal(0, 0.3, photos), rng.normal(0, 0.15, photos)], axis=1
    )
    targets = np.stack([0.5 * centers[:, 0], np.full(photos, _WALL_M), np.full(photos, -0.8)], axis=1)
    rotations = np.array([look_at(c, t, rng.normal(0, 0.4)) for c, t in zip(centers, targets, strict=True)])
    own = np.zeros((photos, OWN)) if effects is None else effects * rng.standard_normal((photos, OWN))
    lens = np.zeros((1, LENS))
    lens[0, :4] = FOCAL_PX, FOCAL_PX, WIDTH / 2, HEIGHT / 2
    truth = Unknowns(
        rotations=rotations,
        translations=-np.einsum("nij,nj->ni", rotations, centers),
        own=own,
        lenses=lens,
        points=np.empty((0, 3)),
    )
    paints = [paint(rng, round(_SIDE / _TEXEL)) for _ in range(2)]
    points = []
    for photo in range(photos):
        xy = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), axis=-1).reshape(-1, 2)
        shift = rng.normal(0, shifted_px, 2) if shifted_px else np.zeros(2)
        places, on_floor = _hits(truth, photo, xy + shift)
        grey = np.where(on_floor, _painted(paints[0], places[:, [0, 1]]), _painted(paints[1], places[:, [0, 2]]))
        grey = grey.reshape(HEIGHT, WIDTH) if painted else rng.uniform(0, 255, (HEIGHT, WIDTH))
        noisy = np.clip(grey + rng.normal(0, 1.5, grey.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"{photo:05d}.jpg"), noisy, [cv2.IMWRITE_JPEG_QUALITY, 95])
        chosen = rng.uniform([40, 40], [WIDTH - 40, HEIGHT - 40], (60, 2))
        points.append(_hits(truth, photo, chosen)[0])
    truth = replace(truth, points=np.concatenate(points))
    return _seen(truth, noise_px, rng), truth


def _seen(truth: Unknowns, noise_px: float, rng: np.random.Generator) -> Observations:
    photo, point = (i.ravel() for i in np.indices((len(truth.rotations), len(truth.points))))
    seen = observations(photo, point, len(truth.rotations))
    for _ in range(5):
        xy = truth.residuals(seen)
        seen = replace(seen, tau=read_at(xy, WIDTH, HEIGHT))
    # As features are: not in every photo that shows the point.
    inside = ((xy > 20) & (xy < (WIDTH - 20, HEIGHT - 20))).all(axis=1) & (rng.random(len(photo)) < 0.6)
    noisy = xy[inside] + rng.normal(0, noise_px, (inside.sum(), 2))
    found = replace(seen.of(inside), xy=noisy, tau=read_at(noisy, WIDTH, HEIGHT))
    return found.of(np.bincount(found.point, minlength=len(truth.points))[found.point] > 1)


def _hits(truth: Unknowns, photo: int, xy: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """(n, 3) what pixels show, and whether it is the floor: the nearer of the two planes before the row's camera."""
    own = truth.own[photo]
    tau = read_at(xy, WIDTH, HEIGHT)
    rays = (xy - truth.lenses[0, 2:4] - own[PRINCIPAL]) / (FOCAL_PX * np.exp(own[FOCAL]))
    rays = np.column_stack([rays, np.ones(len(rays))])
    x, y, z = own[TURN]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    back = np.linalg.inv((np.eye(3) + tau[:, None, None] * cross) @ truth.rotations[photo])
    shift = (np.eye(3) + tau[:, None, None] * cross) @ truth.translations[photo] + tau[:, None] * own[DRIFT]
    centers = -(back @ shift[:, :, None])[:, :, 0]
    ways = (back @ rays[:, :, None])[:, :, 0]
    to_wall = (_WALL_M - centers[:, 1]) / ways[:, 1]
    to_floor = (-_FLOOR_M - centers[:, 2]) / ways[:, 2]
    on_floor = (to_floor > 0) & ((to_floor < to_wall) | (to_wall <= 0))
    return centers + ways * np.where(on_floor, to_floor, to_wall)[:, None], on_floor


def paint(rng: np.random.Generator, side: int) -> NDArray[np.float32]:
    """(side, side) grey values with structure of two sizes."""
    fine = cv2.GaussianBlur(rng.normal(0, 1, (side, side)).astype(np.float32), (0, 0), 1.5)
    coarse = cv2.GaussianBlur(rng.normal(0, 1, (side, side)).astype(np.float32), (0, 0), 6.0)
    return np.asarray(128 + 25 * fine / fine.std() + 25 * coarse / coarse.std(), dtype=np.float32)


def _painted(paint: NDArray[np.float32], places: Floats) -> Floats:
    at = ((places + np.array([_SIDE / 2, 2.0])) / _TEXEL).astype(np.float32).reshape(HEIGHT, WIDTH, 2)
    return np.asarray(cv2.remap(paint, at[:, :, 0], at[:, :, 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP).ravel())

"""A walk with a phone as points and cameras alone: what each photo observes, with effects of its own, exactly known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fsinfer.poses.adjustment.problem import Ints, Observations, Unknowns
from fsinfer.poses.adjustment.projection import LENS, OWN, Floats

WIDTH, HEIGHT, FOCAL_PX, K1 = 1280, 720, 1000.0, 0.03
#: Standard deviations of the log focal length, principal point (pixels), turn (rad) and drift (units) of a phone.
PHONE = np.array([0.0015, 2, 2, 0.0015, 0.0015, 0.0015, 0.01, 0.01, 0.01])
_ROUNDS = 5
ROLL_RAD = 0.7


def phone_walk(
    *,
    photos: int = 16,
    points: int = 1500,
    effects: Floats | None = None,
    noise_px: float = 0.3,
    outliers: float = 0.0,
    roll_rad: float = ROLL_RAD,
    seed: int = 1,
) -> tuple[Observations, Unknowns]:
    """Observations of a walk round a stand of points, half a metre a step, and the truth behind them.

    ``roll_rad``: standard deviation of the angle at which the phone is held.
    ``effects``: (9,) standard deviations of each photo's own, none unless given. ``outliers``: the share of the
    observations that are up to 20 pixels off.
    """
    rng = np.random.default_rng(seed)
    around = np.linspace(0, 0.5 * photos / 6, photos)
    centers = np.stack([6 * np.cos(around), 6 * np.sin(around), rng.normal(0, 0.1, photos)], axis=1)
    # Held at many angles: of photos that are all held upright nobody can tell the mean turning from an upright
    # stretch of the world (Albl, Sugimoto and Pajdla 2016, "Degeneracies in rolling shutter SfM").
    rotations = np.array([look_at(center, rng.normal(0, 0.3, 3), rng.normal(0, roll_rad)) for center in centers])
    translations = -np.einsum("nij,nj->ni", rotations, centers)
    own = np.zeros((photos, OWN)) if effects is None else effects * rng.standard_normal((photos, OWN))
    lens = np.zeros((1, LENS))
    lens[0, :5] = FOCAL_PX, FOCAL_PX, WIDTH / 2, HEIGHT / 2, K1
    cloud = rng.uniform([-3, -3, -2], [3, 3, 2], (points, 3))
    truth = Unknowns(rotations=rotations, translations=translations, own=own, lenses=lens, points=cloud)
    photo, point = (index.ravel() for index in np.indices((photos, points)))
    seen = observations(photo, point, photos)
    for _ in range(_ROUNDS):
        xy = truth.residuals(replace(seen, xy=np.zeros((len(photo), 2))))
        seen = replace(seen, xy=xy, tau=xy[:, 1] / HEIGHT - 0.5)
    inside = ((seen.xy > 0) & (seen.xy < (WIDTH, HEIGHT))).all(axis=1)
    # Each point is found in some photos in a row, as on a real walk.
    first = rng.integers(-4, photos - 2, points)[point]
    inside &= (photo >= first) & (photo < first + 8)
    xy = seen.xy[inside] + rng.normal(0, noise_px, (inside.sum(), 2))
    wrong = rng.random(len(xy)) < outliers
    xy[wrong] += rng.uniform(-20, 20, (wrong.sum(), 2))
    kept = np.bincount(point[inside], minlength=points) > 1
    seen = replace(seen.of(inside), xy=xy, tau=xy[:, 1] / HEIGHT - 0.5)
    seen, numbers = seen.of_points(kept)
    return seen, replace(truth, points=cloud[numbers])


def observations(photo: Ints, point: Ints, photos: int, xy: Floats | None = None) -> Observations:
    """Of one camera, of full weight, by the middle row; at the origin where no pixels (n, 2) are given."""
    count = len(photo)
    return Observations(
        photo=photo,
        point=point,
        xy=np.zeros((count, 2)) if xy is None else xy,
        tau=np.zeros(count),
        weight=np.ones(count),
        camera=np.zeros(photos, np.int64),
    )


def disturbed(truth: Unknowns, seed: int = 2) -> Unknowns:
    """A start some way off, as from an adjustment that knows no effects."""
    rng = np.random.default_rng(seed)
    return replace(
        truth,
        translations=truth.translations + rng.normal(0, 0.01, truth.translations.shape),
        points=truth.points + rng.normal(0, 0.01, truth.points.shape),
        own=np.zeros_like(truth.own),
        lenses=truth.lenses * (1.003, 1.003, *[1.0] * (LENS - 2)),
    )


def model_of(seen: Observations, unknowns: Unknowns) -> Any:
    """A ``pycolmap.Reconstruction`` with SIMPLE_RADIAL lenses that holds these observations and unknowns."""
    import pycolmap

    model = pycolmap.Reconstruction()
    for number, (focal, _, *center, k1) in enumerate(unknowns.lenses[:, :5], 1):
        params = [focal, *center, k1]
        camera = pycolmap.Camera(camera_id=number, model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=params)
        model.add_camera_with_trivial_rig(camera)
    rank = np.zeros(len(seen.photo), np.int64)
    for photo, pose in enumerate(np.concatenate([unknowns.rotations, unknowns.translations[:, :, None]], axis=2)):
        rows = np.flatnonzero(seen.photo == photo)
        rank[rows] = np.arange(len(rows))
        points2d = pycolmap.Point2DList([pycolmap.Point2D(xy) for xy in seen.xy[rows]])
        number = int(seen.camera[photo]) + 1
        image = pycolmap.Image(name=f"{photo:05d}.jpg", points2D=points2d, camera_id=number, image_id=photo + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    order = np.argsort(seen.point, kind="stable")
    for point, rows in enumerate(np.split(order, np.cumsum(np.bincount(seen.point))[:-1])):
        track = pycolmap.Track()
        for row in rows:
            track.add_element(int(seen.photo[row]) + 1, int(rank[row]))
        model.add_point3D(unknowns.points[point], track)
    model.update_point_3d_errors()
    return model


def look_at(center: Floats, target: Floats, roll: float) -> Floats:
    """Rotation camera from world of a camera at ``center`` that looks at ``target``, rolled by so many radians."""
    forward = target - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    upright = np.stack([right, np.cross(forward, right), forward])
    cosine, sine = np.cos(roll), np.sin(roll)
    rolled = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return np.asarray(rolled @ upright, dtype=np.float64)

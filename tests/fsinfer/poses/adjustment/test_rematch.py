"""Points looked for once more by their patches: cameras that features place to millimetres become surer by it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsinfer.io.images import luminance, read_image
from fsinfer.poses.adjustment.adjust import PhotoAdjustment, adjust_photos
from fsinfer.poses.adjustment.last_fit import like
from fsinfer.poses.adjustment.problem import Ints, Observations, Unknowns, from_model
from fsinfer.poses.adjustment.projection import Floats, project
from fsinfer.poses.adjustment.rematch import Photos, pairs_to_look_for, references, rematched, spread
from fsinfer.poses.adjustment.settings import AdjustmentSettings, RematchSettings
from fsinfer.threads import one_blas_thread
from tests.support.painted_corner import painted_corner
from tests.support.phone_walk import HEIGHT, PHONE, WIDTH, model_of, observations, phone_walk

pytest.importorskip("pycolmap")
#: What a phone that turns while it reads its photos out does; of a wall and a floor the rest cannot be told.
TURNING = PHONE * [0, 0, 0, 1, 1, 1, 0, 0, 0]


def off(truth: Unknowns, seed: int = 3) -> Unknowns:
    """Cameras and points some millimetres off, and nothing known of each photo's own."""
    rng = np.random.default_rng(seed)
    return replace(
        truth,
        translations=truth.translations + rng.normal(0, 0.004, truth.translations.shape),
        points=truth.points + rng.normal(0, 0.004, truth.points.shape),
        own=np.zeros_like(truth.own),
    )


@one_blas_thread()
def adjusted(
    folder: Path | None, seen: Observations, truth: Unknowns, settings: RematchSettings | None = None
) -> tuple[float, PhotoAdjustment]:
    """Root mean square error of the camera centres, metres; and what was told."""
    found, told = adjust_photos(
        model_of(seen, off(truth)),
        AdjustmentSettings(rematch=settings or RematchSettings()),
        images=folder,
    )
    centers = like(from_model(found)[1], truth).centers
    return float(np.sqrt(((centers - truth.centers) ** 2).sum(1).mean())), told


@pytest.mark.parametrize("effects", [None, TURNING], ids=["held still", "turning"])
def test_cameras_are_placed_better_than_by_features(tmp_path: Path, effects: Floats | None) -> None:
    seen, truth = painted_corner(tmp_path, effects=effects)
    by_features, plain = adjusted(None, seen, truth)
    by_patches, told = adjusted(tmp_path, seen, truth)
    assert plain.patches == 0
    assert told.patches > 1000
    assert by_patches < 0.4 * by_features
    if effects is None:
        assert told.groups == ()
        assert told.effects == {}
    else:
        assert told.groups == plain.groups == ("turn",)
        assert told.rolling_shutter_px == pytest.approx(plain.rolling_shutter_px, rel=0.1)
    # What it says of the cameras follows.
    stds = [np.median([one.center_std for one in each.precisions.values()]) for each in (plain, told)]
    assert stds[1] < 0.5 * stds[0]
    assert told.record()["patches"] == told.patches


@pytest.mark.parametrize("wrong", [{"painted": False}, {"shifted_px": 1.5}], ids=["nothing there", "another place"])
def test_where_patches_find_nothing_or_contradict_the_features_those_count(
    tmp_path: Path, wrong: dict[str, float]
) -> None:
    seen, truth = painted_corner(tmp_path, **wrong)  # type: ignore[arg-type]
    by_features, _ = adjusted(None, seen, truth)
    found, told = adjusted(tmp_path, seen, truth)
    assert told.patches == 0
    assert found < 2 * by_features


def test_too_few_patches_are_none(tmp_path: Path) -> None:
    seen, truth = painted_corner(tmp_path)
    _, told = adjusted(tmp_path, seen, truth, RematchSettings(min_patches=1000))
    assert told.patches == 0


@pytest.mark.parametrize("breathing", [1.0, 60.0], ids=["as phones breathe", "zoomed"])
def test_a_patch_is_looked_for_where_the_photo_shows_it_as_large_and_turned_as_it_does(breathing: float) -> None:
    """Photos of two lenses, rolled and read out row by row; every feature lies three pixels beside its point."""
    beside = np.array([2.5, -1.5])
    exact, truth = phone_walk(effects=PHONE * [breathing, 1, 1, 1, 1, 1, 1, 1, 1], noise_px=0.0)
    lenses = np.repeat(truth.lenses, 2, axis=0)
    lenses[1, :2] *= 1.25
    camera = np.arange(len(exact.camera)) % 2
    truth, exact = replace(truth, lenses=lenses), replace(exact, camera=camera)

    def shown(photo: Ints, points: Floats) -> Floats:
        """Where photos show points, by the row that reads each."""
        there = np.einsum("nij,nj->ni", truth.rotations[photo], points) + truth.translations[photo]
        xy: Floats = np.zeros((len(photo), 2))
        for _ in range(8):
            xy = project(there, xy[:, 1] / HEIGHT - 0.5, lenses[camera[photo]], truth.own[photo])
        return xy

    xy = shown(exact.photo, truth.points[exact.point])
    seen = replace(exact, xy=xy + beside, tau=xy[:, 1] / HEIGHT - 0.5)
    reference = references(seen, truth.in_cameras(seen), len(truth.points))
    settings = RematchSettings(most_photos=5)
    pairs = pairs_to_look_for(seen, truth, reference, photos(Path(), len(camera)), settings)
    assert len(pairs.point) > 2000
    # Of each point five photos, or as many as could show it.
    all_photos = RematchSettings(most_photos=len(camera))
    every = pairs_to_look_for(seen, truth, reference, photos(Path(), len(camera)), all_photos)
    could = np.bincount(every.point, minlength=len(truth.points))
    assert could.max() > 5
    np.testing.assert_array_equal(np.bincount(pairs.point, minlength=len(truth.points)), np.minimum(could, 5))
    own = seen.photo[reference[pairs.point]]
    assert (own != pairs.photo).all()
    points = truth.points[pairs.point]
    expected = shown(pairs.photo, points) + pairs.affine @ beside
    np.testing.assert_allclose(pairs.xy, expected, atol=0.02)
    # Two small ways across the line of sight, as both photos show them.
    across = truth.rotations[own][:, :2] * 1e-3
    by_own, by_photo = (
        np.stack([shown(photo, points + across[:, i]) - shown(photo, points) for i in (0, 1)], axis=2)
        for photo in (own, pairs.photo)
    )
    shift = by_photo @ np.linalg.inv(by_own)
    # Seen from elsewhere a thing is foreshortened, which is left to the patches.
    off = np.linalg.norm(shift - pairs.affine, axis=(1, 2))
    assert np.median(off) < 0.1
    assert np.percentile(off, 90) < 0.3


def test_the_patch_of_a_point_is_taken_from_the_photo_with_the_middle_one_of_its_depths() -> None:
    photo = np.array([3, 0, 1, 4, 2, 0, 1, 2, 5, 3, 0])
    point = np.array([0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 3])
    depth = np.array([5.0, 2.0, 9.0, 3.0, 7.0, 8.0, 4.0, 6.0, 1.0, 9.0, 2.5])
    inside = np.column_stack([np.zeros((len(depth), 2)), depth])
    found = references(observations(photo, point, 6), inside, 4)
    # Five of the first two points each, none of the third, one of the last.
    assert found.tolist() == [0, 7, -1, 10]
    assert depth[found[:2]].tolist() == [np.median(depth[:5]), np.median(depth[5:10])]


def test_patches_that_are_not_sharp_enough_do_not_count(tmp_path: Path) -> None:
    seen, truth = painted_corner(tmp_path, photos=5)
    patches = [
        int((rematched(seen, off(truth), photos(tmp_path, 5), settings).weight == 1).sum())
        for settings in (RematchSettings(), RematchSettings(max_std_px=0.01))
    ]
    assert patches[1] < 0.5 * patches[0]


def test_in_photos_twice_as_large_patches_may_lie_twice_as_many_pixels_away(tmp_path: Path) -> None:
    seen, truth = painted_corner(tmp_path, photos=5)
    start = replace(off(truth), points=truth.points + np.random.default_rng(8).normal(0, 0.006, truth.points.shape))
    there = photos(tmp_path, 5)
    small = rematched(seen, start, there, RematchSettings())
    for file in there.files:
        grey = luminance(read_image(file))
        cv2.imwrite(str(file), cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC))
    lenses = start.lenses.copy()
    lenses[:, :4] *= 2
    twice = replace(there, sizes=2 * there.sizes, step_px=2.0)
    large = rematched(replace(seen, xy=2 * seen.xy), replace(start, lenses=lenses), twice, RematchSettings())
    patches = [int((found.weight == 1).sum()) for found in (small, large)]
    assert patches[0] > 500
    assert patches[1] == pytest.approx(patches[0], rel=0.1)


def photos(folder: Path, count: int) -> Photos:
    return Photos(
        files=[folder / f"{i:05d}.jpg" for i in range(count)], sizes=np.array([[WIDTH, HEIGHT]] * count), step_px=1.0
    )


def test_each_observation_is_one_photo_of_one_point(tmp_path: Path) -> None:
    seen, truth = painted_corner(tmp_path)
    found = rematched(seen, off(truth), photos(tmp_path, 10), RematchSettings())
    keys = found.photo * len(truth.points) + found.point
    assert (np.diff(keys) > 0).all()
    patches = found.of(found.weight == 1)
    true = truth.residuals(replace(patches, xy=np.zeros_like(patches.xy)))
    # A patch shows in all photos the same place, which is where its feature was: off by as much as that.
    errors = patches.xy - true
    assert 0.2 < errors.std() < 0.6
    within = (
        errors
        - np.stack([np.bincount(patches.point, e) for e in errors.T], 1)[patches.point]
        / np.maximum(np.bincount(patches.point), 1)[patches.point, None]
    )
    assert np.median(np.linalg.norm(within, axis=1)) < 0.2
    # More photos show a point by its patch than by its feature.
    with_feature = seen.of(np.isin(seen.point, patches.point))
    assert len(np.unique(found.photo * 1000 + found.point)) > 1.1 * len(with_feature.photo)
    np.testing.assert_allclose(found.tau, found.xy[:, 1] / HEIGHT - 0.5)


@given(
    st.dictionaries(
        st.tuples(st.integers(0, 3), st.integers(0, 30)),
        st.tuples(st.integers(0, WIDTH - 1), st.integers(0, HEIGHT - 1)),
        min_size=1,
    ),
    st.integers(1, 4),
)
def test_every_cell_has_the_points_it_asks_for_as_far_as_there_are(
    seen_at: dict[tuple[int, int], tuple[int, int]], per_cell: int
) -> None:
    photo, point = np.array(sorted(seen_at)).T
    xy = np.array([seen_at[key] for key in sorted(seen_at)], dtype=np.float64)
    seen = observations(photo, point, 4, xy)
    chosen = spread(seen, np.array([[WIDTH, HEIGHT]] * 4), 31, RematchSettings(per_cell=per_cell))
    side = WIDTH / RematchSettings().cells
    cells = [(p, x // side, y // side) for p, (x, y) in zip(photo.tolist(), xy.tolist(), strict=True)]
    for cell in set(cells):
        there = [int(one) for one, place in zip(point, cells, strict=True) if place == cell]
        assert chosen[there].sum() >= min(per_cell, len(there))
    # A point that nobody sees is none.
    assert not chosen[sorted(set(range(31)) - set(point.tolist()))].any()

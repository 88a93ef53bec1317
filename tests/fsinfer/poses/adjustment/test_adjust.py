"""The adjustment of COLMAP models: nothing where nothing was, a plain pinhole model where a phone moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fsinfer import processes
from fsinfer.notices.sentences import sentence, sentences
from fsinfer.poses.adjustment.adjust import PhotoAdjustment, adjust_photos
from fsinfer.poses.adjustment.fit import fit
from fsinfer.poses.adjustment.last_fit import like, weighting_of
from fsinfer.poses.adjustment.problem import Group, from_model
from fsinfer.poses.adjustment.projection import DRIFT, OWN
from fsinfer.poses.adjustment.reduced_system import Structure
from fsinfer.poses.adjustment.settings import AdjustmentSettings
from fsinfer.poses.adjustment.tell import told
from fsinfer.poses.undistortion import maps_of_photo, pinhole_of, undistortion_maps
from fsinfer.process_worker import Answer
from fsinfer.threads import one_blas_thread
from tests.fsinfer.poses.adjustment.test_fit import weighting
from tests.support.phone_walk import PHONE, disturbed, model_of, phone_walk

pytest.importorskip("pycolmap")
#: Turning, focal length and principal point; a centimetre of way is for the tests of the fit.
EFFECTS = PHONE * [1, 1, 1, 1, 1, 1, 0, 0, 0]


def test_arrays_of_a_model_are_those_it_was_made_of() -> None:
    seen, truth = phone_walk(effects=EFFECTS)
    start = disturbed(truth)
    there, unknowns, numbers = from_model(model_of(seen, start))
    np.testing.assert_allclose(unknowns.residuals(there), start.residuals(seen), atol=1e-9)
    np.testing.assert_allclose(there.tau, seen.tau, atol=1e-12)
    assert len(numbers.images) == len(truth.rotations)


@pytest.mark.parametrize("photos", [7, 16], ids=["too few photos", "nothing to find"])
def test_a_camera_that_stood_still_is_left_as_it_is(photos: int) -> None:
    seen, truth = phone_walk(photos=photos, effects=EFFECTS if photos == 7 else None)
    model = model_of(seen, truth)
    adjusted, adjustment = adjust_photos(model, AdjustmentSettings())
    assert adjusted is model
    assert adjustment.effects == {}
    assert adjustment.rolling_shutter_px is None
    assert (len(adjustment.trials) == 0) == (photos == 7)
    assert len(adjustment.precisions) == (0 if photos == 7 else photos)


@pytest.mark.parametrize("photos", [7, 16], ids=["too few photos", "nothing to find"])
def test_a_model_that_is_not_adjusted_photo_by_photo_is_settled(photos: int) -> None:
    seen, truth = phone_walk(photos=photos, noise_px=0.2)
    model = model_of(seen, disturbed(truth))
    best = model_of(seen, truth).compute_mean_reprojection_error()
    assert model.compute_mean_reprojection_error() > 3 * best
    adjusted, adjustment = adjust_photos(model, AdjustmentSettings())
    assert adjusted is model
    assert model.compute_mean_reprojection_error() < 1.01 * best
    # Precisions are those of the settled model.
    _, again = adjust_photos(model, AdjustmentSettings())
    told = [[found.center_std for found in each.precisions.values()] for each in (adjustment, again)]
    assert len(told[0]) == (photos if photos == 16 else 0)
    assert told[0] == pytest.approx(told[1], rel=0.05)


def test_two_cameras_of_few_photos_are_adjusted_and_their_lenses_kept() -> None:
    """A small plot of which half was photographed upright and half across, or by two phones."""
    seen, truth = phone_walk(photos=14, effects=EFFECTS, noise_px=0.2)
    seen = replace(seen, camera=np.repeat([0, 1], 7))
    truth = replace(truth, lenses=np.repeat(truth.lenses, 2, axis=0))
    model = model_of(seen, disturbed(truth))
    lenses = [list(camera.params) for camera in model.cameras.values()]
    adjusted, adjustment = adjust_photos(model, AdjustmentSettings())
    assert len(adjusted.cameras) == 2
    assert len(adjustment.precisions) == 14
    assert Group.turn.name in adjustment.groups
    assert [list(camera.params) for camera in adjusted.cameras.values()] == lenses


@pytest.mark.parametrize("least", [AdjustmentSettings().min_gain_beside, 2.0], ids=["all are kept", "some go again"])
def test_processes_beside_each_other_find_the_same(least: float, monkeypatch: pytest.MonkeyPatch) -> None:
    seen, truth = phone_walk(effects=PHONE, noise_px=0.2)
    start = fit(Structure(seen, len(truth.points)), disturbed(truth), (), weighting(len(truth.rotations)))
    settings = replace(AdjustmentSettings(), min_gain_beside=least)
    asked = []
    ask = processes._Worker.ask

    def noted(self: processes._Worker, work: Callable[[object], object], item: object) -> Answer:
        asked.append(item)
        answer = ask(self, work, item)
        assert answer.error is None
        assert not answer.unfit
        return answer

    monkeypatch.setattr(processes._Worker, "ask", noted)
    monkeypatch.setattr("fsinfer.poses.adjustment.last_fit._SHARED_FROM", 0)
    found = []
    for threads in (1, 2):
        with one_blas_thread():  # as in estimate_poses: sums in two threads are rounded otherwise
            adjusted, adjustment = adjust_photos(model_of(seen, start), settings, threads=threads)
        found.append((from_model(adjusted)[1], adjustment))
        assert bool(asked) == (threads == 2)
    (alone, told), (shared, told_too) = found
    # The last of them has nothing after it that it could have stood for.
    assert len(told.groups) >= 3 if least < 1 else len(told.groups) == 1
    assert told.trials == told_too.trials
    assert told.precisions == told_too.precisions
    for one, other in ((alone.rotations, shared.rotations), (alone.points, shared.points)):
        np.testing.assert_array_equal(one, other)


def test_a_phone_becomes_a_camera_that_stood_still(monkeypatch: pytest.MonkeyPatch) -> None:
    def settle(_model: object) -> None:
        raise AssertionError("what is adjusted photo by photo need not be adjusted before")

    monkeypatch.setattr("fsinfer.poses.adjustment.adjust.settle", settle)
    seen, truth = phone_walk(effects=EFFECTS, noise_px=0.2)
    start = fit(Structure(seen, len(truth.points)), disturbed(truth), (), weighting(len(truth.rotations)))
    model = model_of(seen, start)
    before = model.compute_mean_reprojection_error()
    adjusted, adjustment = adjust_photos(model, AdjustmentSettings())
    assert model.compute_mean_reprojection_error() == before
    assert {"turn", "focal"} <= set(adjustment.groups)
    # The model alone, read as any other, knows no effects any more, and fits.
    there, unknowns, _ = from_model(adjusted)
    assert adjusted.compute_mean_reprojection_error() < 0.7 * before
    still = replace(truth, own=np.zeros((len(truth.rotations), OWN)))
    moved = still.residuals(seen) - truth.residuals(seen)
    assert np.median(np.linalg.norm(moved, axis=1)) > 1
    errors = [np.linalg.norm(like(found, truth).centers - truth.centers, axis=1).max() for found in (start, unknowns)]
    assert errors[1] < 0.4 * errors[0]
    # Sizes are those that were put in.
    assert adjustment.focal_std_percent == pytest.approx(100 * np.exp(truth.own[:, 0]).std(), rel=0.3)
    assert adjustment.rolling_shutter_px == pytest.approx(2.5, abs=1.0)
    names = {number: f"view {number}" for number in adjustment.effects}
    record = adjustment.record(names)
    assert set(record["camera_std"]) == set(names.values())
    assert 0 < record["camera_std"]["view 1"]["center"] < 0.01
    assert 0 < record["camera_std"]["view 1"]["direction_rad"] < 0.002
    assert record["adjusted_photo_by_photo"] == list(adjustment.groups)
    assert record["held_out_error_falls_percent"]["turn"] > 5
    # Photo and pinhole image: a point's own place in the photo is where the map of its photo leads.
    for photo, image_id in enumerate(sorted(adjustment.effects)):
        image = adjusted.images[image_id]
        camera = adjusted.cameras[image.camera_id]
        pinhole = pinhole_of(camera)
        if photo == 0:
            maps = undistortion_maps(camera, pinhole)
        map_x, map_y = maps_of_photo(maps, camera, pinhole, adjustment.effects[image_id])
        rays = camera.cam_from_img(there.xy[there.photo == photo])
        target = pinhole.img_from_cam(np.column_stack([rays, np.ones(len(rays))]))
        pixel = np.rint(target - 0.5).astype(int)
        inner = ((pixel >= 0) & (pixel < (pinhole.width, pinhole.height))).all(axis=1)
        column, row = pixel[inner].T
        # From the pixel's middle to the point it is less than a pixel, in both images alike.
        shown = np.stack([map_x[row, column], map_y[row, column]], axis=1) + target[inner] - pixel[inner]
        assert np.median(np.linalg.norm(shown - seen.xy[seen.photo == photo][inner], axis=1)) < 0.03


def test_means_are_held_about_and_across_the_rows() -> None:
    seen, truth = phone_walk(photos=8, points=300)
    model = model_of(seen, truth)
    _, start, numbers = from_model(model)
    settings = AdjustmentSettings()
    lying = weighting_of(model, seen, start, numbers, settings, 1.0).mean_std
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(lying[0])), [3, 7])
    (camera,) = model.cameras.values()
    camera.width, camera.height = camera.height, camera.width
    upright = weighting_of(model, seen, start, numbers, settings, 1.0).mean_std
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(upright[0])), [4, 6])


def test_what_is_expected_of_ways_is_in_units_of_the_model() -> None:
    seen, truth = phone_walk(photos=8, points=300)
    settings = AdjustmentSettings()
    expected = []
    for units in (1.0, 20.0):
        larger = replace(truth, translations=units * truth.translations, points=units * truth.points)
        model = model_of(seen, larger)
        own_seen, start, numbers = from_model(model)
        expected.append(weighting_of(model, own_seen, start, numbers, settings, 1.0))
    one, twenty = expected
    factor = np.ones(OWN)
    factor[DRIFT] = 20.0
    np.testing.assert_allclose(twenty.own_std, one.own_std * factor)
    np.testing.assert_allclose(twenty.mean_std, one.mean_std * factor)


def test_large_effects_are_told_with_what_to_do() -> None:
    settings = AdjustmentSettings()
    assert told(PhotoAdjustment(), settings) == []
    small = PhotoAdjustment(rolling_shutter_px=0.9, focal_std_percent=0.19, principal_std_px=0.9)
    assert told(small, settings) == []
    large = PhotoAdjustment(rolling_shutter_px=2.34, focal_std_percent=0.31, principal_std_px=2.0)
    said = sentences(told(large, settings))
    assert [any(word in text for text in said) for word in ("2.3 pixels", "0.31 %", "2.0 pixels")] == [True] * 3
    assert "stand still" in said[0]
    assert "lock the focus" in said[1]
    (mixed,) = told(PhotoAdjustment(focal_std_percent=4.37), settings)
    assert mixed.code == "lenses_mixed"
    assert "photos of two lenses or zooms" in sentence(mixed)
    # Pixels of photos twice as large are half as much.
    assert [item.code for item in told(large, settings, larger=3)] == ["focal_length_changes"]

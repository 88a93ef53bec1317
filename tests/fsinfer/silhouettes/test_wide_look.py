"""Looking wider for a stem that stands beside the axis that the cloud has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.silhouettes.edges import Strip
from fsinfer.silhouettes.one_look import Looked, LookSettings, fitted_look
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.silhouettes.wide_look import WideLookSettings, axes_beside, look_wider
from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings
from training.simulate.stem_edges import edges_from_rows

#: The haze that the cloud has of a stem of 23 cm which stands 13 cm beside it.
HAZE = StemAxis(breast=np.array([3.0, 5.0, 1.3]), along=np.array([0.0, 0.0, 1.0]), radius_m=0.09, taper=0.0)
TRUE_RADIUS_M, BESIDE_M = 0.115, np.array([0.12, -0.05])
FIT, LOOKS, WIDE = SilhouetteSettings(), LookSettings(), WideLookSettings()


class Photos:
    """What a strip about an axis shows: the stem's edges where it reaches them, and some that belong to nothing."""

    def __init__(
        self,
        *,
        photos: int = 14,
        beside_m: NDArray[np.float64] = BESIDE_M,
        radius_m: float = TRUE_RADIUS_M,
        stray: int = 3,
        single: int = 0,
    ) -> None:
        self.photos, self.stray, self.radius_m, self.single = photos, stray, radius_m, single
        self.place = HAZE.breast[:2] + beside_m
        self.asked: list[StemAxis] = []

    def edges(self, stem: StemAxis, more_m: float = 0.0) -> Edges:
        rng = np.random.default_rng(7)
        reach = 1.6 * stem.radius_m + 0.04 + more_m
        beside = self.place - stem.breast[:2]
        rows = []
        for photo in range(self.photos):
            for side in (0, 1):
                angle = 0.9 * np.pi * photo / self.photos + np.pi * side
                normal = np.array([np.cos(angle), np.sin(angle)])
                for band in range(6):
                    ray = (photo * 2 + side) * 6 + band
                    fixed = (angle, -0.2 + 0.08 * band, 8.0, 0.01, ray, photo)
                    true = self.radius_m + beside @ normal + rng.normal(0.0, 0.002)
                    stray = rng.uniform(0.01, reach, self.stray)
                    rows += [(at, *fixed) for at in (true, *stray) if 0.0 < at < reach]
        # Photographs of one edge, all at the same place, which is none of the stem's.
        for photo in range(self.photos, self.photos + self.single):
            angle = 0.3 * photo
            at = 0.05 + 0.1 * np.cos(angle)
            rows += [(max(at, 0.01), angle, 0.0, 8.0, 0.01, photo * 12 + band, photo) for band in range(6)]
        return edges_from_rows(rows)

    def __call__(self, stems: Sequence[StemAxis]) -> tuple[list[Edges], list[list[Strip]]]:
        self.asked += stems
        return [self.edges(stem) for stem in stems], [[] for _ in stems]

    def wide(self, stems: Sequence[StemAxis]) -> list[Edges]:
        return [self.edges(stem, WIDE.reach_m) for stem in stems]


def first_look(photos: Photos, stem: StemAxis = HAZE) -> Looked:
    return fitted_look(stem, np.zeros(2), photos.edges(stem), [], None, FIT, LOOKS)


def looked_wider(photos: Photos, stem: StemAxis = HAZE, settings: WideLookSettings = WIDE) -> tuple[Looked, Looked]:
    before = first_look(photos, stem)
    (after,) = look_wider([stem], [before], photos, photos.wide, fit=FIT, looks=LOOKS, settings=settings)
    return before, after


def test_a_stem_beside_its_haze_is_found_where_it_stands() -> None:
    photos = Photos()
    before, after = looked_wider(photos)
    assert before.fit is None or abs(before.fit.radius_m - TRUE_RADIUS_M) > 0.015  # what a narrow strip makes of it
    assert after.fit is not None
    assert after.fit.radius_m == pytest.approx(TRUE_RADIUS_M, abs=0.002)
    assert after.fit.contrast > WIDE.sure_contrast
    np.testing.assert_allclose(after.moved_m + after.fit.shift_m, BESIDE_M, atol=0.003)
    np.testing.assert_allclose(after.stem.breast[:2] + after.fit.shift_m, photos.place, atol=0.003)


def test_a_haze_may_be_much_thicker_than_its_stem() -> None:
    photos, haze = Photos(radius_m=0.045), replace(HAZE, radius_m=0.11)
    radii = [axis.radius_m for axis, _ in axes_beside(haze, photos.edges(haze, WIDE.reach_m), FIT, WIDE)]
    assert min(abs(radius - 0.045) for radius in radii) < WIDE.radius_step_m
    _, after = looked_wider(photos, haze)
    assert after.fit is not None
    assert after.fit.radius_m == pytest.approx(0.045, abs=0.002)
    np.testing.assert_allclose(after.stem.breast[:2] + after.fit.shift_m, photos.place, atol=0.003)


def test_photographs_of_one_edge_have_no_say_in_where_a_stem_is() -> None:
    some, more = (axes_beside(HAZE, Photos(single=n).edges(HAZE, WIDE.reach_m), FIT, WIDE) for n in (0, 40))
    assert some
    for (_, before), (_, after) in zip(some, more, strict=True):
        np.testing.assert_array_equal(before, after)


def test_an_axis_is_moved_along_its_directions_across() -> None:
    along = np.array([0.6, 0.0, 0.8])  # leaning to x, so that the first direction falls off
    moved = replace(HAZE, along=along).moved(np.array([0.1, 0.2]), 0.3)
    np.testing.assert_allclose(moved.breast - HAZE.breast, [0.08, 0.2, -0.06], atol=1e-12)
    assert moved.radius_m == 0.3
    assert HAZE.moved(np.zeros(2), 0.0).radius_m > 0.0


def test_only_what_agrees_as_stems_seldom_do_is_looked_for_wider() -> None:
    sure = Photos(beside_m=np.zeros(2))
    stem = replace(HAZE, radius_m=TRUE_RADIUS_M)
    before, after = looked_wider(sure, stem)
    assert before.fit is not None
    assert before.fit.contrast > WIDE.sure_contrast
    assert after is before
    assert not sure.asked
    # The same stem where that is not sure enough: found again where it was.
    before, after = looked_wider(sure, stem, replace(WIDE, sure_contrast=before.fit.contrast + 0.1))
    assert sure.asked
    assert after.fit is not None
    assert after.fit.radius_m == pytest.approx(TRUE_RADIUS_M, abs=0.002)


def test_a_wider_look_that_shows_no_better_stem_does_not_count() -> None:
    shown = Photos(photos=2)  # too few for any stem
    before, after = looked_wider(shown)
    assert after is before
    # Nor one beyond the reach.
    before, after = looked_wider(Photos(beside_m=np.array([0.5, 0.3]), stray=0))
    assert after is before
    nothing_seen = edges_from_rows([(0.1, 0.0, 0.0, 8.0, 0.01, 0, 0)])
    assert axes_beside(HAZE, nothing_seen, FIT, WIDE) == []
    assert look_wider([], [], shown, shown.wide, fit=FIT, looks=LOOKS, settings=WIDE) == []


@pytest.mark.parametrize(("apart_m", "found"), [(0.0, False), (0.3, True)])
def test_a_neighbour_that_the_cloud_measured_is_not_the_stem_that_it_refused(apart_m: float, found: bool) -> None:
    photos = Photos()
    place = np.array([photos.place[0] + apart_m, photos.place[1], 1.3])
    neighbour = replace(HAZE, breast=place, radius_m=TRUE_RADIUS_M)
    before = first_look(photos)
    wider = look_wider([HAZE], [before], photos, photos.wide, fit=FIT, looks=LOOKS, settings=WIDE, measured=[neighbour])
    fit = wider[0].fit
    there = fit is not None and bool(np.hypot(*(wider[0].moved_m + fit.shift_m - BESIDE_M)) < 0.01)
    assert there == found


def test_each_stem_keeps_its_own_look() -> None:
    """Of four, two are lost, each with several places to look at."""
    photos = Photos()
    sure = replace(HAZE, breast=np.array([*photos.place, 1.3]), radius_m=TRUE_RADIUS_M)
    other = replace(HAZE, breast=HAZE.breast + np.array([0.03, 0.02, 0.0]))
    stems = [sure, HAZE, sure, other]
    looks = [first_look(photos, stem) for stem in stems]
    after = look_wider(stems, looks, photos, photos.wide, fit=FIT, looks=LOOKS, settings=WIDE)
    assert after[0] is looks[0]
    assert after[2] is looks[2]
    for one, stem in zip(after, stems, strict=True):
        assert one.fit is not None
        assert one.fit.radius_m == pytest.approx(TRUE_RADIUS_M, abs=0.002)
        np.testing.assert_allclose(stem.breast[:2] + one.moved_m + one.fit.shift_m, photos.place, atol=0.003)

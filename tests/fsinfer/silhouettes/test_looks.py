"""A second look at stems that turn out to be other than the cloud thought."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.silhouettes.edges import Strip
from fsinfer.silhouettes.looks import again
from fsinfer.silhouettes.one_look import Looked, LookSettings, Surface, fitted_look, fuller_look, own_looks
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.trees.diameter.edge_set import Edges, chosen_edges
from fsinfer.trees.diameter.silhouette import SilhouetteFit
from fsinfer.trees.diameter.silhouette_settings import SilhouetteSettings
from training.simulate.stem_edges import edges_from_rows

NOWHERE = np.zeros(2)
#: Not one edge.
NONE = chosen_edges(edges_from_rows([(0.0,) * 7]), np.zeros(1, dtype=bool))
UPRIGHT = StemAxis(breast=np.array([3.0, 5.0, 1.3]), along=np.array([0.0, 0.0, 1.0]), radius_m=0.10, taper=0.0)


def edges_at(radius: float, *, photos: int, scatter: float = 0.0005, pixel: float = 0.002) -> Edges:
    """Both sides of a round stem in photographs from all round, six bands each."""
    rng = np.random.default_rng(4)
    rows = []
    for photo in range(photos):
        for side in (0, 1):
            for band in range(6):
                angle = 2 * np.pi * photo / photos + np.pi * side
                at = radius + rng.normal(0.0, scatter)
                rows.append((at, angle, -0.2 + 0.08 * band, 8.0, pixel, (photo * 2 + side) * 6 + band, photo))
    return edges_from_rows(rows)


def fit_of(radius: float, std: float, *, photos: int = 9, shift: Sequence[float] = (0.0, 0.0)) -> SilhouetteFit:
    return SilhouetteFit(
        radius_m=radius,
        std_m=std,
        shift_m=np.array(shift),
        slope=np.zeros(2),
        taper=0.0,
        shape_m=np.zeros(6),
        rays=90.0,
        share=0.9,
        photos=photos,
        sectors=0.8,
        noise_m=0.001,
        contrast=1.7,
        weight=np.ones(3),
    )


def looked_at(fit: SilhouetteFit | None) -> Looked:
    edges = edges_at(0.1 if fit is None else fit.radius_m, photos=9)
    return Looked(stem=UPRIGHT, edges=edges, single=NONE, fitted=edges, of_fit=edges, fit=fit, moved_m=NOWHERE)


class Photos:
    """What a look finds: edges at ``radius``, in so many photographs, wherever one looks."""

    def __init__(self, radius: float, *, photos: int = 9, scatter: float = 0.0005) -> None:
        self.edges = edges_at(radius, photos=photos, scatter=scatter)
        self.asked: list[list[StemAxis]] = []

    def __call__(self, stems: Sequence[StemAxis]) -> tuple[list[Edges], list[list[Strip]]]:
        self.asked.append(list(stems))
        return [self.edges for _ in stems], [[] for _ in stems]


def looked_again(first: Sequence[Looked], photos: Photos, settings: LookSettings | None = None) -> list[Looked]:
    return again(
        first, [None] * len(first), photos, fit=SilhouetteSettings(), settings=settings or LookSettings()
    )  # fmt: skip


def test_only_stems_of_another_radius_are_looked_at_again_and_where_they_were_found() -> None:
    as_thought, other, none = looked_at(fit_of(0.104, 0.002)), looked_at(fit_of(0.08, 0.002, shift=(0.01, -0.02))), None
    photos = Photos(0.08)
    after = looked_again([as_thought, other, looked_at(none)], photos)
    assert after[0] is as_thought
    assert after[2].fit is None
    ((stem,),) = photos.asked  # once: the radius stays
    assert stem.radius_m == pytest.approx(0.08)
    np.testing.assert_allclose(stem.breast, [3.01, 4.98, 1.3])
    assert after[1].stem is stem
    np.testing.assert_allclose(after[1].moved_m, [0.01, -0.02])


def test_a_later_look_counts_where_it_is_surer_or_contradicts() -> None:
    surer = looked_again([looked_at(fit_of(0.090, 0.02))], Photos(0.089))[0]
    assert surer.fit is not None
    assert surer.fit.radius_m == pytest.approx(0.089, abs=0.001)
    # As sure as it may be of 12 cm: looked at again it is 8 cm, and the haze had the rest.
    against = looked_again([looked_at(fit_of(0.060, 0.0001))], Photos(0.040, scatter=0.003))[0]
    assert against.fit is not None
    assert against.fit.radius_m == pytest.approx(0.040, abs=0.002)
    first, photos = looked_at(fit_of(0.0895, 0.00001)), Photos(0.0899, scatter=0.003)
    assert looked_again([first], photos)[0] is first
    assert len(photos.asked) == 1  # another look would show the same


def test_a_look_that_too_few_photographs_carry_does_not_count() -> None:
    first = looked_at(fit_of(0.06, 0.02))
    assert looked_again([first], Photos(0.04, photos=3))[0] is first
    unclear = looked_at(fit_of(0.06, 1e-6, photos=3))
    assert looked_again([unclear], Photos(0.0601))[0] is not unclear


def test_looks_end_though_the_radius_does_not_stay() -> None:
    class Shrinking(Photos):
        def __call__(self, stems: Sequence[StemAxis]) -> tuple[list[Edges], list[list[Strip]]]:
            self.edges = edges_at(0.8 * stems[0].radius_m, photos=9)
            return super().__call__(stems)

    photos = Shrinking(0.08)
    after = looked_again([looked_at(fit_of(0.08, 0.01, shift=(0.01, 0.0)))], photos, LookSettings(looks=4))
    assert len(photos.asked) == 3
    assert after[0].fit is not None
    assert after[0].fit.radius_m == pytest.approx(0.08 * 0.8**3, abs=0.001)
    np.testing.assert_allclose(after[0].moved_m, [0.01, 0.0], atol=0.002)  # of the first look, and nothing since


def with_edges_of_others(others_of: int) -> Edges:
    """Edges at 8 cm on every ray but those of one photograph, and of the first ones stronger edges at 9 cm, which
    are another's."""
    stem, beside = edges_at(0.08, photos=9), edges_at(0.09, photos=9)
    stem = chosen_edges(stem, stem.photo > 0)
    there = beside.photo < others_of
    return Edges(
        **{
            name: np.concatenate([getattr(stem, name), getattr(beside, name)[there]])
            for name in vars(stem)
            if name not in {"own", "strength"}
        },
        strength=np.r_[stem.strength, 20.0 * beside.strength[there]],
        own=np.r_[stem.own, np.zeros(there.sum(), dtype=bool)],
    )


def test_edges_of_others_do_not_move_a_stem() -> None:
    edges, fit, s = with_edges_of_others(9), SilhouetteSettings(), LookSettings()
    stem = replace(UPRIGHT, radius_m=0.085)
    looked = fitted_look(stem, NOWHERE, edges, [], None, fit, s)
    assert looked.fit is not None
    assert looked.fit.radius_m > 0.088
    (own,) = own_looks([looked], [None], fit, s)
    assert own.fit is not None
    assert own.fit.radius_m == pytest.approx(0.08, abs=0.0005)
    # Whether there is a stem, and on how many of all rays, was said by all.
    assert own.fit.contrast == looked.fit.contrast
    assert own.fit.share == pytest.approx(own.fit.rays / len(np.unique(edges.ray)), rel=0.01)
    assert len(own.fit.weight) == len(own.of_fit.ray) == edges.own.sum()
    more = edges_at(0.08, photos=9)
    more = replace(more, photo=more.photo + 100, ray=more.ray + 1000)
    little = LookSettings(well_seen=1.1)
    for own_too in (True, False):
        single = replace(own, single=replace(more, own=np.full(len(more.ray), own_too)))
        fuller = fuller_look(single, None, fit, little, None).fit
        assert fuller is not None
        assert fuller.fuller is own_too


def test_a_stem_that_others_edges_do_not_touch_stays_as_it_is() -> None:
    fit, s = SilhouetteSettings(), LookSettings()
    plain = fitted_look(UPRIGHT, NOWHERE, edges_at(0.08, photos=9), [], None, fit, s)
    far = replace(plain, of_fit=replace(plain.of_fit, own=np.arange(len(plain.of_fit.ray)) > 0))
    assert plain.fit is not None
    weight = plain.fit.weight.copy()
    weight[0] = 0.0
    far = replace(far, fit=replace(plain.fit, weight=weight))
    none = looked_at(None)
    # What is left has to be seen by enough photographs.
    few = fitted_look(UPRIGHT, NOWHERE, with_edges_of_others(9), [], None, fit, s)
    few = replace(few, of_fit=replace(few.of_fit, own=few.of_fit.own & (few.of_fit.photo < 3)))
    looked = own_looks([plain, far, none, few], [None] * 4, fit, s)
    assert [one.fit is before.fit for one, before in zip(looked, (plain, far, none, few), strict=True)] == [True] * 4


def test_small_pictures_of_a_stem_are_fitted_only_where_large_ones_are_too_few() -> None:
    def mixed(large: int) -> Edges:
        near, far = edges_at(0.04, photos=large), edges_at(0.044, photos=9, pixel=0.015)
        rows = [
            [*values, photo + (100 if part is far else 0)]
            for part in (near, far)
            for *values, photo in zip(
                part.support_m, part.angle_rad, part.height_m, part.strength, part.pixel_m,
                part.ray + (1000 if part is far else 0), part.photo, strict=True,
            )
        ]  # fmt: skip
        return edges_from_rows(rows)

    for large, expected in ((8, 0.040), (2, 0.0435)):
        photos = Photos(0.04)
        photos.edges = mixed(large)
        (found,) = looked_again([looked_at(fit_of(0.05, 0.02))], photos, LookSettings(looks=2))
        assert found.fit is not None
        assert found.fit.radius_m == pytest.approx(expected, abs=0.0006 if large == 8 else 0.003)
        assert len(np.unique(found.fitted.photo)) == (8 if large == 8 else 11)
        assert len(np.unique(found.edges.photo)) == large + 9


def test_what_no_picture_shows_clearly_is_judged_by_the_large_ones() -> None:
    """Whether it is a shrub: small pictures let its edges agree better than they do."""
    rng = np.random.default_rng(2)
    rows = [
        (rng.uniform(0.01, 0.3), 0.4 * photo + np.pi * side, 0.0, 3.0, pixel, 2 * photo + side, photo)
        for photo, pixel in enumerate([0.002] * 6 + [0.015] * 9)
        for side in (0, 1)
        for _ in range(8)
    ]
    edges = edges_from_rows(rows)
    thin = replace(UPRIGHT, radius_m=0.05)
    unclear = fitted_look(thin, NOWHERE, edges, [], None, SilhouetteSettings(), LookSettings())
    assert unclear.fit is None
    assert sorted(set(unclear.fitted.photo)) == list(range(6))
    assert unclear.edges is edges


@pytest.mark.parametrize(("pixels", "used"), [(5.0, 6), (3.0, 18)])
def test_large_pictures_are_those_of_four_pixels_of_radius(pixels: float, used: int) -> None:
    """As they are by default: a stem of 8 cm comes out too thick where those of three pixels are fitted with them."""
    large, small = edges_at(0.10, photos=6, pixel=0.10 / pixels), edges_at(0.10, photos=12, pixel=0.10 / 2.6)
    later = {"ray": small.ray + 1000, "photo": small.photo + 100}
    both = Edges(
        **{name: np.concatenate([getattr(large, name), later.get(name, getattr(small, name))]) for name in vars(large)}
    )
    looked = fitted_look(UPRIGHT, NOWHERE, both, [], None, SilhouetteSettings(), LookSettings())
    assert looked.fit is not None
    assert len(np.unique(looked.fitted.photo)) == used


SIDES_DEG = np.arange(-30.0, 31.0, 5.0).tolist()
#: Of photographs that show one edge.
OTHERS_DEG = np.arange(60.0, 121.0, 5.0).tolist()


def half_seen(*, single_deg: Sequence[float] = (), single_px: float = 0.004, seed: int = 0) -> Edges:
    """An oval stem of 40 cm from about one direction, with both edges, and one edge of photographs from others.

    Its longer side lies across the first direction, so that those photographs take it for thicker.
    """
    rng = np.random.default_rng(seed)
    rows = []
    for photo, direction in enumerate([*SIDES_DEG, *single_deg]):
        for side in (0, 1) if photo < len(SIDES_DEG) else (0,):
            for band in range(6):
                angle = np.radians(direction) + np.pi * (0.5 - side)
                at = oval_support(angle) + rng.normal(0.0, 0.001)
                pixel = 0.004 if photo < len(SIDES_DEG) else single_px
                rows.append((at, angle, -0.2 + 0.08 * band, 8.0, pixel, (photo * 2 + side) * 6 + band, photo))
    return edges_from_rows(rows)


def oval_support(angle: float) -> float:
    return 0.2 - 0.016 * float(np.cos(2 * angle))


def oval_points(sides_deg: Sequence[float], *, scatter_m: float = 0.001, seed: int = 1) -> Surface:
    """Points of that stem's surface within 30 degrees of some directions: its hull, less what its bark lies below."""
    rng = np.random.default_rng(seed)
    t = np.radians(np.concatenate([rng.uniform(at - 30.0, at + 30.0, 400) for at in sides_deg]))
    p, slope = 0.2 - 0.016 * np.cos(2 * t), 0.032 * np.sin(2 * t)
    curve = np.column_stack([p * np.cos(t) - slope * np.sin(t), p * np.sin(t) + slope * np.cos(t)])
    away = (rng.normal(-0.0014, scatter_m, len(t)))[:, None] * np.column_stack([np.cos(t), np.sin(t)])
    height = rng.uniform(-0.24, 0.24, len(t))
    return lambda stem: (curve + away, height)


def fuller(edges: Edges, surface: Surface | None, settings: LookSettings | None = None) -> tuple[Looked, Looked]:
    s = settings or LookSettings()
    stem = replace(UPRIGHT, radius_m=0.2)
    first = fitted_look(stem, NOWHERE, edges, [], None, SilhouetteSettings(), s)
    return first, fuller_look(first, None, SilhouetteSettings(), s, surface)


def test_single_edges_of_other_sides_and_no_others_say_what_a_half_seen_stem_is_like() -> None:
    before, after = fuller(half_seen(single_deg=OTHERS_DEG), None)
    assert before.fit is not None
    assert after.fit is not None
    assert len(np.unique(before.of_fit.photo)) == len(SIDES_DEG)
    assert len(np.unique(before.single.photo)) == 13
    assert set(before.edges.photo) == set(range(len(SIDES_DEG)))
    assert after.fitted is before.fitted  # whether there is a stem goes by both edges
    assert after.fit.sectors > before.fit.sectors
    assert after.fit.fuller
    assert after.fit.contrast == before.fit.contrast
    assert not before.fit.fuller
    assert after.fit.std_m < before.fit.std_m
    assert abs(after.fit.radius_m - 0.2) < 0.7 * abs(before.fit.radius_m - 0.2)
    assert len(after.fit.gain) == len(after.of_fit.photo)
    # Photographs that show it small are not asked, and of a stem that is well seen none.
    small = fuller(half_seen(single_deg=OTHERS_DEG, single_px=0.06), None)
    assert small[1] is small[0]
    some = half_seen(single_deg=OTHERS_DEG)
    pixel = np.where(some.photo == some.photo.max(), 0.06, some.pixel_m)
    assert set(fuller(replace(some, pixel_m=pixel), None)[1].of_fit.photo) == set(range(some.photo.max()))
    enough, same = fuller(half_seen(single_deg=OTHERS_DEG), None, LookSettings(well_seen=0.3))
    assert same is enough


def test_single_edges_that_contradict_both_edges_do_not_count() -> None:
    """A stem of 9 cm with both edges in seven photographs was 9 mm thicker by what covers one of them in others."""
    edges = half_seen(single_deg=OTHERS_DEG)
    for most, counts in ((0.5, True), (0.2, False)):  # they move it by a third of what the first fit says
        before, after = fuller(edges, None, LookSettings(against_std=most))
        assert (after is not before) == counts


@pytest.mark.parametrize(
    ("sides_deg", "scatter_m", "counts"),
    [
        ((0.0, 180.0), 0.001, True),
        ((0.0,), 0.001, False),  # where the stem stands, not how thick it is
        ((0.0, 180.0), 0.012, False),  # haze
    ],
)
def test_sharp_faces_count_where_both_ends_of_a_width_are_known(
    sides_deg: Sequence[float], scatter_m: float, counts: bool
) -> None:
    before, after = fuller(half_seen(), oval_points(sides_deg, scatter_m=scatter_m))
    assert before.fit is not None
    assert after.fit is not None
    assert (after.fit.faces > 0) == counts
    if not counts:
        assert after is before
        return
    assert abs(after.fit.radius_m - 0.2) < 0.6 * abs(before.fit.radius_m - 0.2)
    assert abs(after.fit.radius_m - 0.2) < 2 * after.fit.std_m < 1.5 * before.fit.std_m
    assert after.fit.sectors > before.fit.sectors + 0.2


def pulled(surface: Surface, inside_m: float) -> Surface:
    """The same points so far inside of the bark."""

    def moved(stem: StemAxis) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        offsets, height = surface(stem)
        return offsets * (1 - inside_m / np.linalg.norm(offsets, axis=1, keepdims=True)), height

    return moved


def test_faces_that_lie_beside_the_edges_do_not_count() -> None:
    """Two parts of a walk, 3 cm beside each other: one has the edges of a stem, the other its faces."""
    surface = oval_points((0.0, 180.0))
    for inside_m, counts in ((0.004, True), (0.03, False), (-0.03, False)):
        before, after = fuller(half_seen(), pulled(surface, inside_m))
        assert after.fit is not None
        assert (after.fit.faces > 0) == counts
        assert (after is before) != counts


def test_faces_that_err_together_are_no_surer_than_that() -> None:
    """All faces 4 mm inside of the bark: one standard deviation of what depth maps have alike."""
    surface = oval_points((0.0, 180.0))
    true, off = (fuller(half_seen(), one)[1].fit for one in (surface, pulled(surface, 0.004)))
    assert true is not None
    assert off is not None
    assert 0.0005 < true.radius_m - off.radius_m < 0.003
    assert abs(off.radius_m - 0.2) < 2 * off.std_m
    # And all stems of a plot share it.
    both = fuller(half_seen(), None)[0].fit
    assert both is not None
    assert true.common_m > 1.2 * both.common_m

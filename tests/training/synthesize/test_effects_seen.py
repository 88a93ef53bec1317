"""Wind, clouds, glare and barks of the trees' own are seen in what is rendered, not only in the settings."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("embreex")

from fsinfer.io.images import write_image
from tests.training.synthesize.test_phone import alike
from training.synthesize.cameras.camera_path import intrinsics, look_at, make_camera
from training.synthesize.cameras.phone import PhoneEffects
from training.synthesize.cameras.photo import expose
from training.synthesize.forest.light import Light
from training.synthesize.forest.material import Material, pyramid
from training.synthesize.forest.mesh import Mesh, quads
from training.synthesize.forest.textures import bark
from training.synthesize.forest.wind import SWAYING_DBH_M, blown
from training.synthesize.forest.world import NO_WEIGHTS, World, WorldSettings, build_world
from training.synthesize.photographs import Photographs, with_effects
from training.synthesize.render import Caster

WIDTH, HEIGHT = 96, 72
SIZE = (WIDTH, HEIGHT)
#: Looks down on the ground about the origin; what is 3 m above the ground is not in the picture.
DOWN = make_camera(intrinsics(WIDTH, HEIGHT, 60.0), look_at(np.array([0.0, -2.5, 2.0]), np.zeros(3)))
SUN = np.array([0.2, 0.1, np.sqrt(1 - 0.2**2 - 0.1**2)], np.float32)
LIGHT = Light(
    sun_direction=SUN,
    sun=np.full(3, 1.5, np.float32),
    sky=np.full(3, 0.5, np.float32),
    bounce=np.full(3, 0.2, np.float32),
    panorama=np.full((64, 256, 3), 200, np.uint8),
)
GREY = Material(levels=pyramid(np.full((16, 16, 3), 128, np.uint8)), tile_m=1.0)
GROUND = quads(np.zeros((1, 3)), np.array([[50.0, 0.0, 0.0]]), np.array([[0.0, 50.0, 0.0]]), 0)
#: Hangs 3 m above the ground, so that its shadow lies about the origin.
ROOF = quads(3 * SUN[None] / SUN[2], np.array([[0.6, 0.0, 0.0]]), np.array([[0.0, 0.6, 0.0]]), 0)
SETTINGS = WorldSettings(
    radius_m=4.0,
    outer_m=12.0,
    trees=4,
    outer_trees=6,
    slope_deg=0.0,
    roughness=0.2,
    undergrowth=0.0,
    season="winter",
    clutter=False,
    detail_radius_m=1.0,
    ground_step_m=0.5,
    texture_px=64,
    panorama_px=64,
    photo_share=1.0,
)


def grove(effects: PhoneEffects, dbh_m: float, *, photos: tuple[Path, ...] = (), texture_px: int = 64) -> World:
    """A few trees of this diameter."""
    settings = replace(SETTINGS, min_dbh_m=dbh_m, max_dbh_m=dbh_m, photos=photos, texture_px=texture_px)
    return build_world(np.random.default_rng(1), with_effects(settings, effects))


@pytest.fixture(scope="module")
def world() -> World:
    return grove(PhoneEffects(), 0.2)


def before_stem(world: World, number: int) -> NDArray[np.float64]:
    """A place 0.8 m before a stem, at breast height."""
    return np.asarray(world.sections[number].center - np.array([0.0, 0.8, 0.0]))


@pytest.mark.parametrize(("times", "sways"), [(0.8, True), (1.3, False)], ids=["thin", "thick"])
def test_thin_stems_stand_elsewhere_from_photograph_to_photograph_and_thick_ones_do_not(
    times: float, sways: bool
) -> None:
    effects = PhoneEffects(wind_m=0.05)
    drawn = grove(effects, times * SWAYING_DBH_M)
    world = replace(drawn, cards=None, flutter=NO_WEIGHTS)  # leaves, which move anyway
    center = before_stem(world, 0)
    camera = make_camera(intrinsics(WIDTH, HEIGHT, 70.0), look_at(center, center + np.array([0.0, 0.8, 1.2])))
    taken = Photographs(Caster.of(world), world, [camera] * 2, effects, (1,), SIZE, 1)
    (depth, picture), (depth_later, picture_later) = (taken.depth_and_picture(i) for i in range(2))
    assert ((depth > 0) & (depth < 3)).mean() > 0.01  # the stem is there
    moved = np.abs(depth - depth_later) > 0.005
    if not sways:
        np.testing.assert_array_equal(depth, depth_later)
        np.testing.assert_array_equal(picture, picture_later)
        return
    assert moved.mean() > 0.01
    assert (np.abs(picture - picture_later).max(-1) > 0.02).mean() > 0.01
    # In the same gust the photograph is taken once more as it was; and a stem's foot stands still.
    np.testing.assert_array_equal(taken.depth_and_picture(0)[0], depth)
    assert world.swaying is not None
    low = world.swaying.vertices[:, 2] < min(stem.z_ground_m for stem in world.stems) + 0.1
    assert low.any()
    assert world.sway[low].max() < 0.02 < 1.0 < world.sway.max()


@pytest.mark.parametrize("kind", ["leaves", "thin stems"])
def test_a_shadow_goes_where_the_wind_moves_what_throws_it(kind: str) -> None:
    def scene(roof: Mesh) -> Caster:
        cards, swaying = (roof, None) if kind == "leaves" else (None, roof)
        return Caster(GROUND, cards, [GREY], LIGHT, swaying=swaying)

    weights = np.ones(len(ROOF.vertices), np.float32)
    windy = scene(ROOF)
    calm, depth = windy.picture(DOWN, *SIZE, 1), windy.depth(DOWN, *SIZE)
    windy.blow(np.random.default_rng(3), 0.3, weights, weights)
    blowing = windy.picture(DOWN, *SIZE, 1)
    np.testing.assert_array_equal(windy.depth(DOWN, *SIZE), depth)  # only the ground is in the picture, which lies
    assert (np.abs(blowing - calm).max(-1) > 0.1).sum() > 50
    # As if it had always hung there.
    moved = blown(np.random.default_rng(3), ROOF.vertices, weights, 0.3, own=4 if kind == "leaves" else 0)
    np.testing.assert_array_equal(scene(replace(ROOF, vertices=moved)).picture(DOWN, *SIZE, 1), blowing)


def test_clouds_before_the_sun_darken_what_it_lights_and_not_the_shadows(world: World) -> None:
    scene = Caster(GROUND, None, [GREY], LIGHT, swaying=ROOF)
    clear = scene.picture(DOWN, *SIZE, 1)[..., 0]
    lit = clear > (clear.min() + clear.max()) / 2
    assert 0.05 < (~lit).mean() < 0.5
    contrast = clear[lit].mean() - clear[~lit].mean()
    taken = Photographs(scene, world, [DOWN] * 12, PhoneEffects(clouds=0.8), (1,), SIZE, 1)
    assert taken.shots is not None
    sunshine = [shot.sunshine for shot in taken.shots]
    assert min(sunshine) < 0.5
    for i, share in enumerate(sunshine):
        seen = taken.depth_and_picture(i)[1][..., 0]
        # As much of the sun comes through as the photograph's record says; the rest of the sky is a little lighter.
        assert seen[lit].mean() - seen[~lit].mean() == pytest.approx(share * contrast, rel=0.01)
        assert (seen[~lit] >= clear[~lit] * 0.999).all()
        assert seen[~lit].mean() < 1.35 * clear[~lit].mean()
        if share < 0.9:
            assert (seen[lit] < clear[lit]).all()


def test_glare_lifts_what_is_dark_most_of_all_beside_a_bright_sky(world: World) -> None:
    width = 320
    light = np.full((96, width, 3), 0.01, np.float32)
    light[:, width // 2 :] = 3.0
    scene = Caster(GROUND, None, [GREY], LIGHT)

    def photograph(glare: float) -> NDArray[np.float64]:
        taken = Photographs(scene, world, [DOWN], PhoneEffects(glare=glare), (1,), SIZE, 1)
        sensor = replace(taken.sensor(np.random.default_rng(0), light), exposure=1.0, vignetting=0.0, noise=0.0)
        sensor = replace(sensor, sharpening=0.0, contrast=0.0)
        return expose(np.random.default_rng(1), sensor, light).astype(np.float64)

    lifted = photograph(0.05) - photograph(0.0)
    beside, far = lifted[20:76, 150:156].mean(), lifted[20:76, 10:60].mean()
    assert far > 10  # a haze over all
    assert beside > far + 5  # and a halo
    assert lifted.min() > -2


def barks_hit(world: World) -> list[int]:
    """The material that is seen at breast height of each tree of the plot."""
    caster = Caster.of(world)
    found = []
    for number in range(world.in_plot):
        origin = before_stem(world, number).astype(np.float32)[None]
        hits = caster.cast(origin, np.array([[0.0, 1.0, 0.0]], np.float32))
        assert 0.4 < float(hits.t[0]) < 0.8
        found.append(int(world.opaque.material[hits.face[0]]))
    return found


def test_with_barks_of_their_own_no_two_trees_of_the_plot_share_a_material(world: World) -> None:
    shared = barks_hit(world)
    assert shared == [stem.material for stem in world.stems[: world.in_plot]]
    assert world.in_plot == 4
    assert set(shared) <= {1, 2, 3}  # two or three kinds of bark in the whole forest
    own = grove(PhoneEffects(own_bark=1), 0.2)
    found = barks_hit(own)
    assert len(set(found)) == own.in_plot == 4
    textures = [own.materials[number].levels[0] for number in found]
    for number, texture in enumerate(textures):
        assert all(np.abs(texture.astype(float) - other).mean() > 2 for other in textures[:number])
    # Those beyond the plot, which nobody measures, share theirs.
    outside = {stem.material for stem in own.stems[own.in_plot :]}
    assert outside <= {1, 2, 3}


def test_barks_of_their_own_from_one_photograph_have_no_spot_in_common(tmp_path: Path) -> None:
    photo = tmp_path / "bark_oak.png"
    write_image(photo, bark(np.random.default_rng(3), 512)[0])
    photo = photo.rename(tmp_path / "bark_oak.jpg")  # sharp as it is, under a name of those that are looked for
    own = grove(PhoneEffects(own_bark=1), 0.2, photos=(photo,), texture_px=256)
    textures = [own.materials[stem.material].levels[0] for stem in own.stems[: own.in_plot]]
    assert len(textures) == 4
    # Of four cuts two at least are mirrored alike: as they are, those have a hundred features in common.
    assert max(alike(one, other) for one, other in combinations(textures, 2)) < 20

"""Everything put together: a forest (or objects) on a terrain under a sky."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from training.synthesize.forest.boards import Target, board_material, board_pair, stick, stick_material
from training.synthesize.forest.cards import KINDS, card_material
from training.synthesize.forest.clutter import clutter_object
from training.synthesize.forest.foliage import branches, fork, leaf_cards
from training.synthesize.forest.light import Light, random_light
from training.synthesize.forest.material import Material
from training.synthesize.forest.mesh import Mesh, merge
from training.synthesize.forest.stem import Section, Stem, measure_section, random_stem, stem_curve, stem_mesh
from training.synthesize.forest.terrain import Terrain, make_terrain, terrain_mesh
from training.synthesize.forest.textures import make_material
from training.synthesize.forest.undergrowth import litter, log, scatter, shrub, stones, tufts
from training.synthesize.forest.wind import SWAYING_DBH_M, plant_weights, stem_weights

#: Leaves that lie on the ground one by one, at most; the rest of the litter is texture. Source: numerics.
MOST_LITTER = 15000
#: Radius that cameras take objects other than stems to have. Source: judgement.
CLUTTER_RADIUS_M = 0.8
NO_WEIGHTS = np.zeros(0, np.float32)


@dataclass(frozen=True, kw_only=True)
class WorldSettings:
    """How a world is drawn. ``trees`` stand within ``radius_m``; thinner forest goes on to ``outer_m``.

    ``windy``: what sways is kept apart. ``own_bark``: each tree of the plot has a bark of its own. ``double_faced``:
    both sheets of a board show the same number.
    """

    radius_m: float
    outer_m: float
    trees: int
    outer_trees: int
    slope_deg: float
    roughness: float
    undergrowth: float
    season: str
    clutter: bool
    detail_radius_m: float
    ground_step_m: float
    outer_gap_m: float = 1.0
    outer_sides: int = 28
    outer_step_m: float = 0.15
    targets: int = 0
    texture_px: int = 1024
    panorama_px: int = 1024
    photos: tuple[Path, ...] = ()
    photo_share: float = 0.6
    min_dbh_m: float = 0.08
    max_dbh_m: float = 0.7
    windy: bool = False
    own_bark: bool = False
    double_faced: bool = False


@dataclass(kw_only=True)
class World:
    """A finished world; ``sections`` are the true breast-height sections of ``stems``, the first ``in_plot`` inside.

    ``curves`` are the true stem curves of those inside.

    With wind, ``swaying`` holds thin stems and shrubs, which else are in ``opaque``; ``sway`` and ``flutter`` say how
    far each vertex of ``swaying`` and of ``cards`` moves (see :mod:`training.synthesize.forest.wind`).
    """

    terrain: Terrain
    opaque: Mesh
    cards: Mesh | None
    materials: list[Material]
    light: Light
    stems: list[Stem]
    sections: list[Section]
    curves: list[list[tuple[float, float]]]
    in_plot: int
    markers: dict[str, Any]
    obstacles: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    swaying: Mesh | None = None
    sway: NDArray[np.float32] = field(default_factory=lambda: NO_WEIGHTS)
    flutter: NDArray[np.float32] = field(default_factory=lambda: NO_WEIGHTS)


def place_stems(
    rng: np.random.Generator,
    count: int,
    radius_m: float,
    inner_m: float,
    taken: Sequence[tuple[float, float]],
    gap_m: float,
) -> list[tuple[float, float]]:
    """Up to ``count`` places in a ring, ``gap_m`` apart from each other and from ``taken``."""
    places = list(taken)
    for _ in range(count * 12):
        if len(places) - len(taken) >= count:
            break
        r = np.sqrt(rng.uniform(inner_m**2, radius_m**2))
        a = rng.uniform(0, 2 * np.pi)
        x, y = float(r * np.cos(a)), float(r * np.sin(a))
        if all((x - p) ** 2 + (y - q) ** 2 > gap_m**2 for p, q in places):
            places.append((x, y))
    return places[len(taken) :]


def target_places(posts: int, radius_m: float) -> list[tuple[float, float]]:
    """Places of ``posts`` board posts around the plot's middle, and of the stick at the end; none for 0."""
    angles = 0.5 + 2 * np.pi * np.arange(posts) / max(posts, 1)
    places = [(0.5 * radius_m * float(np.cos(a)), 0.5 * radius_m * float(np.sin(a))) for a in angles]
    return [*places, (0.3, 0.2)] if posts else []


def make_targets(
    terrain: Terrain,
    places: list[tuple[float, float]],
    materials: list[Material],
    wood: int,
    *,
    double_faced: bool = False,
) -> list[Target]:
    """Board posts at all ``places`` but the last, where the stick stands; appends to ``materials``."""
    targets: list[Target] = []
    for number, (x, y) in enumerate(places[:-1]):
        pair = (number, number) if double_faced else (2 * number, 2 * number + 1)
        ids = (len(materials), len(materials) + 1)
        materials += [board_material(i) for i in pair]
        facing = float(np.arctan2(y, x)) + 0.25 * (-1) ** number
        targets += board_pair(terrain, np.array([x, y]), facing, pair, ids, wood)
    if places:
        materials.append(stick_material())
        targets.append(stick(terrain, np.array(places[-1]), len(materials) - 1, wood))
    return targets


def shade_feet(ground: Mesh, obstacles: NDArray[np.float64]) -> None:
    """Darken the ground around the feet of ``obstacles`` (k, 3: x, y, radius), where they hide half the sky."""
    x, y = ground.vertices[:, 0], ground.vertices[:, 1]
    for cx, cy, radius in obstacles:
        near = np.flatnonzero((np.abs(x - cx) < radius + 1) & (np.abs(y - cy) < radius + 1))
        beyond = np.hypot(x[near] - cx, y[near] - cy) - radius
        ground.tint[near] *= (1 - 0.45 * np.exp(-np.maximum(beyond, 0) / 0.2)).astype(np.float32)[:, None]


def build_world(rng: np.random.Generator, settings: WorldSettings) -> World:
    """Draw a world from ``rng``."""
    photos, share = settings.photos, settings.photo_share
    materials = [make_material(rng, "ground", photos, photo_share=share, size=settings.texture_px)]
    barks = [len(materials) + i for i in range(int(rng.integers(2, 4)))]
    materials += [make_material(rng, "bark", photos, photo_share=share, size=settings.texture_px) for _ in barks]
    stone = len(materials)
    materials.append(make_material(rng, "rock", photos, photo_share=share, size=settings.texture_px))
    others = []
    if settings.clutter:
        others = [len(materials) + i for i in range(3)]
        kinds = rng.choice(["generic", "rock", "generic", "bark"], len(others))
        size = settings.texture_px
        materials += [make_material(rng, str(k), photos, photo_share=share / 2, size=size) for k in kinds]
        others.append(stone)
    first_card = len(materials)
    materials += [card_material(rng, k, photos) for k in KINDS]
    materials.append(card_material(rng, "leaves", photos))
    leaves, needles, fern, grass, leaves_2 = range(first_card, first_card + 5)
    terrain = make_terrain(rng, slope_deg=settings.slope_deg, roughness=settings.roughness)
    light = random_light(rng, forest=not settings.clutter, panorama_px=settings.panorama_px)
    opaque = [
        terrain_mesh(
            terrain,
            fine_radius_m=settings.detail_radius_m,
            step_m=settings.ground_step_m,
            extent_m=max(60.0, settings.outer_m + 20),
            material=0,
            tile_m=materials[0].tile_m,
        )
    ]
    cards: list[Mesh] = []
    swaying: list[Mesh] = []
    sway: list[NDArray[np.float32]] = []
    gap = rng.uniform(0.9, 2.2) if settings.trees else 2.0
    spots = target_places(settings.targets, settings.radius_m)
    inner = place_stems(rng, settings.trees, settings.radius_m, 0.0, spots, gap)
    outer = place_stems(
        rng, settings.outer_trees, settings.outer_m, settings.radius_m + settings.outer_gap_m, inner, 1.2
    )
    median = np.exp(rng.uniform(np.log(0.14), np.log(0.38)))
    conifer = rng.random() < 0.5
    low_crown = rng.uniform(0.1, 0.45)
    lean_scale = rng.uniform(0.5, 1.6)
    leafless = settings.season == "winter" and not conifer
    stems, sections, curves, obstacles = [], [], [], []
    for number, (x, y) in enumerate([*inner, *outer]):
        dbh = float(np.clip(median * np.exp(rng.normal(0, 0.4)), settings.min_dbh_m, settings.max_dbh_m))
        z = float(terrain.height(np.float64(x), np.float64(y)))
        material = barks[int(rng.integers(len(barks)))]
        stem = random_stem(rng, x, y, z, dbh_m=dbh, material=material, lean_scale=lean_scale)
        near = number < len(inner)
        if settings.own_bark and near:
            material = len(materials)
            size = settings.texture_px
            materials.append(make_material(rng, "bark", photos, photo_share=share, size=size, own=True))
            stem = replace(stem, material=material)
        sides, step = ((128 if dbh > 0.3 else 96), 0.02) if near else (settings.outer_sides, settings.outer_step_m)
        mesh = stem_mesh(stem, materials, sides=sides, step_m=step)
        parts = [mesh]
        tile = materials[material].tile_m
        if stem.fork_at_m:
            parts.append(fork(stem, rng, tile))
        stems.append(stem)
        sections.append(measure_section(stem, mesh))
        if near:
            curves.append(stem_curve(stem, mesh))
        obstacles.append((x, y, dbh / 2))
        crown = stem.height_m * rng.uniform(low_crown, low_crown + 0.3)
        dead = int(rng.poisson(14 if conifer else 4)) if near else 2
        meshes, ends = branches(rng, stem, dead=dead, live=24 if near else 14, crown_m=crown, tile_m=tile)
        parts += meshes
        if settings.windy and dbh < SWAYING_DBH_M:
            swaying += parts
            sway += [stem_weights(part, z, stem.height_m) for part in parts]
        else:
            opaque += parts
        if not leafless and len(ends):
            leaf_kinds = [needles] if conifer else [leaves, leaves_2]
            cards.append(leaf_cards(rng, ends, leaf_kinds, size_m=0.8, spread_m=0.35))
    clutter = int(rng.integers(4, 12)) if settings.clutter else 0
    for x, y in place_stems(rng, clutter, settings.radius_m, 0.3, inner, 1.4):
        z = float(terrain.height(np.float64(x), np.float64(y)))
        opaque += clutter_object(rng, x, y, z, others, [materials[i].tile_m for i in others])
        obstacles.append((x, y, CLUTTER_RADIUS_M))
    targets = make_targets(terrain, spots, materials, stone, double_faced=settings.double_faced)
    opaque += [m for t in targets for m in t.meshes]
    obstacles += [(x, y, 0.2) for x, y in spots]
    markers = {"boards": [t.record for t in targets if "id" in t.record]}
    markers |= {"sticks": [t.record for t in targets if "length_m" in t.record]}
    shade_feet(opaque[0], np.array(obstacles).reshape(-1, 3))
    rich, reach = settings.undergrowth, settings.detail_radius_m
    bare = settings.season == "winter"
    leaf_count = int(min(rng.uniform(2, 50) * np.pi * reach**2, MOST_LITTER))
    cards.append(litter(rng, terrain, scatter(rng, leaf_count, reach), [leaves, leaves_2]))
    if rich > 0:
        count = int(rich * rng.uniform(150, 4000))
        places = scatter(rng, count + 2, reach, clumps=14)
        cards.append(tufts(rng, terrain, places, [grass], height_m=(0.08, rng.uniform(0.15, 0.5))))
        places = scatter(rng, int(rich * rng.uniform(10, 500)) + 2, reach, clumps=5)
        cards.append(tufts(rng, terrain, places, [fern], height_m=(0.15, rng.uniform(0.3, 0.9))))
        for place in scatter(rng, int(rich * rng.uniform(0, 40)), reach):
            if not obstacles or np.hypot(*(np.array(obstacles)[:, :2] - place).T).min() > 0.5:
                stems_mesh, leaf_mesh = shrub(rng, terrain, place, barks[0], [leaves, leaves_2])
                if settings.windy:
                    swaying.append(stems_mesh)
                    sway.append(plant_weights(stems_mesh, terrain))
                else:
                    opaque.append(stems_mesh)
                cards += [] if bare else [leaf_mesh]
    opaque += stones(rng, terrain, scatter(rng, int(rng.integers(0, 25)), reach), stone, materials[stone].tile_m)
    for place in scatter(rng, int(rng.integers(0, 4)), reach):
        opaque.append(log(rng, terrain, place, barks[0], materials[barks[0]].tile_m))
    return World(
        terrain=terrain,
        opaque=merge(opaque),
        cards=merge(cards) if cards else None,
        materials=materials,
        light=light,
        stems=stems,
        sections=sections,
        curves=curves,
        in_plot=len(inner),
        markers=markers,
        obstacles=np.array(obstacles).reshape(-1, 3),
        swaying=merge(swaying) if swaying else None,
        sway=np.concatenate(sway) if sway else NO_WEIGHTS,
        flutter=np.concatenate([plant_weights(m, terrain) for m in cards]) if settings.windy and cards else NO_WEIGHTS,
    )

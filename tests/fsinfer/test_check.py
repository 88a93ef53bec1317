"""The check names the stems that were seen from one side, says from where to go on, and leaves the others alone."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer import photo_stages, pipeline
from fsinfer.check import CheckSettings, check_capture
from fsinfer.check.advice import advice, marker_lines
from fsinfer.check.capture import CheckResult, judge_scene
from fsinfer.check.coverage import CoverageSettings, judge_stems, widest_gap
from fsinfer.check.map import draw_map, seen_arcs
from fsinfer.check.north import COMPASS_WORDS, MAP_WORDS, find_compass
from fsinfer.check.open_sides import open_sides
from fsinfer.check.sparse_stems import SparseStemSettings, find_sparse_stems
from fsinfer.errors import InputError
from fsinfer.frames import FrameSettings
from fsinfer.images import read_image, write_image
from fsinfer.poses import PoseSettings, PosesResult, estimate_poses
from fsinfer.scale import Scale
from fsinfer.scene import Camera, Scene, View
from fsinfer.sfm import reconstruct
from fsinfer.sparse import SparseModel
from tests.fsinfer.rendered_room import look_at, photographs

# Plan position and radius, metres; the last stands outside the walk.
STEMS = [(1.5, 0.0, 0.12), (-2.0, 1.5, 0.2), (0.0, -2.5, 0.06), (-1.0, -1.0, 0.15), (2.0, 2.5, 0.1), (9.0, 0.0, 0.15)]
PHOTOS = 48
NO_SCALE = Scale(m_per_unit=None, source="none", rel_std=None)
UNIT = 0.4  # metres per scene unit


def make(hidden: dict[int, float], noise_m: float = 0.01) -> tuple[Scene, SparseModel]:
    """A plot walked all round; ``hidden`` stems are not seen by the photos in the half-plane of that direction."""
    rng = np.random.default_rng(0)
    angles = np.linspace(0, 2 * np.pi, PHOTOS, endpoint=False)
    centers = np.column_stack([5 * np.cos(angles), 5 * np.sin(angles), np.full(PHOTOS, 1.5)])
    points, normals, owner = [], [], []
    ground = np.column_stack([rng.uniform(-9, 10, (4000, 2)), rng.normal(0, 0.02, 4000)])
    points.append(ground)
    normals.append(np.tile([0.0, 0, 1], (4000, 1)))
    owner.append(np.full(4000, -1))
    for number, (x, y, radius) in enumerate(STEMS):
        turn, height = rng.uniform(0, 2 * np.pi, 500), rng.uniform(0.05, 4, 500)
        out = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(500)])
        points.append(
            np.array([x, y, 0]) + radius * out + height[:, None] * [0, 0, 1] + rng.normal(0, noise_m, (500, 3))
        )
        normals.append(out)
        owner.append(np.full(500, number))
    bush = rng.uniform([-3.6, -3.2, 0.1], [-2.6, -2.2, 2.4], (250, 3))
    points.append(bush)
    normals.append(np.tile([0.0, 0, 1], (250, 1)))
    owner.append(np.full(250, -1))
    xyz, normal, own = np.concatenate(points), np.concatenate(normals), np.concatenate(owner)
    observations, views, tracks = {}, [], np.zeros(len(xyz), dtype=np.int64)
    down = np.array([0.0, 0.0, -1.0])
    for index, center in enumerate(centers):
        ray = center - xyz
        facing = (ray * normal).sum(axis=1) / np.linalg.norm(ray, axis=1) > 0.45
        seen = (facing | (own < 0)) & (rng.random(len(xyz)) < 0.4)
        for number, direction in hidden.items():
            bearing = np.degrees(np.arctan2(center[1] - STEMS[number][1], center[0] - STEMS[number][0]))
            if abs((bearing - direction + 180) % 360 - 180) < 90:
                seen &= own != number
        observations[f"p{index:02d}"] = np.flatnonzero(seen)
        tracks += seen
        # look_at has y down: the world is turned so that z is up afterwards.
        flip = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        pose = look_at(flip @ center, flip @ (0.1 * center + 1.1 * 1.3 * -down / 1.43))
        pose[:3, :3] = pose[:3, :3] @ flip
        pose[:3, 3] = -pose[:3, :3] @ center / UNIT
        camera = Camera(intrinsic=np.eye(3), cam_from_world=pose, depth_min=0.1, depth_max=9.0)
        views.append(View(name=f"p{index:02d}", image_path=Path(f"p{index:02d}.jpg"), camera=camera, sources=()))
    sparse = SparseModel(
        points=xyz / UNIT, errors_px=np.full(len(xyz), 0.5), track_lengths=tracks, observations=observations
    )
    return Scene(folder=Path(), views=tuple(views)), sparse


def check(hidden: dict[int, float], scale: Scale = NO_SCALE) -> CheckResult:
    scene, sparse = make(hidden)
    return judge_scene(scene, sparse, [view.image_path for view in scene.views], scale, NO_SCALE)


def truth_of(result: CheckResult) -> dict[int, str]:
    """Verdict by number in STEMS; the plan is only turned and shifted against the truth."""
    angles = np.linspace(0, 2 * np.pi, PHOTOS, endpoint=False)
    true = 5 * np.exp(1j * angles)
    plan = result.cameras @ [1, 1j]
    factor = ((plan - plan.mean()).conj() * true).sum() / (np.abs(plan - plan.mean()) ** 2).sum()
    verdicts = {}
    for entry in result.stems:
        place = factor * (entry.stem.center @ [1, 1j] - plan.mean())
        apart = [abs(complex(x, y) - place) for x, y, _ in STEMS]
        assert min(apart) < 0.05
        verdicts[int(np.argmin(apart))] = entry.verdict
    return verdicts


def test_a_plot_walked_all_round_has_nothing_to_do_again() -> None:
    result = check({})
    assert truth_of(result) == {**dict.fromkeys(range(5), "good"), 5: "outside"}
    assert result.lines == ()
    assert any("5 stems within your walk, 5 of them seen all round; 1 outside" in note for note in result.notes)


def test_a_plot_without_stems_says_that_it_cannot_judge() -> None:
    scene, sparse = make({})
    settings = CheckSettings(stems=SparseStemSettings(min_points=10_000))
    result = judge_scene(
        scene, sparse, [view.image_path for view in scene.views], NO_SCALE, NO_SCALE, settings=settings
    )
    assert (result.stems, result.lines) == ((), ())
    assert any(note.startswith("No stem was found") for note in result.notes)


@pytest.mark.parametrize("hidden", [{1: 40.0}, {0: 200.0, 3: 310.0}])
def test_the_stems_behind_curtains_are_named_and_no_others(hidden: dict[int, float]) -> None:
    result = check(hidden, Scale(m_per_unit=UNIT, source="aruco", rel_std=0.001))
    verdicts = truth_of(result)
    assert {number for number, verdict in verdicts.items() if verdict == "one side"} == set(hidden)
    assert {verdicts[number] for number in set(range(5)) - set(hidden)} == {"good"}
    assert len(result.lines) == len(hidden)
    for line in result.lines:
        assert line.startswith("Walk round tree ")
    # The photo that is named as the place stands where the curtain was.
    for entry in (entry for entry in result.stems if entry.verdict == "one side"):
        number = min(hidden, key=lambda n: abs(complex(*STEMS[n][:2]) - _true_place(result, entry.stem.center)))
        line = next(line for line in result.lines if f"tree {entry.number} " in line)
        angle = 2 * np.pi * int(line.split("photo p")[-1][:2]) / PHOTOS
        seen_from = np.degrees(np.arctan2(5 * np.sin(angle) - STEMS[number][1], 5 * np.cos(angle) - STEMS[number][0]))
        assert abs((seen_from - hidden[number] + 180) % 360 - 180) < 35


def test_trees_beyond_the_open_side_of_a_walk_that_stopped_early_are_named() -> None:
    scene, sparse = make({})
    # From 0 to 195 degrees: what lies below the chord back to the start was meant to be passed, too.
    views = scene.views[:27]
    observations = {view.name: sparse.observations[view.name] for view in views}
    tracks = np.bincount(np.concatenate([*observations.values()]), minlength=len(sparse.points))
    sparse = replace(sparse, observations=observations, track_lengths=tracks)
    result = judge_scene(replace(scene, views=views), sparse, [view.image_path for view in views], NO_SCALE, NO_SCALE)
    own = [view.camera.center[:2] * UNIT @ [1, 1j] for view in views]
    plan, true = result.cameras @ [1, 1j], np.array(own)
    factor = ((plan - plan.mean()).conj() * (true - true.mean())).sum() / (np.abs(plan - plan.mean()) ** 2).sum()
    beyond = {}
    for entry in (entry for entry in result.stems if entry.verdict == "beyond"):
        place = complex(factor * (entry.stem.center @ [1, 1j] - plan.mean()) + true.mean())
        beyond[int(np.argmin([abs(complex(x, y) - place) for x, y, _ in STEMS]))] = entry.number
    # The others stand inside, or within the margin; the last is too far out to have been meant.
    assert set(beyond) == {2}
    assert result.lines[0].startswith("Between the places of photos p00 and p26 no photo was placed for 10 m.")
    assert f"if tree {beyond[2]} beyond it, seen from one side only, belongs to your plot" in result.lines[0]


def test_open_sides() -> None:
    angles = np.radians(np.arange(0, 360, 4))
    circle = 8 * np.column_stack([np.cos(angles), np.sin(angles)])
    assert open_sides(circle) == []
    # A quarter left out; photos of a second, smaller round do not close it.
    side = open_sides(np.concatenate([circle[:68], circle[::5] / 2]))
    assert [entry.photos for entry in side] == [(0, 67)]
    assert side[0].length_m == pytest.approx(2 * 8 * np.sin(np.radians(46)), rel=1e-6)
    np.testing.assert_array_equal(
        side[0].beyond(np.array([[5.0, -5.0], [0.0, 0.0], [20.0, -20.0]])), [True, False, False]
    )
    # However the plan is turned: rounding may put a corner beyond the end of its own edge.
    for turn in np.linspace(0.0, 6.0, 50):
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        assert [entry.photos for entry in open_sides(circle[:68] @ rotation.T)] == [(0, 67)]
    # There and back on a line, and too few photos: no inside, no side.
    line = np.column_stack([np.arange(0, 20, 0.5), np.zeros(40)])
    assert open_sides(line) == open_sides(line[:2]) == []
    # A walk along the sides of a square, its corners cut: photos on every side.
    step = np.arange(0.5, 10, 0.5)
    zero = np.zeros_like(step)
    square = np.concatenate(
        [np.column_stack(pair) for pair in ((step, zero), (zero + 10, step), (10 - step, zero + 10), (zero, 10 - step))]
    )
    assert open_sides(square) == []


def test_the_other_side_seen_from_too_far_is_said() -> None:
    _, sparse = make({})
    points = sparse.points * UNIT
    stem = find_sparse_stems(points, points[:, 2], np.ones(len(points), bool))[:1]
    turns = np.radians(np.arange(0, 360, 10))
    seen = [stem[0].members[:20] if index < 19 else stem[0].members[:0] for index in range(36)]
    told = []
    for other_side_m in (5.0, 12.0):
        reach = np.where(np.arange(36) < 19, 4.0, other_side_m)
        cameras = stem[0].center + reach[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
        judged = judge_stems(stem, seen, cameras, np.array([True]))
        compass = find_compass(cameras, {})
        names = [f"p{index:02d}" for index in range(36)]
        offsets = [cameras - judged[0].stem.center]
        told += advice(names=names, left_out=[], given=names, stems=judged, compass=compass, offsets_m=offsets)
    assert ["or from more than 9 m" in line for line in told] == [False, True]


def _true_place(result: CheckResult, center: NDArray[np.float64]) -> complex:
    true = 5 * np.exp(1j * np.linspace(0, 2 * np.pi, PHOTOS, endpoint=False))
    plan = result.cameras @ [1, 1j]
    factor = ((plan - plan.mean()).conj() * true).sum() / (np.abs(plan - plan.mean()) ** 2).sum()
    return complex(factor * (center @ [1, 1j] - plan.mean()))


def test_the_map_shows_the_missing_side(tmp_path: Path) -> None:
    colours = {}
    for name, hidden in (("all", {}), ("one", {1: 40.0})):
        draw_map(check(hidden), tmp_path / f"{name}.png")
        picture = read_image(tmp_path / f"{name}.png").astype(int)
        colours[name] = int((np.abs(picture - [0xD5, 0x5E, 0x00]).sum(axis=2) < 30).sum())
    # The legend has a spot of this colour in both.
    assert colours["one"] > colours["all"] + 1000


def test_radius_and_place_of_stems_and_no_bush() -> None:
    _, sparse = make({})
    points = sparse.points * UNIT
    stems = find_sparse_stems(points, points[:, 2], np.ones(len(points), bool))
    assert len(stems) == len(STEMS)
    for stem in stems:
        apart = [np.hypot(stem.center[0] - x, stem.center[1] - y) for x, y, _ in STEMS]
        assert min(apart) < 0.02
        assert stem.radius == pytest.approx(STEMS[int(np.argmin(apart))][2], abs=0.02)


def test_one_stray_match_does_not_hide_a_side() -> None:
    _, sparse = make({})
    points = sparse.points * UNIT
    stem = find_sparse_stems(points, points[:, 2], np.ones(len(points), bool))[:1]
    cameras = stem[0].center + 4 * np.column_stack(
        [np.cos(np.radians(np.arange(0, 360, 10))), np.sin(np.radians(np.arange(0, 360, 10)))]
    )
    seen = [stem[0].members[:20] if index < 19 else stem[0].members[:0] for index in range(36)]
    judged = judge_stems(stem, seen, cameras, np.array([True]))[0]
    assert (judged.verdict, judged.gap_deg) == ("one side", pytest.approx(180))
    assert judged.gap_center_deg == pytest.approx(270)
    seen[27] = stem[0].members[:2]
    assert judge_stems(stem, seen, cameras, np.array([True]))[0].verdict == "one side"
    seen[27] = stem[0].members[:6]
    assert judge_stems(stem, seen, cameras, np.array([True]))[0].verdict == "good"
    few = [one if index % 5 == 0 else one[:0] for index, one in enumerate(seen)]
    assert judge_stems(stem, few, cameras, np.array([True]), settings=CoverageSettings(few_share=0.3))[0].verdict == (
        "hardly seen"
    )


def test_widest_gap_and_arcs() -> None:
    assert widest_gap(np.array([])) == (360.0, 0.0)
    assert widest_gap(np.array([10.0])) == (360.0, 190.0)
    assert widest_gap(np.array([350.0, 10.0, 100.0])) == (250.0, pytest.approx(225.0))
    assert seen_arcs(np.arange(0, 360, 20.0)) == [(0.0, 360.0)]
    assert seen_arcs(np.array([350.0, 0.0, 10.0])) == [(335.0, 385.0)]
    assert seen_arcs(np.array([0.0, 10.0, 180.0])) == [(165.0, 195.0), (-15.0, 25.0)]


def test_north_by_gnss_and_by_the_first_photo() -> None:
    rng = np.random.default_rng(1)
    angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    cameras = 15 * np.column_stack([np.cos(angles), np.sin(angles)])
    # The plan's x axis points north; the phone is 2 m off each time.
    north, east = cameras[:, 0], -cameras[:, 1]
    noise = rng.normal(0, 2, (40, 2))
    latitude = 48 + np.degrees((north + noise[:, 0]) / 6_371_000)
    longitude = 9 + np.degrees((east + noise[:, 1]) / 6_371_000 / np.cos(np.radians(48)))
    compass = find_compass(cameras, dict(enumerate(zip(latitude.tolist(), longitude.tolist(), strict=True))))
    assert compass.known
    assert compass.turn_deg == pytest.approx(90, abs=5)
    assert [compass.side(angle) for angle in (0, 90, 180, 270)] == [COMPASS_WORDS[i] for i in (2, 4, 6, 0)]
    # A plot no wider than the errors of a phone says nothing about north, and a scatter without sense neither.
    small = find_compass(cameras / 5, dict(enumerate(zip(latitude.tolist(), longitude.tolist(), strict=True))))
    wild = {rank: (48 + rng.normal(0, 1e-4), 9 + rng.normal(0, 1e-4)) for rank in range(40)}
    assert not small.known
    assert not find_compass(cameras, wild).known
    # Without north, what lies towards the first photo is at the bottom of the map.
    assert small.side(0.0) == MAP_WORDS[6] == "the bottom of the map"


def test_photos_that_did_not_join_are_told_by_stretches() -> None:
    given = [f"p{index}" for index in range(10)]
    lines = advice(
        names=[],
        left_out=["p2", "p3", "p4", "p8"],
        given=given,
        stems=[],
        compass=find_compass(np.array([[0.0, -1], [0, 1]]), {}),
        offsets_m=[],
    )
    assert lines[0].startswith("Photos p2 to p4 (3) did not join the others: walk this stretch again")
    assert lines[1].startswith("Photo p8 did not join")
    assert lines[2].startswith("4 of 10 photos are missing so: mend the walk first")


def test_a_few_lost_photos_are_no_torn_walk() -> None:
    given = [f"p{index:02}" for index in range(40)]
    compass = find_compass(np.array([[0.0, -1], [0, 1]]), {})
    lines = advice(names=[], left_out=given[7:11], given=given, stems=[], compass=compass, offsets_m=[])
    assert len(lines) == 1
    assert lines[0].startswith("Photos p07 to p10 (4) did not join")


def test_boards_seen_too_seldom_or_from_far() -> None:
    def entry(number: int, views: int, side_px: float) -> dict[str, object]:
        return {"id": number, "views": [str(i) for i in range(views)], "near_side_px": side_px}

    found = [entry(40, 12, 80.0), entry(41, 4, 80.0), entry(42, 12, 20.0)]
    rejected = [{"id": 43, "reason": "1 views"}, {"id": 40, "reason": "1 views"}]
    scale = Scale(m_per_unit=1.0, source="aruco", rel_std=0.01, details={"markers": found, "rejected": rejected})
    lines = marker_lines(scale, given=True)
    assert [line.split(":")[0] for line in lines] == [
        "Board 40",
        "Board 41",
        "Board 42",
        "Board 43 cannot be used (1 views)",
    ]
    assert [line.endswith("good.") for line in lines] == [True, False, False, False]
    assert "no scale" in marker_lines(NO_SCALE, given=False)[0]
    assert "--aruco-length-m" in marker_lines(scale, given=False)[-1]


def test_a_board_at_two_places_tells_of_photos_placed_wrongly() -> None:
    scene, sparse = make({})
    names = [view.image_path for view in scene.views]

    def entry(number: int, x_m: float, views: list[str]) -> dict[str, Any]:
        return {"id": number, "center": [x_m / UNIT, 0.0, 1.0], "views": views, "near_side_px": 80.0}

    first, again = entry(40, 3.0, ["p01", "p02", "p03", "p04"]), entry(40, -1.5, ["p31", "p30", "p32"])
    for markers, told in (([first, entry(41, 0.0, ["p05", "p06", "p07"])], 0), ([again, first], 1)):
        boards = Scale(m_per_unit=UNIT, source="aruco", rel_std=0.01, details={"markers": markers})
        lines = judge_scene(scene, sparse, names, boards, boards).lines
        assert len(lines) == told
        if told:
            assert lines[0].startswith("Board 40 was found at two places 4.5 m apart.")
            assert "perhaps p30 to p32" in lines[0]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often photos were placed; depth is never computed."""
    calls: Counter[str] = Counter()

    def place(*args: Any, **kwargs: Any) -> PosesResult:
        calls["poses"] += 1
        return estimate_poses(*args, **kwargs)

    def no_depth(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(photo_stages, "estimate_poses", place)
    monkeypatch.setattr(pipeline, "estimate_depth", no_depth)
    return calls


def test_check_and_run_place_the_photos_once(tmp_path: Path, calls: Counter[str]) -> None:
    folder, out = tmp_path / "photos", tmp_path / "out"
    images = photographs(9)
    for index in range(8):
        write_image(folder / f"r{index}.jpg", images[index])
    poses = PoseSettings(max_features=1500)
    result = check_capture(folder, out, settings=CheckSettings(poses=poses))
    assert result.registered == 8
    assert not any(entry.inside for entry in result.stems)
    record = json.loads((out / "check" / "check.json").read_text(encoding="utf-8"))
    assert record["registered"] == 8
    assert (out / "check" / "check.png").is_file()
    # A run, here one that dies in its third stage, finds the first two done.
    with pytest.raises(KeyboardInterrupt):
        pipeline.run(folder, out, settings=pipeline.RunSettings(poses=poses))
    again = check_capture(folder, out, settings=CheckSettings(poses=poses))
    assert (again.registered, calls["poses"]) == (8, 1)
    assert not any("other settings" in note for note in again.notes)
    # What hangs on the run's poses is not thrown away for a check with other settings.
    other = check_capture(folder, out, settings=CheckSettings(poses=poses, frames=FrameSettings(interval_s=1.0)))
    assert (other.registered, calls["poses"]) == (8, 1)
    assert any("other settings" in note for note in other.notes)
    # The photos that a check asked for are placed with the rest.
    write_image(folder / "r8.jpg", images[8])
    more = check_capture(folder, out, settings=CheckSettings(poses=poses))
    assert (more.photos, more.registered, calls["poses"]) == (9, 9, 2)
    assert not any("other settings" in note for note in more.notes)


def test_a_check_that_was_stopped_goes_on(tmp_path: Path, calls: Counter[str], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, out = tmp_path / "photos", tmp_path / "out"
    for index, image in enumerate(photographs()):
        write_image(folder / f"r{index}.jpg", image)
    settings = CheckSettings(poses=PoseSettings(max_features=1500))

    def stop(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("fsinfer.poses.reconstruct", stop)
        with pytest.raises(KeyboardInterrupt):
            check_capture(folder, out, settings=settings)
    database = out / "scene" / "work" / "database.db"
    inode, size = database.stat().st_ino, database.stat().st_size
    seen: list[tuple[int, int]] = []

    def look(path: Path, *args: Any) -> Any:
        seen.append((path.stat().st_ino, path.stat().st_size))
        return reconstruct(path, *args)

    monkeypatch.setattr("fsinfer.poses.reconstruct", look)
    assert check_capture(folder, out, settings=settings).registered == 8
    # Features and matches of the first attempt were kept.
    assert seen == [(inode, size)]


def test_a_check_with_other_settings_replaces_an_earlier_check(tmp_path: Path, calls: Counter[str]) -> None:
    folder, out = tmp_path / "photos", tmp_path / "out"
    for index, image in enumerate(photographs()):
        write_image(folder / f"r{index}.jpg", image)
    for features in (1500, 1400):
        check_capture(folder, out, settings=CheckSettings(poses=PoseSettings(max_features=features)))
    assert calls["poses"] == 2


def test_a_scene_of_other_origin_is_refused(tmp_path: Path) -> None:
    write_image(tmp_path / "photos" / "r0.jpg", photographs()[0])
    theirs = tmp_path / "out" / "frames" / "notes.txt"
    theirs.parent.mkdir(parents=True)
    theirs.write_text("precious", encoding="utf-8")
    with pytest.raises(InputError, match="choose another output folder"):
        check_capture(tmp_path / "photos", tmp_path / "out")
    assert theirs.read_text(encoding="utf-8") == "precious"

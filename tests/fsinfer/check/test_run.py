"""The check names the stems that were seen from one side, says from where to go on, and leaves the others alone."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fsinfer.check import CheckResult, CheckSettings, check_capture
from fsinfer.check.coarse_depth import read_glance
from fsinfer.check.compass import gnss_places
from fsinfer.check.map import draw_map
from fsinfer.check.run import _scale as boards_seen
from fsinfer.check.run import judge_survey
from fsinfer.check.settings import SightingSettings, SparseStemSettings
from fsinfer.check.sparse_stems import find_sparse_stems
from fsinfer.check.survey import Survey, SurveySettings, survey_scene
from fsinfer.check.visible_stems import VisibleStem
from fsinfer.errors import InputError
from fsinfer.frames.settings import FrameSettings
from fsinfer.io.images import read_image, write_image
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.notice import notice
from fsinfer.poses.estimate import PosesResult, estimate_poses
from fsinfer.poses.mapping import MappedWalk, Walk
from fsinfer.poses.settings import PoseSettings
from fsinfer.poses.sparse import SparseModel
from fsinfer.poses.sure_pairs import SurePairs, map_sure
from fsinfer.progress import silent
from fsinfer.scale.clicks.file import SavedClicks, clicked_length, write_clicks
from fsinfer.scale.clicks.sizes import picture_sizes
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import MarkerScale, NoUsableMarkersError, RejectedMarker, Scale
from fsinfer.scene import Scene, project, read_scene
from fsinfer.trees import StemSettings
from fsinfer.workflow import photo_stages, pipeline
from fsinfer.workflow.settings import RunSettings
from tests.support.boards import board, scale_of_boards
from tests.support.rendered_room import photographs, poses
from tests.support.room_model import room_model
from tests.support.walked_plot import PHOTOS, STEMS, UNIT, make_plot, walk_angles

NO_SCALE = Scale(m_per_unit=None, source="none", rel_std=None)
METRIC = Scale(m_per_unit=UNIT, source="aruco", rel_std=0.001)
Hidden = dict[int, float]
Plot = Callable[[Hidden], tuple[Scene, SparseModel]]


@pytest.fixture(scope="module")
def plot(tmp_path_factory: pytest.TempPathFactory) -> Plot:
    """The plot with these curtains, made once."""
    made: dict[str, tuple[Scene, SparseModel]] = {}

    def get(hidden: Hidden) -> tuple[Scene, SparseModel]:
        key = repr(hidden)
        if key not in made:
            made[key] = make_plot(tmp_path_factory.mktemp("plot"), hidden)
        return made[key]

    return get


def survey(plot: tuple[Scene, SparseModel], scale: Scale = NO_SCALE, settings: SurveySettings | None = None) -> Survey:
    scene, sparse = plot
    return survey_scene(scene, sparse, read_glance(scene, scene.folder), m_per_unit=scale.m_per_unit, settings=settings)


def check(plot: tuple[Scene, SparseModel], scale: Scale = NO_SCALE) -> CheckResult:
    return judge_survey(survey(plot, scale), [view.name for view in plot[0].views], scale, NO_SCALE)


def true_place(result: CheckResult, center: NDArray[np.float64]) -> complex:
    """The plan is only turned and shifted against the truth."""
    true = 5 * np.exp(1j * walk_angles()[: len(result.cameras)])
    plan = result.cameras @ [1, 1j]
    factor = ((plan - plan.mean()).conj() * (true - true.mean())).sum() / (np.abs(plan - plan.mean()) ** 2).sum()
    return complex(factor * (center @ [1, 1j] - plan.mean()) + true.mean())


def number_of(result: CheckResult, center: NDArray[np.float64], within_m: float = 0.05) -> int:
    """Which of STEMS stands there."""
    apart = [abs(complex(x, y) - true_place(result, center)) for x, y, _ in STEMS]
    assert min(apart) < within_m
    return int(np.argmin(apart))


def verdicts_of(result: CheckResult) -> dict[int, str]:
    return {number_of(result, entry.stem.center): entry.verdict for entry in result.stems}


def test_a_plot_walked_all_round_has_nothing_to_do_again(plot: Plot) -> None:
    result = check(plot({}))
    assert verdicts_of(result) == {**dict.fromkeys(range(5), "good"), 5: "outside"}
    assert result.lines == ()
    assert any("5 stems within your walk, 5 of them seen all round; 1 outside" in note for note in result.notes)


def test_a_plot_without_stems_says_that_it_cannot_judge(plot: Plot) -> None:
    scene, sparse = plot({})
    # Neither the surface nor the points of so high up show any.
    settings = SurveySettings(surface=StemSettings(heights_m=(5.0, 6.0)), sparse=SparseStemSettings(min_points=10**6))
    found = survey((scene, sparse), settings=settings)
    no_depth = survey_scene(scene, sparse, None, m_per_unit=UNIT)
    for none in (found, no_depth):
        result = judge_survey(none, [view.name for view in scene.views], NO_SCALE, NO_SCALE)
        assert (result.stems, result.lines) == ((), ())
        assert any(note.startswith("No stem was found") for note in result.notes)


@pytest.mark.parametrize("hidden", [{1: 40.0}, {0: 200.0, 3: 310.0}])
def test_the_stems_behind_curtains_are_named_and_no_others(hidden: Hidden, plot: Plot) -> None:
    result = check(plot(hidden), METRIC)
    verdicts = verdicts_of(result)
    assert {number for number, verdict in verdicts.items() if verdict == "one side"} == set(hidden)
    assert {verdicts[number] for number in set(range(5)) - set(hidden)} == {"good"}
    assert len(result.lines) == len(hidden)
    for line in result.lines:
        assert line.startswith("Walk round tree ")
    # The photo that is named as the place stands where the curtain was.
    for entry in (entry for entry in result.stems if entry.verdict == "one side"):
        number = number_of(result, entry.stem.center)
        line = next(line for line in result.lines if f"tree {entry.number} " in line)
        angle = 2 * np.pi * int(line.split("photo p")[-1][:2]) / PHOTOS
        seen_from = np.degrees(np.arctan2(5 * np.sin(angle) - STEMS[number][1], 5 * np.cos(angle) - STEMS[number][0]))
        assert abs((seen_from - hidden[number] + 180) % 360 - 180) < 35


def test_who_sees_a_stem_is_known_photo_by_photo(plot: Plot) -> None:
    found = survey(plot({3: 310.0}), METRIC)
    result = judge_survey(found, found.names, METRIC, NO_SCALE)
    entry = next(entry for entry in result.stems if number_of(result, entry.stem.center) == 3)
    cameras = 5 * np.column_stack([np.cos(walk_angles()), np.sin(walk_angles())])
    bearing = np.degrees(np.arctan2(*(cameras - STEMS[3][:2]).T[::-1]))
    open_ = np.abs((bearing - 310.0 + 180) % 360 - 180) >= 90
    # Thin stems hide a part of it here and there, and the last degree of the curtain is a matter of pixels.
    assert (np.isin(np.arange(PHOTOS), entry.views) != open_).sum() <= 2


def test_a_photo_an_arms_length_away_sees_the_stem(plot: Plot) -> None:
    scene, sparse = plot({1: 40.0})
    assert len(check((scene, sparse), METRIC).lines) == 1
    # The same maps, but searched from beyond the stem on: it is nearer than any depth could be.
    far = [replace(view, camera=replace(view.camera, depth_min=30.0)) for view in scene.views]
    assert check((replace(scene, views=tuple(far)), sparse), METRIC).lines == ()


def test_one_photo_alone_does_not_see(plot: Plot) -> None:
    scene, sparse = plot({1: 40.0})
    # All photos an arm's length away, but none within half a metre of another.
    far = [replace(view, camera=replace(view.camera, depth_min=30.0)) for view in scene.views]
    settings = SurveySettings(sightings=SightingSettings(together_m=0.5))
    alone = survey((replace(scene, views=tuple(far)), sparse), METRIC, settings)
    assert len(alone.stems) >= len(STEMS)
    assert not alone.seen.any()


def test_trees_beyond_the_open_side_of_a_walk_that_stopped_early_are_named(plot: Plot) -> None:
    scene, sparse = plot({})
    # From 0 to 195 degrees: what lies below the chord back to the start was meant to be passed, too.
    kept = 27
    views = tuple(
        replace(view, sources=tuple(source for source in view.sources if source < kept)) for view in scene.views[:kept]
    )
    observations = {view.name: sparse.observations[view.name] for view in views}
    tracks = np.bincount(np.concatenate([*observations.values()]), minlength=len(sparse.points))
    sparse = replace(sparse, observations=observations, track_lengths=tracks)
    result = check((replace(scene, views=views), sparse))
    # The others stand inside, or within the margin; the last is too far out to have been meant.
    numbers = {
        number_of(result, entry.stem.center, 0.2): entry.number for entry in result.stems if entry.verdict == "beyond"
    }
    assert set(numbers) == {2}
    assert result.lines[0].startswith("Between the places of photos p00 and p26 no photo was placed for 10 m.")
    assert f"if tree {numbers[2]} beyond it, seen from one side only, belongs to your plot" in result.lines[0]


def beside(cameras: NDArray[np.float64], places: Sequence[tuple[float, float]]) -> CheckResult:
    """The check of a walk whose photos see every stem that is within 8 m of them."""
    stems = [VisibleStem(center=np.array(place), radius=0.15, lean=np.zeros(2)) for place in places]
    seen = np.array([np.linalg.norm(cameras - stem.center, axis=1) < 8 for stem in stems])
    names = tuple(f"p{number:02d}" for number in range(len(cameras)))
    found = Survey(names=names, cameras=cameras, plot_from_scene=np.eye(4), stems=tuple(stems), seen=seen)
    return judge_survey(found, names, METRIC, NO_SCALE)


@pytest.mark.parametrize("aside_m", [0.0, 0.15])
def test_stems_beside_a_straight_walk_are_named_however_straight_it_is(aside_m: float) -> None:
    along = np.arange(0, 30, 0.5)
    walk = np.column_stack([along, np.random.default_rng(0).normal(0, aside_m, len(along))])
    turn = np.radians(25)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    places = np.array([(10.0, 3.0), (14.0, -3.0), (18.0, 4.0), (18.0, -20.0)])
    result = beside(walk @ rotation, [(x, y) for x, y in places @ rotation])
    assert [entry.verdict for entry in result.stems] == ["one side"] * 3 + ["outside"]
    assert len(result.lines) == 3


def test_a_walk_that_went_round_no_stem_is_told_so() -> None:
    along = np.arange(0, 30, 0.5)
    there, back = np.column_stack([along, 0 * along]), np.column_stack([along[::-1], 0 * along + 3])
    result = beside(np.concatenate([there, back]), [(10.0, 7.0), (20.0, -4.0)])
    assert [entry.verdict for entry in result.stems] == ["outside"] * 2
    (line,) = result.lines
    assert line.startswith("No stem stands within your walk, and 2 stems beside it were seen from one side only.")


def test_the_map_shows_the_missing_side(tmp_path: Path, plot: Plot) -> None:
    colours = {}
    for name, hidden in (("all", {}), ("one", {1: 40.0})):
        draw_map(check(plot(hidden)), tmp_path / f"{name}.png")
        picture = read_image(tmp_path / f"{name}.png").astype(int)
        colours[name] = int((np.abs(picture - [0xD5, 0x5E, 0x00]).sum(axis=2) < 30).sum())
    # The legend has a spot of this colour in both.
    assert colours["one"] > colours["all"] + 1000


def test_the_map_takes_photos_of_any_name(tmp_path: Path, plot: Plot) -> None:
    result = check(plot({}))
    draw_map(replace(result, names=("$a^$", *result.names[1:])), tmp_path / "map.png")
    assert (tmp_path / "map.png").is_file()


def test_a_board_at_two_places_tells_of_photos_placed_wrongly(plot: Plot) -> None:
    found = survey(plot({}), METRIC)
    given = found.names

    def entry(number: int, x_m: float, views: list[str]) -> MarkerScale:
        return board(number, (x_m / UNIT, 0.0, 1.0), views)

    first, again = entry(40, 3.0, ["p01", "p02", "p03", "p04"]), entry(40, -1.5, ["p31", "p30", "p32"])
    for markers, told in (([first, entry(41, 0.0, ["p05", "p06", "p07"])], 0), ([again, first], 1)):
        boards = scale_of_boards(markers, m_per_unit=UNIT)
        lines = judge_survey(found, given, boards, boards).lines
        assert len(lines) == told
        if told:
            assert lines[0].startswith("Board 40 was found at two places 4.5 m apart.")
            assert "perhaps p30 to p32" in lines[0]


def test_boards_of_which_none_can_be_used_are_told(plot: Plot, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = RejectedMarker(id=7, reason="2 views: fewer than 3 agree on one place")

    def none(*_: object, **__: object) -> Scale:
        raise NoUsableMarkersError("no ArUco marker can be used", [seen])

    monkeypatch.setattr("fsinfer.scale.find.scale_from_aruco", none)
    monkeypatch.setattr("fsinfer.check.run.scale_from_aruco", none)
    for request in (ScaleRequest(), ScaleRequest(aruco_length_m=0.25)):
        scale, boards, rejected, _ = boards_seen(request, plot({})[0], silent)
        found = survey(plot({}))
        notes = judge_survey(found, found.names, scale, boards, rejected=rejected).notes
        assert any(note.startswith("Board 7 cannot be used (2 views: fewer than 3 agree") for note in notes)
        assert any(note.startswith("No board can be used") for note in notes)


def test_the_post_of_a_board_is_no_stem(plot: Plot) -> None:
    found = survey(plot({1: 40.0}), METRIC)
    given = found.names
    x, y, _ = STEMS[1]
    boards = scale_of_boards([board(40, (x / UNIT, y / UNIT, 1.0), ["p01", "p02"])], m_per_unit=UNIT)
    assert judge_survey(found, given, boards, boards).lines == ()


def test_sparse_points_show_stems_and_no_bush(plot: Plot) -> None:
    sparse = plot({})[1]
    points = sparse.points * UNIT
    stems = find_sparse_stems(points, points[:, 2], np.ones(len(points), bool))
    assert len(stems) == len(STEMS)
    for stem in stems:
        apart = [np.hypot(stem.center[0] - x, stem.center[1] - y) for x, y, _ in STEMS]
        assert min(apart) < 0.02
        assert stem.radius == pytest.approx(STEMS[int(np.argmin(apart))][2], abs=0.02)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often photos were placed; depth is never computed."""
    calls: Counter[str] = Counter()

    def place(*args: Any, **kwargs: Any) -> PosesResult:
        calls["poses"] += 1
        return estimate_poses(*args, **kwargs)

    def no_depth(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(photo_stages, "estimate_poses_apart", place)
    monkeypatch.setattr("fsinfer.workflow.cloud_stages.estimate_depth", no_depth)
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
        pipeline.run(folder, out, settings=RunSettings(poses=poses))
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


@pytest.mark.parametrize("lost", ["scene", "scene/cams/r3_cam.txt"])
def test_what_was_deleted_of_a_runs_scene_is_made_again(tmp_path: Path, calls: Counter[str], lost: str) -> None:
    """Its pictures take room; a check of the same photographs ended without a way out."""
    folder, out = tmp_path / "photos", tmp_path / "out"
    for index, image in enumerate(photographs()):
        write_image(folder / f"r{index}.jpg", image)
    poses = PoseSettings(max_features=1500)
    with pytest.raises(KeyboardInterrupt):
        pipeline.run(folder, out, settings=RunSettings(poses=poses))
    path = out / lost
    path.unlink() if path.is_file() else shutil.rmtree(path)
    again = check_capture(folder, out, settings=CheckSettings(poses=poses))
    assert (again.registered, calls["poses"]) == (8, 2)


def test_photos_whose_numbers_are_of_unequal_length_are_not_missing(
    tmp_path: Path, calls: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Windows renames many files so; their frames are called "photo (05)" and so on.
    folder = tmp_path / "photos"
    for number, image in enumerate(photographs(), start=5):
        write_image(folder / f"photo ({number}).jpg", image)
    asked: list[Path] = []

    def places(files: Sequence[Path]) -> dict[int, tuple[float, float]]:
        asked.extend(files)
        return gnss_places(files)

    monkeypatch.setattr("fsinfer.check.run.gnss_places", places)
    settings = CheckSettings(poses=PoseSettings(max_features=1500))
    result = check_capture(folder, tmp_path / "out", settings=settings)
    assert result.notes[0] == "8 of 8 photos placed."
    assert not any("did not join" in line for line in result.lines)
    # The place on the earth stands in the photos themselves.
    assert asked == [folder / f"photo ({number}).jpg" for number in range(5, 13)]


def test_how_the_photos_were_taken_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, out = tmp_path / "photos", tmp_path / "out"
    # From one end of the arc to the other, and back in small steps.
    order = [0, 4, 3, 2, 1]
    images = photographs(5)
    for number, view in enumerate(order):
        write_image(folder / f"r{number}.jpg", images[view])
    placed: Counter[str] = Counter()

    def mapped(walk: Walk, *_: Any) -> MappedWalk:
        return MappedWalk(model=room_model(walk.files, [poses(5)[view] for view in order]), misplaced={})

    def place(*args: Any, **kwargs: Any) -> PosesResult:
        placed["poses"] += 1
        found = notice(CaptureCode.rolling_shutter, median_px=3.2)
        return replace(estimate_poses(*args, **kwargs), warnings=(found,))

    monkeypatch.setattr("fsinfer.poses.estimate.map_walk", mapped)
    monkeypatch.setattr(photo_stages, "estimate_poses_apart", place)
    # No stem is looked for here.
    monkeypatch.setattr("fsinfer.check.run._coarse_depth", lambda *_: None)
    result = check_capture(folder, out)
    (shutter,) = (note for note in result.notes if "moved by 3.2 pixels" in note)
    assert "stand still for each photo" in shutter
    (turn,) = (note for note in result.notes if note.startswith("You turned fast"))
    assert "between r0 and r1 (" in turn
    assert turn.count("degrees)") == 1
    record = json.loads((out / "check" / "check.json").read_text(encoding="utf-8"))
    assert record["notes"] == list(result.notes)
    # It is known as well where the photos were placed before.
    assert check_capture(folder, out).notes == result.notes
    assert placed["poses"] == 1


def test_a_counter_that_began_anew_is_no_fast_turn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    # From one end of the arc to the other; by name the last photo stands before the first.
    names = ["IMG_9998", "IMG_9999", "IMG_0001", "IMG_0002", "IMG_0003"]
    for second, (name, image) in enumerate(zip(names, photographs(5), strict=True)):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0x9003] = f"2026:05:04 10:00:{second:02d}"
        Image.fromarray(image).save(folder / f"{name}.jpg", quality=95, exif=exif)
    walks: list[tuple[str, ...]] = []

    def mapped(walk: Walk, *_: Any) -> MappedWalk:
        walks.append(walk.files)
        return MappedWalk(model=room_model(walk.files, poses(5)), misplaced={})

    monkeypatch.setattr("fsinfer.poses.estimate.map_walk", mapped)
    monkeypatch.setattr(photo_stages, "estimate_poses_apart", estimate_poses)
    monkeypatch.setattr("fsinfer.check.run._coarse_depth", lambda *_: None)
    # Frames of photos that are too large are coded again.
    result = check_capture(folder, tmp_path / "out", settings=CheckSettings(frames=FrameSettings(longest_px=400)))
    assert len(walks) == 1
    placed = {view.name: view.camera.center for view in read_scene(tmp_path / "out" / "scene").views}
    steps = [np.linalg.norm(placed[one] - placed[other]) for one, other in pairwise(names)]
    assert max(steps) < 1.5 * min(steps)
    assert not any(note.startswith("You turned fast") for note in result.notes)


def test_the_ends_that_were_clicked_give_the_scale_of_a_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, out = tmp_path / "photos", tmp_path / "out"
    for number, image in enumerate(photographs(5)):
        write_image(folder / f"r{number}.jpg", image)

    def mapped(walk: Walk, *_: Any) -> MappedWalk:
        return MappedWalk(model=room_model(walk.files, poses(5)), misplaced={})

    monkeypatch.setattr("fsinfer.poses.estimate.map_walk", mapped)
    monkeypatch.setattr(photo_stages, "estimate_poses_apart", estimate_poses)
    monkeypatch.setattr("fsinfer.check.run._coarse_depth", lambda *_: None)
    before = check_capture(folder, out)
    assert not before.metric
    assert any(note.startswith("No scale") for note in before.notes)
    scene = read_scene(out / "scene")
    ends = np.array([[-0.3, 0.0, 0.0], [0.3, 0.1, 0.1]])
    clicks = {view.name: project(ends, view.camera)[0].tolist() for view in scene.views}
    write_clicks(out, SavedClicks(used=clicked_length(clicks, 1.0, picture_sizes(scene))))
    clicked = check_capture(folder, out)
    assert clicked.metric
    assert not any("No scale" in note or "no diameter is measured" in note for note in clicked.notes)
    # Clicks that fit no more are told, as a run does.
    clicks["r0"] = clicks["r0"][::-1]
    write_clicks(out, SavedClicks(used=clicked_length(clicks, 1.0, picture_sizes(scene))))
    lost = check_capture(folder, out)
    assert not lost.metric
    assert any("clicked with fsinfer scale give no scale any more" in note for note in lost.notes)


def test_a_check_that_was_stopped_goes_on(tmp_path: Path, calls: Counter[str], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, out = tmp_path / "photos", tmp_path / "out"
    for index, image in enumerate(photographs()):
        write_image(folder / f"r{index}.jpg", image)
    settings = CheckSettings(poses=PoseSettings(max_features=1500))

    def stop(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("fsinfer.poses.mapping.map_sure", stop)
        with pytest.raises(KeyboardInterrupt):
            check_capture(folder, out, settings=settings)
    database = out / "scene" / "work" / "database.db"
    inode, size = database.stat().st_ino, database.stat().st_size
    seen: list[tuple[int, int]] = []

    def look(sure: SurePairs, *args: Any, **options: Any) -> Any:
        seen.append((sure.database.stat().st_ino, sure.database.stat().st_size))
        return map_sure(sure, *args, **options)

    monkeypatch.setattr("fsinfer.poses.mapping.map_sure", look)
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

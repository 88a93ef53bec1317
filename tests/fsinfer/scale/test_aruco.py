"""Scale from rendered ArUco markers, with everything that can be wrong with them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.check.run import _scale as boards_seen
from fsinfer.errors import ScaleError
from fsinfer.io.images import write_image
from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.sentences import sentences
from fsinfer.progress import silent
from fsinfer.scale import marker_search
from fsinfer.scale.aruco import scale_from_aruco
from fsinfer.scale.detection import detect_markers, make_detector
from fsinfer.scale.find import find_scale
from fsinfer.scale.marker_search import SeenMarkers, look_for_markers
from fsinfer.scale.markers_seen import MarkersSeen, write_markers_seen
from fsinfer.scale.request import ScaleRequest
from fsinfer.scale.scale import UNKNOWN, BoardVerdict, NoUsableMarkersError
from fsinfer.scale.square_fit import MarkerSettings, Sighting, find_markers
from fsinfer.scene import Camera, Scene, View, read_view_image
from tests.support.rendered_room import SIZE, WALL, draw, intrinsic, poses, texture

SIDE = 0.30  # scene units
# Lower left of the wall, upper right, and a tilted one in front: origin (top left corner), right and down directions.
PLACES = [
    (np.array([-0.75, 0.15, 0.25]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0])),
    (np.array([0.35, -0.45, 0.20]), np.array([0.96, 0.28, 0]), np.array([-0.28, 0.96, 0])),
    (np.array([-0.2, -0.25, 0.0]), np.array([0.9, 0, -np.sqrt(0.19)]), np.array([0, 1.0, 0])),
]
NUMBERS = (7, 23, 41)


def printed(number: int) -> NDArray[np.uint8]:
    """A marker of 240 pixels in a white rim of 40."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    marker = np.full((320, 320), 255, np.uint8)
    marker[40:280, 40:280] = cv2.aruco.generateImageMarker(dictionary, number, 240)
    return np.repeat(marker[:, :, None], 3, axis=2)


def paste(image: NDArray[np.uint8], pose: NDArray[np.float64], place: int, number: int) -> NDArray[np.uint8]:
    origin, right, down = PLACES[place]
    rim = SIDE / 6
    plane = (origin - rim * (right + down), right * (SIDE + 2 * rim), down * (SIDE + 2 * rim))
    return draw(image, pose, plane, printed(number))


def make_scene(folder: Path, markers: dict[int, int], views: int = 5) -> Scene:
    """``markers`` is {place: number}; cameras are exact."""
    found = []
    for index, pose in enumerate(poses(views)):
        image = draw(np.full((SIZE[1], SIZE[0], 3), 90, np.uint8), pose, WALL, texture(0))
        for place, number in markers.items():
            image = paste(image, pose, place, number)
        path = folder / f"v{index}.png"
        write_image(path, image)
        camera = Camera(intrinsic=intrinsic(), cam_from_world=pose, depth_min=1.0, depth_max=9.0)
        found.append(View(name=path.stem, image_path=path, camera=camera, sources=()))
    return Scene(folder=folder, views=tuple(found))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return make_scene(tmp_path_factory.mktemp("markers"), dict(enumerate(NUMBERS)))


def true_corners(place: int, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    origin, right, down = PLACES[place]
    world = origin + SIDE * np.array([0 * right, right, right + down, down])
    projected = (world @ pose[:3, :3].T + pose[:3, 3]) @ intrinsic().T
    return projected[:, :2] / projected[:, 2:]


def test_detected_corners_are_exact_and_unbiased(scene: Scene) -> None:
    from fsinfer.io.images import read_image

    errors, growth = [], []
    for view, pose in zip(scene.views, poses(5), strict=True):
        for number, corners in detect_markers(read_image(view.image_path), make_detector("4X4_50")):
            truth = true_corners(NUMBERS.index(number), pose)
            errors.append(corners - truth)
            outwards = truth - truth.mean(axis=0)
            growth.append(((corners - truth) * outwards).sum() / (outwards**2).sum())
    assert len(errors) >= 14
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.25
    assert np.abs(np.mean(np.concatenate(errors), axis=0)).max() < 0.08
    # Blur must not shrink or swell the black square: half a per cent of scale is 0.15 cm on a 30 cm stem.
    assert abs(np.mean(growth)) < 0.005


def test_scale_is_right_to_a_quarter_per_cent_and_inside_its_error(scene: Scene) -> None:
    scale = scale_from_aruco(scene, 0.25)
    truth = 0.25 / SIDE
    assert scale.source == "aruco"
    assert scale.m_per_unit is not None
    assert scale.rel_std is not None
    assert abs(scale.m_per_unit / truth - 1) < 0.0025
    assert 0.002 <= scale.rel_std < 0.01
    assert abs(scale.m_per_unit / truth - 1) < 2.5 * scale.rel_std
    markers = scale.markers
    assert sorted(marker.id for marker in markers) == list(NUMBERS)
    for marker in markers:
        assert len(marker.views) >= 3
        assert abs(marker.residual_rel) < 0.01
        assert marker.residual_mm == pytest.approx(250 * marker.residual_rel)
        assert marker.leave_one_out_m_per_unit == pytest.approx(truth, rel=0.005)
        place = PLACES[NUMBERS.index(marker.id)]
        assert np.allclose(marker.center, place[0] + SIDE / 2 * (place[1] + place[2]), atol=0.01)
        assert marker.normal is not None
        towards = scene.views[2].camera.center - np.array(marker.center)
        assert np.array(marker.normal) @ towards > 0.5 * np.linalg.norm(towards)


def test_one_number_in_three_places_is_three_markers(tmp_path: Path) -> None:
    scale = scale_from_aruco(make_scene(tmp_path, {0: 5, 1: 5, 2: 5}), 0.25)
    assert len(scale.markers) == 3
    assert scale.m_per_unit == pytest.approx(0.25 / SIDE, rel=0.005)


def test_a_board_of_another_length_is_outvoted(scene: Scene) -> None:
    lengths = dict.fromkeys(NUMBERS, 0.25) | {NUMBERS[1]: 0.20}
    scale = scale_from_aruco(scene, lengths)
    assert scale.m_per_unit == pytest.approx(0.25 / SIDE, rel=0.0025)
    assert scale.rel_std is not None
    assert scale.rel_std < 0.01
    verdicts = {marker.id: marker.verdict for marker in scale.markers}
    assert verdicts == dict.fromkeys(NUMBERS, BoardVerdict.agrees) | {NUMBERS[1]: BoardVerdict.outvoted}
    wrong = next(marker for marker in scale.markers if marker.id == NUMBERS[1])
    assert wrong.residual_rel == pytest.approx(0.25, abs=0.01)
    # Without one of the others two are left, which cannot tell.
    assert wrong.leave_one_out_rel == pytest.approx(0.0, abs=1e-3)


def test_two_views_are_not_enough(tmp_path: Path) -> None:
    scene = make_scene(tmp_path, {0: 7}, views=2)
    with pytest.raises(NoUsableMarkersError, match="3 photos from different places") as raised:
        scale_from_aruco(scene, 0.25)
    assert [(marker.id, marker.reason[:7]) for marker in raised.value.rejected] == [(7, "2 views")]


def test_no_marker_says_where_it_looked_and_the_way_out(tmp_path: Path) -> None:
    scene = make_scene(tmp_path, {}, views=3)
    with pytest.raises(ScaleError, match=r"v0 to v2.*--endpoints"):
        scale_from_aruco(scene, 0.25)


def test_photographs_are_searched_once_whatever_the_boards_tell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[str] = []

    def counted(view: View) -> NDArray[np.uint8]:
        read.append(view.name)
        return read_view_image(view)

    monkeypatch.setattr(marker_search, "read_view_image", counted)
    # Numbers below 20 tell no length.
    scene = make_scene(tmp_path, {0: 5, 1: 6, 2: 7})
    once = [view.name for view in scene.views]
    (told,) = find_scale(ScaleRequest(), scene=scene).warnings
    assert told.code == CaptureCode.markers_of_unknown_length
    assert sorted(read) == once
    read.clear()
    scale, boards, *_ = boards_seen(ScaleRequest(), scene, silent)
    assert scale is UNKNOWN
    assert sorted(marker.id for marker in boards.markers) == [5, 6, 7]
    assert sorted(read) == once
    read.clear()
    # What was seen of another dictionary does not count.
    seen = look_for_markers(scene, dictionary="5X5_50")
    assert scale_from_aruco(scene, 0.25, seen=seen).m_per_unit == pytest.approx(0.25 / SIDE, rel=0.0025)
    assert sorted(read) == sorted([*once, *once])


def test_wrong_options(scene: Scene) -> None:
    with pytest.raises(ScaleError, match=r"9X9_99.*4X4_50"):
        scale_from_aruco(scene, 0.25, dictionary="9X9_99")
    for length in (0.0, -1.0, float("nan")):
        with pytest.raises(ScaleError, match="above 0"):
            scale_from_aruco(scene, length)


def sightings(place: int, views: int, rng: np.random.Generator, noise_px: float = 0.1) -> list[Sighting]:
    return [
        Sighting(marker_id=1, view=view, corners_px=true_corners(place, pose) + rng.normal(0, noise_px, (4, 2)))
        for view, pose in enumerate(poses(views))
    ]


def projections(views: int) -> tuple[list[NDArray[np.float64]], NDArray[np.float64]]:
    return [intrinsic() @ pose[:3] for pose in poses(views)], np.array(
        [-pose[:3, :3].T @ pose[:3, 3] for pose in poses(views)]
    )


def test_side_and_its_error_from_noisy_corners() -> None:
    rng = np.random.default_rng(0)
    ratios, claimed = [], []
    for _ in range(40):
        found, reasons = find_markers(sightings(2, 6, rng), *projections(6), MarkerSettings())
        assert len(found) == 1
        assert not reasons
        ratios.append(found[0].side_units / SIDE)
        claimed.append(found[0].side_rel_std)
    assert abs(np.mean(ratios) - 1) < 0.002
    assert 0.7 < np.std(ratios) / np.mean(claimed) < 1.4


@pytest.mark.parametrize("units_per_m", [0.05, 20.0])
def test_a_model_of_any_size_has_the_same_markers(units_per_m: float) -> None:
    """In a model whose walk is a unit long boards are hundredths of it from the cameras."""
    seen = sightings(2, 6, np.random.default_rng(3))
    (usual,), _ = find_markers(seen, *projections(6), MarkerSettings())
    sized = np.diag([1.0, 1.0, 1.0, units_per_m])
    others = [projection @ sized for projection in projections(6)[0]]
    (found,), reasons = find_markers(seen, others, projections(6)[1] * units_per_m, MarkerSettings())
    assert not reasons
    assert found.side_units == pytest.approx(usual.side_units * units_per_m, rel=1e-6)
    assert found.side_rel_std == pytest.approx(usual.side_rel_std, rel=1e-3)


def test_wrong_detections_do_not_move_a_marker() -> None:
    rng = np.random.default_rng(1)
    good = sightings(0, 6, rng)
    # The same number read into leaves, and one detection turned by a quarter.
    bad = [
        Sighting(
            marker_id=1,
            view=view,
            corners_px=np.array([[0, 0], [20, 0], [20, 20], [0, 20.0]]) + rng.uniform(50, 300, 2),
        )
        for view in (0, 2, 4)
    ]
    turned = Sighting(marker_id=1, view=5, corners_px=np.roll(good.pop(5).corners_px, 1, axis=0))
    found, reasons = find_markers([*bad, *good, turned], *projections(6), MarkerSettings())
    assert len(found) == 1
    assert found[0].side_units == pytest.approx(SIDE, rel=0.01)
    assert sorted(sighting.view for sighting in found[0].sightings) == [0, 1, 2, 3, 4]
    assert reasons


def test_a_detection_with_but_one_right_corner_is_not_the_markers() -> None:
    rng = np.random.default_rng(4)
    good = sightings(0, 6, rng)
    bent = good.pop(3)
    corners = bent.corners_px + np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 9.0], [0.0, 9.0]])
    found, _ = find_markers(
        [*good, Sighting(marker_id=1, view=bent.view, corners_px=corners)], *projections(6), MarkerSettings()
    )
    assert [sorted(sighting.view for sighting in marker.sightings) for marker in found] == [[0, 1, 2, 4, 5]]


def test_a_wrong_print_that_a_drift_shows_twice_does_not_outvote_the_others(scene: Scene) -> None:
    """Of a walk that comes back a little beside where it was a board seen on both ways has two places."""
    rng = np.random.default_rng(5)
    views: list[View] = []
    seen = []
    for way, drift in enumerate((0.0, 0.1, -0.1)):
        for pose in poses(5):
            drifted = pose.copy()
            drifted[:3, 3] -= pose[:3, 0] * drift
            camera = Camera(intrinsic=intrinsic(), cam_from_world=drifted, depth_min=1.0, depth_max=9.0)
            for place, number in enumerate((20, 21, 22)):
                if way == 0 or number == 22:
                    corners = true_corners(place, pose) + rng.normal(0, 0.1, (4, 2))
                    seen.append(Sighting(marker_id=number, view=len(views), corners_px=corners))
            views.append(View(name=f"v{len(views)}", image_path=scene.folder / "v0.png", camera=camera, sources=()))
    found = scale_from_aruco(
        Scene(folder=scene.folder, views=tuple(views)),
        {20: SIDE, 21: SIDE, 22: 1.06 * SIDE},
        seen=SeenMarkers(dictionary="4X4_50", sightings=tuple(seen)),
    )
    assert [marker.id for marker in found.markers] == [20, 21, 22, 22, 22]
    assert [marker.verdict for marker in found.markers] == [BoardVerdict.agrees] * 2 + [BoardVerdict.outvoted] * 3
    assert found.m_per_unit == pytest.approx(1.0, rel=0.01)


def test_mirrored_and_oblong_detections_are_rejected() -> None:
    rng = np.random.default_rng(2)
    mirrored = [Sighting(marker_id=1, view=s.view, corners_px=s.corners_px[::-1]) for s in sightings(0, 6, rng)]
    found, reasons = find_markers(mirrored, *projections(6), MarkerSettings())
    assert not found
    assert reasons
    origin, right, down = PLACES[0]
    world = origin + SIDE * np.array([0 * right, 1.3 * right, 1.3 * right + down, down])
    oblong = []
    for view, pose in enumerate(poses(6)):
        projected = (world @ pose[:3, :3].T + pose[:3, 3]) @ intrinsic().T
        oblong.append(Sighting(marker_id=1, view=view, corners_px=projected[:, :2] / projected[:, 2:]))
    found, reasons = find_markers(oblong, *projections(6), MarkerSettings())
    assert not found
    assert "sides differ" in reasons[0]


def test_views_from_one_place_are_rejected() -> None:
    rng = np.random.default_rng(3)
    pose = poses(6)[2]
    near = [pose.copy() for _ in range(4)]
    for step, moved in enumerate(near):
        moved[0, 3] += 0.01 * step
    matrices = [intrinsic() @ moved[:3] for moved in near]
    centers = np.array([-moved[:3, :3].T @ moved[:3, 3] for moved in near])
    seen = [
        Sighting(marker_id=1, view=view, corners_px=true_corners(0, moved) + rng.normal(0, 0.02, (4, 2)))
        for view, moved in enumerate(near)
    ]
    found, reasons = find_markers(seen, matrices, centers, MarkerSettings())
    assert not found
    assert reasons


def test_printed_boards_need_no_option(tmp_path: Path) -> None:
    """Numbers 23 and 41 tell 0.15 and 0.25 m; 7 tells nothing and is left alone."""
    from fsinfer.scale.find import find_scale
    from fsinfer.scale.request import ScaleRequest

    only = make_scene(tmp_path / "one", {1: 23})
    found = find_scale(ScaleRequest(), scene=only)
    scale, warnings = found.scale, sentences(found.warnings)
    assert scale.m_per_unit == pytest.approx(0.15 / SIDE, rel=0.004)
    assert [entry.id for entry in scale.markers] == [23]
    assert "one board (number 23, 0.15 m" in warnings[0]
    anybodys = make_scene(tmp_path / "other", {0: 7})
    found = find_scale(ScaleRequest(), scene=anybodys)
    scale, warnings = found.scale, sentences(found.warnings)
    assert (scale.m_per_unit, scale.source) == (None, "none")
    # A marker of the user's own, whose length was forgotten.
    assert "markers are seen (number 7)" in warnings[0]
    assert "--aruco-length-m" in warnings[0]
    found = find_scale(ScaleRequest(), scene=make_scene(tmp_path / "none", {}))
    assert found.scale == UNKNOWN
    assert [item.code for item in found.warnings] == [CaptureCode.no_scale_given]


@pytest.mark.parametrize(("views", "number", "told"), [(2, 23, True), (1, 23, False), (2, 7, False)])
def test_printed_boards_that_do_not_do_are_told(tmp_path: Path, views: int, number: int, *, told: bool) -> None:
    """Who had put boards up was told to put boards up. In a single photo it may be none; others may be anything."""
    from fsinfer.scale.find import find_scale
    from fsinfer.scale.request import ScaleRequest

    found = find_scale(ScaleRequest(), scene=make_scene(tmp_path, {0: number}, views=views))
    (warning,) = found.warnings
    assert found.scale == UNKNOWN
    assert (warning.code == CaptureCode.no_scale_from_markers) == told
    assert (f"marker {number}: " in sentences(found.warnings)[0]) == told


def test_boards_check_a_scale_from_elsewhere_where_it_is_known_where_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbers 23 and 24 tell 0.15 m, so that a unit is half a metre; 7 tells nothing and is a board all the same."""
    scene = make_scene(tmp_path, {0: 7, 1: 23, 2: 24})
    with monkeypatch.context() as patched:
        patched.setattr(marker_search, "read_view_image", lambda _: pytest.fail("photos are searched for nothing"))
        unsearched = find_scale(ScaleRequest(factor=0.6), scene=scene)
    assert (unsearched.warnings, unsearched.boards.markers) == ((), ())
    detector = make_detector("4X4_50")
    places = {view.name: tuple(detect_markers(read_view_image(view), detector)) for view in scene.views}
    write_markers_seen(tmp_path, MarkersSeen(dictionary="4X4_50", min_side_px=8.0, places=places))
    for factor in (0.5, 0.504):
        found = find_scale(ScaleRequest(factor=factor), scene=scene)
        assert (found.scale.m_per_unit, found.scale.source, found.warnings) == (factor, "factor", ())
        assert [entry.id for entry in found.boards.markers] == [7, 23, 24]
    (told,) = find_scale(ScaleRequest(factor=0.52), scene=scene).warnings
    assert told.code == CaptureCode.boards_contradict_scale
    assert told.values["numbers"] == ("23", "24")
    assert told.values["apart_rel"] == pytest.approx(0.04, abs=0.005)
    assert "everything 4." in sentences([told])[0] or "everything 3." in sentences([told])[0]
    assert "too large, every DBH too" in sentences([told])[0]
    # A length of 0.3 m that was read off as 0.15 m.
    ends = ((0.0, 0.0, 0.0), (0.3, 0.0, 0.0))
    assert not find_scale(ScaleRequest(endpoints=ends, length_m=0.15), scene=scene).warnings
    (small,) = find_scale(ScaleRequest(endpoints=ends, length_m=0.11), scene=scene).warnings
    assert "too small" in sentences([small])[0]
    # Boards of another dictionary tell no length.
    other = find_scale(ScaleRequest(factor=0.52, aruco_dictionary="5X5_50"), scene=scene)
    assert (other.warnings, other.boards.markers) == ((), ())


def test_boards_of_different_lengths_give_one_scale(tmp_path: Path) -> None:
    scene = make_scene(tmp_path, {0: 7, 1: 23, 2: 41})
    # All three are 0.30 units wide here: told different lengths they must contradict each other, told one, agree.
    agreed = scale_from_aruco(scene, {7: 0.3, 23: 0.3, 41: 0.3})
    assert max(abs(entry.residual_mm) for entry in agreed.markers) < 1.5
    told = scale_from_aruco(scene, {7: 0.3, 23: 0.3, 41: 0.15})
    assert told.m_per_unit == pytest.approx(1.0, rel=0.01)
    wrong = {entry.id: entry.residual_mm for entry in told.markers}
    assert wrong[41] == pytest.approx(150, abs=3)
    assert told.rel_std is not None
    assert agreed.rel_std is not None
    # Two of three decide, and know it less well than three.
    assert agreed.rel_std < told.rel_std < 2 * agreed.rel_std
    # Where each says something else nobody decides.
    torn = scale_from_aruco(scene, {7: 0.3, 23: 0.2, 41: 0.15})
    assert {entry.verdict for entry in torn.markers} == {BoardVerdict.contradicted}
    assert torn.rel_std is not None
    assert torn.rel_std > 0.1

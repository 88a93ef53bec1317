"""Stems outside of the walk: listed apart, not counted, not measured unless that is asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.notices.notice import notice
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.silhouettes.walk import WalkSettings, apart_from_walk, outside_walk
from fsinfer.trees import PlotResult, Section, Tree
from fsinfer.trees.diameter.section import unmeasured_section
from fsinfer.trees.stand import seen_cells
from fsinfer.trees.stem_measurement import tree_of

ANGLE = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
RING = 12.0 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])  # its middle is 12 m from every camera
LINE = np.column_stack([np.linspace(0.0, 20.0, 21), np.zeros(21)])


def test_what_the_cameras_surround_or_came_near_to_is_inside() -> None:
    places = np.array([[0.0, 0.0], [0.0, 18.0], [0.0, 21.0]])
    far, nearest = outside_walk(places, RING)
    assert far.tolist() == [False, False, True]
    assert nearest == pytest.approx([12.0, 6.0, 9.0])
    # A straight walk surrounds nothing; far along it is far too.
    far, _ = outside_walk(np.array([[10.0, 7.5], [10.0, 8.5], [31.0, 0.0]]), LINE)
    assert far.tolist() == [False, True, True]


def test_one_camera_near_by_is_no_walk_and_no_camera_says_nothing() -> None:
    strayed = np.vstack([LINE, [[10.0, 30.0]]])[[*range(0, 21, 20), 21]]  # three cameras, one of them by the stem
    assert outside_walk(np.array([[10.0, 33.0]]), strayed)[0].tolist() == [True]
    assert outside_walk(np.array([[10.0, 33.0]]), strayed[2:])[0].tolist() == [False]
    assert outside_walk(np.array([[10.0, 33.0]]), np.zeros((0, 2)))[0].tolist() == [False]


def entry(number: int, x_m: float) -> tuple[Tree, Section]:
    blank = unmeasured_section(np.array([x_m, 0.0]), 1.3, (), radius_m=0.15)
    section = replace(blank, dbh_m=0.3, sd_m=0.004, status="ok", reasons=())
    return replace(tree_of(section, 0.0, 14.0, np.zeros(3)), tree_id=number), section


def plot(*pairs: tuple[Tree, Section]) -> PlotResult:
    return PlotResult(
        trees=tuple(tree for tree, _ in pairs),
        sections=tuple(section for _, section in pairs),
        ground=None,
        diagnosis=notice(StemCode.trees_found, trees=len(pairs), measured=len(pairs)),
        warnings=(),
        extent_m=(-30.0, -30.0, 30.0, 30.0),
        spacing_m=0.01,
        plot_area_m2=400.0,
    )


FOUND = plot(entry(1, 25.0), entry(2, 0.0), entry(3, 30.0), entry(4, 5.0))


def test_far_stems_come_last_keep_their_number_and_have_no_diameter() -> None:
    result = apart_from_walk(FOUND, RING)
    assert [(tree.tree_id, tree.status) for tree in result.trees] == [
        (2, "ok"),
        (4, "ok"),
        (1, "outside"),
        (3, "outside"),
    ]
    far = result.trees[2]
    assert (far.dbh_cm, far.dbh_lo95_cm, far.dbh_hi95_cm, far.height_m, far.x_m) == (None, None, None, None, 25.0)
    (why,) = far.reasons
    assert why.code == StemCode.outside_walk
    assert why.values["nearest_m"] == pytest.approx(13.0)
    assert result.sections[2].dbh_m is None
    assert result.sections[2].circle_m[2] == pytest.approx(0.15)  # drawn as thick as it is
    assert result.warnings == (notice(StemCode.stems_outside_walk, stems=2, trees=("1", "3")),)
    # Those in the plot's border count there, which is told by another warning.
    assert "are listed apart and not counted on the seen ground: 1, 3; go nearer" in sentence(result.warnings[0])
    assert result.diagnosis == notice(StemCode.trees_found, trees=2, measured=2)
    assert result.stand.stems == 2
    assert result.stand.stems_per_ha == pytest.approx(50.0)


def test_a_warning_of_very_many_far_stems_can_be_read() -> None:
    """Of 1,500 beyond a hectare's border it had 8,000 letters."""
    result = apart_from_walk(plot(entry(1, 0.0), *(entry(k, 30.0) for k in range(2, 102))), RING)
    (told,) = result.warnings
    assert told.values["stems"] == 100
    assert "60, 61 and 40 more; go nearer" in sentence(told)


def test_far_stems_are_measured_where_that_is_asked_for_but_do_not_count() -> None:
    result = apart_from_walk(FOUND, RING, settings=WalkSettings(measure_far=True))
    assert [(tree.tree_id, tree.status, tree.outside) for tree in result.trees] == [
        (2, "ok", False),
        (4, "ok", False),
        (1, "ok", True),
        (3, "ok", True),
    ]
    assert result.trees[2].dbh_cm == pytest.approx(30.0)
    assert result.stand.stems == 2
    assert result.warnings == ()


def test_what_a_person_put_there_is_wanted_and_a_near_plot_stays_as_it_is() -> None:
    result = apart_from_walk(FOUND, RING, kept=frozenset({1}))
    assert [tree.tree_id for tree in result.trees] == [1, 2, 4, 3]
    near = plot(entry(1, 0.0))
    assert apart_from_walk(near, RING) is near


def test_ground_goes_with_the_stems_that_stand_on_it() -> None:
    # A stem every 6 m on a flat square of 72 m; the walk goes round 12 m about its middle.
    x = np.arange(-36.0, 36.0, 0.2) + 0.1
    ground = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    places = np.stack(np.meshgrid(np.arange(-33.0, 36.0, 6.0), np.arange(-33.0, 36.0, 6.0)), axis=-1).reshape(-1, 2)
    pairs = []
    for number, (x_m, y_m) in enumerate(places, start=1):
        tree, section = entry(number, x_m)
        pairs.append((replace(tree, y_m=float(y_m)), section))
    seen = seen_cells(ground)
    whole = replace(plot(*pairs), seen_ground=seen, plot_area_m2=seen.area(places))
    assert whole.plot_area_m2 == pytest.approx(72.0**2, rel=0.01)
    assert whole.stand.stems_per_ha == pytest.approx(1e4 / 36, rel=0.01)
    walked = apart_from_walk(whole, RING)
    assert walked.stand.stems < 70
    # The ring, and round it what is nearer than 8 m to three cameras.
    assert walked.plot_area_m2 == pytest.approx(np.pi * 18.3**2, rel=0.02)
    assert walked.stand.stems_per_ha == pytest.approx(1e4 / 36, rel=0.1)
    # Ground outside without a stem on it was not walked either.
    bare = replace(whole, trees=whole.trees[65:67], sections=whole.sections[65:67])
    assert apart_from_walk(bare, RING).plot_area_m2 == walked.plot_area_m2
    # Where nobody knows how much of the ground was seen, the walk does not tell.
    few = seen.only(np.asarray((seen.middles > 10.0).all(axis=1)))
    assert apart_from_walk(replace(whole, seen_ground=few, plot_area_m2=0.0), RING).plot_area_m2 == 0.0
    assert apart_from_walk(whole, np.zeros((0, 2))).plot_area_m2 == whole.plot_area_m2

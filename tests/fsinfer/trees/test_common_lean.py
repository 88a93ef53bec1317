"""A cloud that does not stand upright makes all stems lean the same way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from fsinfer.notices.notice import Notice
from fsinfer.notices.sentences import sentence
from fsinfer.notices.stems import StemCode
from fsinfer.trees import Section, Tree, analyse_plot
from fsinfer.trees.common_lean import common_lean
from tests.support.stem_clouds import stem_plot


def said(slopes_deg: Sequence[tuple[float, float]], status: str = "ok") -> tuple[Notice, ...]:
    """What is said of stems of these leans towards x and y."""
    trees = [Tree.__new__(Tree) for _ in slopes_deg]
    sections = [Section.__new__(Section) for _ in slopes_deg]
    for tree, section, lean in zip(trees, sections, slopes_deg, strict=True):
        object.__setattr__(tree, "status", status)
        object.__setattr__(section, "slope", np.tan(np.radians(lean)))
    return common_lean(trees, sections)


def test_a_tilted_cloud_is_told_and_an_upright_one_is_not() -> None:
    plot = stem_plot(seed=5, trees=6, spacing_m=0.02, top_m=3.0, slope=0.05, bumps_m=0.1)
    upright = analyse_plot(plot.points)
    assert StemCode.lean_alike not in {warning.code for warning in upright.warnings}
    turn = np.radians(8.0)
    about_y = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    tilted = analyse_plot(plot.points @ about_y.T)
    (told,) = [warning for warning in tilted.warnings if warning.code == StemCode.lean_alike]
    assert told.values["lean_deg"] == pytest.approx(8.0, abs=1.5)
    assert "lean the same way, " in sentence(told)
    assert "plumb line" in sentence(told)


def test_trees_that_lean_each_its_own_way_say_nothing() -> None:
    around = [(9 * np.cos(a), 9 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
    assert said(around) == ()
    (told,) = said([(x + 6, y) for x, y in around[:6]] + [(6.0, 0.0)] * 12)
    assert told.values == {"stems": 18, "lean_deg": pytest.approx(6.0, abs=1.5)}


def test_few_stems_or_a_little_lean_or_doubtful_ones_say_nothing() -> None:
    same = [(6.0, 0.1 * n) for n in range(5)]
    assert [told.values["stems"] for told in said(same)] == [5]
    assert said(same[:4]) == ()
    assert said(same, status="doubtful") == ()
    assert said([(3.8, 0.0)] * 9) == ()
    # Six degrees in the mean of stems that scatter as much tell nothing yet.
    assert said([(18.0, 0.0), (0.0, 9.0), (0.0, -9.0), (12.0, 8.0), (0.0, -8.0)]) == ()

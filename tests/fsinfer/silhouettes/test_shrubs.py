"""What is left out as a shrub: doubtful stems that many photographs show, and whose edges agree on nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fsinfer.notices.notice import Notice, notice
from fsinfer.notices.stems import StemCode
from fsinfer.silhouettes.join_settings import SilhouetteJoinSettings
from fsinfer.silhouettes.one_look import Looked
from fsinfer.silhouettes.shrubs import is_shrub
from fsinfer.silhouettes.stem_axis import StemAxis
from fsinfer.trees.diameter.edge_set import Edges
from fsinfer.trees.diameter.section import unmeasured_section
from fsinfer.trees.stem_measurement import tree_of
from fsinfer.trees.tree import Tree

S = SilhouetteJoinSettings()
STEM = StemAxis(breast=np.zeros(3), along=np.array([0.0, 0.0, 1.0]), radius_m=0.1, taper=0.0)


def shown_in(photos: int, *, radius_px: float = 4.0) -> Looked:
    """A place that so many photographs show, with an edge in each."""
    own = np.ones(photos, dtype=bool)
    edges = Edges(
        support_m=np.full(photos, 0.1), angle_rad=np.linspace(0.0, 6.0, photos), height_m=np.zeros(photos),
        strength=np.ones(photos), pixel_m=np.full(photos, STEM.radius_m / radius_px), ray=np.arange(photos),
        photo=np.arange(photos), own=own,
    )  # fmt: skip
    return Looked(stem=STEM, edges=edges, single=edges, fitted=edges, of_fit=edges, fit=None, moved_m=np.zeros(2))


def tree(*reasons: Notice, status: str = "unmeasured") -> Tree:
    section = unmeasured_section(np.zeros(2), 1.3, reasons or (notice(StemCode.too_rough),), radius_m=0.1)
    return replace(tree_of(section, 0.0, None, np.zeros(3)), status=status)


def uncertain(half_width_cm: float) -> Notice:
    return notice(StemCode.too_uncertain, dbh_cm=20.0, half_width_cm=half_width_cm)


@pytest.fixture
def contrast(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> float:
    """How well the edges agree."""
    value = float(request.param)
    monkeypatch.setattr("fsinfer.silhouettes.shrubs.edge_contrast", lambda *_args, **_kwargs: value)
    return value


NONE = 1.0
SOME = 0.5 * (S.shrub_contrast + S.many_contrast)
MORE = 0.5 * (S.many_contrast + S.sizeless_contrast)


@pytest.mark.parametrize(
    ("contrast", "looked", "asked", "shrub"),
    [
        (NONE, shown_in(20), tree(), True),
        (NONE, shown_in(20), tree(status="ok"), False),  # the points are sure of it
        (NONE, shown_in(5), tree(), False),  # hardly seen
        (NONE, shown_in(10, radius_px=9.0), tree(), True),  # but near
        (SOME, shown_in(20), tree(), False),
        (SOME, shown_in(60), tree(), True),  # what so many do not know
        (MORE, shown_in(60), tree(), False),
        (MORE, shown_in(20), tree(uncertain(30.0)), True),  # 20 cm, give or take 30
        (MORE, shown_in(20), tree(uncertain(14.0)), False),
    ],
    indirect=["contrast"],
)
def test_the_less_is_known_of_a_stem_the_more_its_edges_have_to_show(
    contrast: float, looked: Looked, asked: Tree, shrub: bool
) -> None:
    assert is_shrub(asked, looked, S) == shrub, contrast

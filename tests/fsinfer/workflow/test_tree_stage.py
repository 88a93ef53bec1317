"""Markers' posts are no trees, unless the stem behind the marker measures well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fsinfer.scale.scale import marker_centers
from fsinfer.trees import analyse_plot
from fsinfer.trees.posts import without_posts
from tests.support.stem_clouds import stem_plot


def test_markers_are_placed_in_the_cloud() -> None:
    similarity = np.eye(4)
    similarity[:3] *= 2.0
    similarity[:3, 3] = [1, 0, -1]
    record = {"details": {"markers": [{"center": [1.0, 2.0, 3.0]}, {"center": [0.0, 0.0, 0.0]}]}}
    np.testing.assert_allclose(marker_centers(record, similarity.tolist()), [[3, 4, 5], [1, 0, -1]])
    assert marker_centers({"details": {}}, similarity.tolist()).shape == (0, 3)


def test_a_doubtful_stem_at_a_marker_is_taken_for_its_post() -> None:
    plot = stem_plot(trees=4, seed=3)
    result = analyse_plot(plot.points)
    assert len(result.trees) >= 3
    doubtful = replace(result.trees[0], status="doubtful", reason="for the test")
    sound = replace(result.trees[1], status="ok", reason="")
    unmeasured = replace(result.trees[2], status="unmeasured", dbh_cm=None)
    changed = replace(result, trees=(doubtful, sound, unmeasured, *result.trees[3:]))
    markers = np.array([[t.x_m + 0.1, t.y_m, 1.0] for t in (doubtful, sound)])
    kept = without_posts(changed, markers)
    assert [t.tree_id for t in kept.trees] == [t.tree_id for t in changed.trees[1:]]
    assert kept.sections == changed.sections[1:]
    assert len(kept.warnings) == len(changed.warnings) + 1
    assert without_posts(changed, np.empty((0, 3))).trees == changed.trees

"""The options of the plot's border: checked before any work, and what is printed of the plot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsinfer.cli.tables import plot_rows
from fsinfer.plot_border.border import Border
from fsinfer.plot_border.plot import plot_of
from fsinfer.plot_border.sight import SeenShare
from fsinfer.trees import Tree
from tests.support.command_line import Call

TREE = Tree(
    tree_id=1, x_m=0.0, y_m=0.0, z_ground_m=0.0, dbh_cm=30.0, dbh_lo95_cm=29.6, dbh_hi95_cm=30.4,
    dbh_perimeter_cm=None, dbh_min_cm=None, dbh_max_cm=None, bh_m=1.3, arc_coverage=1.0, points=100, residual_cm=0.2,
    lean_deg=0.0, height_m=None, status="ok", reasons=(),
)  # fmt: skip


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--plot-center", "marker:7"], "without --plot-radius-m"),
        (["--plot-radius-m", "12.62", "--plot-center", "seven"], "--plot-center 'seven' is no place"),
        (["--plot-radius-m", "0"], "--plot-radius-m is 0"),
        (["--plot-radius-m", "12,62"], "write a point, not a comma: 12.62"),
        (["--plot-polygon", "none.geojson"], "there is no such file"),
        (["--plot-radius-m", "5", "--plot-polygon", "plot.csv"], "given together"),
    ],
)
@pytest.mark.parametrize("command", ["run", "trees"])
def test_wrong_borders_are_told_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call, command: str, options: list[str], words: str
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    Path("plot.csv").write_text("x_m,y_m\n0,0\n5,0\n5,5\n", encoding="utf-8")
    # The source is not even looked for.
    code, _, error = call(command, "not-there", "out", *options)
    assert code == 2
    assert words in " ".join(error.replace("│", " ").split())
    assert not Path("out").exists()


def test_the_plot_in_two_lines() -> None:
    border = Border(center=(0.0, 0.0), radius_m=12.62, origin="marker 7", moves_along=True)
    plot = plot_of([TREE], border, SeenShare(share=0.9, method="by eye"), slope_deg=0.0)
    first, stems, basal = plot_rows(plot.figures)
    assert first == (
        "Plot: radius 12.62 m (marker 7), 500 m², 90 % of it seen; 1 stem in (0 doubtful, 0 without a DBH), 0 out"
    )
    assert stems.startswith("  stems/ha 22 [20 - ")
    assert basal.startswith("  basal area m²/ha 1.6 [1.4 - ")
    assert plot_rows(None) == []
    apart = SeenShare(share=0.9, method="by eye", stems=np.array([False]))
    assert (
        "0 without a DBH, 1 where it was not seen), 0 out"
        in plot_rows(plot_of([TREE], border, apart, slope_deg=0.0).figures)[0]
    )
    unseen = plot_of([TREE], border, SeenShare(share=0.1, method="by eye"), slope_deg=0.0)
    assert len(plot_rows(unseen.figures)) == 1

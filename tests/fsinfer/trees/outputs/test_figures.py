"""Figures for people: what a map of few stems, of a hectare, and in a national grid looks like."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from fsinfer.io.images import read_image
from fsinfer.notices.notice import notice
from fsinfer.notices.stems import StemCode
from fsinfer.trees import PlotResult
from fsinfer.trees.outputs.figures import plot_stem_map
from fsinfer.trees.tree import Tree
from tests.support.stem_maps import tree_of


def _grid(columns: int, rows: int, *, apart_m: float = 2.5, origin: tuple[float, float] = (0.0, 0.0)) -> PlotResult:
    """Stems in rows and columns."""
    places = [(origin[0] + apart_m * i, origin[1] + apart_m * j, 0.0) for i in range(columns) for j in range(rows)]
    trees: tuple[Tree, ...] = tuple(tree_of(number, place, 25.0) for number, place in enumerate(places, start=1))
    return PlotResult(
        trees=trees,
        sections=(),
        ground=None,
        diagnosis=notice(StemCode.little_ground),
        warnings=(),
        extent_m=(*origin, origin[0] + apart_m * columns, origin[1] + apart_m * rows),
        spacing_m=0.01,
    )


def test_a_stem_map_grows_with_its_stems(tmp_path: Path) -> None:
    """A label is 45 pixels wide: labels of stems in rows must find room beside each other, few stems a screen."""
    sizes = {}
    for columns, rows in ((4, 4), (25, 25), (80, 4)):
        plot_stem_map(_grid(columns, rows), tmp_path / "map.png")
        sizes[columns] = read_image(tmp_path / "map.png").shape
    assert max(sizes[4]) < 1400
    assert sizes[25][1] / 25 > 70
    assert sizes[80][1] / 80 > 50


def test_a_stem_map_has_an_end(tmp_path: Path) -> None:
    """Pictures of more than 65,535 pixels a side cannot be written, and those of a gigabyte not be opened."""
    few = _grid(1, 2, apart_m=900.0)
    plot_stem_map(replace(few, trees=few.trees * 2000), tmp_path / "line.png")
    height, width, _ = read_image(tmp_path / "line.png").shape
    assert height < 17_000
    assert height * width < 60_000_000


def test_a_stem_map_has_whole_coordinates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a national grid the labels of the axes are northings, not what is to be added to 5.812e6."""
    seen: list[tuple[list[str], str]] = []
    save = Figure.savefig

    def look(figure: Figure, *args: object, **kwargs: object) -> None:
        save(figure, *args, **kwargs)  # type: ignore[arg-type]
        axes = figure.axes[0]
        seen.extend(
            ([label.get_text() for label in axis.get_ticklabels()], axis.get_offset_text().get_text())
            for axis in (axes.xaxis, axes.yaxis)
        )

    monkeypatch.setattr(Figure, "savefig", look)
    plot_stem_map(_grid(3, 9, origin=(412_345.0, 5_812_345.0)), tmp_path / "map.png")
    for labels, offset in seen:
        assert not offset
        assert all(np.isclose(float(label), (412_345.0, 5_812_345.0), atol=100.0).any() for label in labels)
    assert len(seen) == 2
    # A line an inch: labels of six digits stand apart.
    assert len(seen[0][0]) <= 7

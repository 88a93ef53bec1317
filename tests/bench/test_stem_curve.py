"""The figures of stem curves: which heights count where, and what lies inside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.bench.stem_curve import figures_of, read_curves


def test_figures_by_height() -> None:
    rows = np.array([[0.5, 30.0, 1.0, 1.0], [1.0, 29.0, -2.0, 1.0], [2.0, 28.0, 0.0, 0.5], [3.0, 27.0, 3.0, 2.0]])
    figures = figures_of(rows)
    assert [figures[f"{name}_diameters"] for name in ("all", "foot", "lower", "middle", "upper")] == [4, 1, 2, 1, 0]
    assert figures["all_rmse_cm"] == pytest.approx(np.sqrt(14.0 / 4.0))
    assert figures["lower_bias_cm"] == pytest.approx(-1.0)
    assert figures["all_inside_percent"] == 75.0
    assert figures["middle_half_width_median_cm"] == pytest.approx(3.92, abs=0.01)
    assert "upper_rmse_cm" not in figures


def test_heights_without_a_diameter_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "stem_curve.csv"
    path.write_text("tree_id,height_m,diameter_cm,std_cm\n7,0.5,30.1,0.4\n7,1.0,,\n8,0.5,20,\n", encoding="utf-8")
    assert read_curves(path) == {"7": {0.5: (30.1, 0.4)}, "8": {0.5: (20.0, 0.0)}}

from pathlib import Path

import numpy as np
import pytest

from tests.bench.classes import MeasuredStem, class_figures, nearest_m, truth_of_stems
from tests.bench.results import Result
from tests.bench.stem_tables import plot_classes

STEMS = [
    MeasuredStem(true_cm=12, found_cm=12.3, low_cm=12.1, high_cm=12.5, sides=0.4, lean_deg=5.0, camera_m=4.0),
    MeasuredStem(true_cm=18, found_cm=17.9, low_cm=17.4, high_cm=18.4, sides=0.9, lean_deg=1.0, camera_m=1.0),
    MeasuredStem(true_cm=30, found_cm=30.4, low_cm=29.4, high_cm=31.4, sides=0.8, lean_deg=0.0, camera_m=2.0),
]


def test_classes_add_up_over_plots() -> None:
    one, both = class_figures(STEMS[:1]), class_figures(STEMS)
    assert {key: one[key] + value for key, value in class_figures(STEMS[1:]).items()} == pytest.approx(both)
    results = [
        Result(name=f"plot-{i}", benchmark="tests.bench.plot", command="", kind="blind", figures=class_figures(stems))
        for i, stems in enumerate((STEMS[:1], STEMS[1:]))
    ]
    rows = {cells[1].strip(): cells[2:-1] for cells in (line.split("|") for line in plot_classes(results)[2:])}
    thin = [cell.strip() for cell in rows["thinner than 20 cm"]]
    assert thin == ["2", f"{np.sqrt((0.3**2 + 0.1**2) / 2):.2f} cm", "+0.10 cm", "1", "± 0.35 cm"]
    assert rows["thicker than 40 cm"][0].strip() == "0"


def test_truth_tells_lean_and_place(tmp_path: Path) -> None:
    (tmp_path / "truth.csv").write_text("tree_id,x_m,y_m,dbh_cm,lean_deg\n7,1.0,2.0,30,6.5\n", encoding="utf-8")
    lean_deg, place = truth_of_stems(tmp_path / "truth.csv")["7"]
    assert lean_deg == 6.5
    assert nearest_m(place, np.array([[1.0, 6.0, 1.5], [9.0, 9.0, 0.0]])) == pytest.approx(4.0)

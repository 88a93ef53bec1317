"""What makes a stem of a rendered plot hard, and the figures of each such class."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class MeasuredStem:
    """A stem of the truth that has a DBH: true and found, in cm, with its 95 % interval.

    ``sides`` is the share of its sides that was seen, as ``trees.csv`` gives it (``arc_coverage``); ``lean_deg`` and
    ``camera_m``, the distance to the nearest photograph in plan, are true.
    """

    true_cm: float
    found_cm: float
    low_cm: float
    high_cm: float
    sides: float
    lean_deg: float
    camera_m: float

    @property
    def inside(self) -> bool:
        """Whether the interval holds the truth."""
        return self.low_cm <= self.true_cm <= self.high_cm


#: Classes by name, with what a result calls them.
CLASSES: Mapping[str, tuple[str, Callable[[MeasuredStem], bool]]] = {
    "seen from 60 % of its sides and more": ("whole_", lambda stem: stem.sides >= 0.6),
    "seen from fewer sides": ("hidden_", lambda stem: stem.sides < 0.6),
    "thinner than 20 cm": ("thin_", lambda stem: stem.true_cm < 20),
    "thicker than 40 cm": ("thick_", lambda stem: stem.true_cm > 40),
    "leaning by 4° and more": ("leaning_", lambda stem: stem.lean_deg >= 4),
    "more than 3 m from the nearest photograph": ("far_", lambda stem: stem.camera_m > 3),
}


def truth_of_stems(path: Path) -> dict[str, tuple[float, tuple[float, float]]]:
    """Lean in degrees and place (x, y) in metres of each tree of a ``truth.csv`` by its number."""
    with path.open(encoding="utf-8", newline="") as stream:
        return {
            row["tree_id"]: (float(row.get("lean_deg") or 0.0), (float(row["x_m"]), float(row["y_m"])))
            for row in csv.DictReader(stream)
        }


def nearest_m(place: tuple[float, float], centers: NDArray[np.float64]) -> float:
    """Distance in plan to the nearest of the photographs (N, 3)."""
    return float(np.hypot(*(centers[:, :2] - place).T).min())


def class_figures(stems: Sequence[MeasuredStem]) -> dict[str, float]:
    """Number, squared error in cm^2 and number in their interval of each class: what adds up over plots."""
    figures: dict[str, float] = {}
    for prefix, chosen in CLASSES.values():
        group = [stem for stem in stems if chosen(stem)]
        errors = np.array([stem.found_cm - stem.true_cm for stem in group])
        figures |= {
            f"{prefix}stems": len(group),
            f"{prefix}inside": sum(stem.inside for stem in group),
            f"{prefix}error_sum_cm": float(errors.sum()),
            f"{prefix}error_squares_cm2": float((errors**2).sum()),
            f"{prefix}half_width_sum_cm": sum(0.5 * (stem.high_cm - stem.low_cm) for stem in group),
        }
    return figures


def class_lines(figures: Mapping[str, float]) -> list[str]:
    """One line a class, for the screen."""
    lines = []
    for name, (prefix, _) in CLASSES.items():
        count = figures[f"{prefix}stems"]
        if count:
            rmse = (figures[f"{prefix}error_squares_cm2"] / count) ** 0.5
            lines.append(
                f"{name}: n {count:g}, RMSE {rmse:.2f} cm, bias {figures[f'{prefix}error_sum_cm'] / count:+.2f} cm, "
                f"in their interval {figures[f'{prefix}inside']:g}, "
                f"half width {figures[f'{prefix}half_width_sum_cm'] / count:.2f} cm"
            )
    return lines

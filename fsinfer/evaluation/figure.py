"""The figure of an evaluation: extracted against measured DBH, the counts, and the differences (Bland and Altman)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fsinfer.errors import OutputError
from fsinfer.io.files import atomic_path

if TYPE_CHECKING:
    from fsinfer.evaluation.metrics import Evaluation

#: Width and height in inches, pixels an inch, and widths of the three parts. Source: layout.
_WIDTH_INCH, _HEIGHT_INCH, _PX_PER_INCH, _PARTS = 15.0, 5.2, 130, (1.0, 0.75, 1.15)
#: Sizes of titles and legend, points, area of a dot, points squared, and its rim. Source: layout.
_TITLE_PT, _LEGEND_PT, _DOT_PT2, _RIM_PT = 11, 9, 36, 0.6
#: Diameters of an empty figure, margin round those of another as a share of their range, and its least, cm. Source:
#: layout.
_EMPTY_CM, _MARGIN, _LEAST_MARGIN_CM = (0.0, 50.0), 0.08, 2.0
#: Free room above and below the bars and the differences, shares of their range. Source: layout.
_BAR_ROOM, _DIFFERENCE_ROOM = 0.12, 0.15
#: Standard deviations to both sides that hold 95 %. Source: numerics; Bland and Altman 1986, limits of
#: agreement.
_LIMITS_OF_AGREEMENT = 1.96
#: Endings of a figure's name. Source: format; what matplotlib writes without further programs.
_FORMATS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".pdf", ".svg", ".eps")
_GREEN, _GREY, _RED, _ORANGE = "#1b7837", "#9a9a9a", "#d1495b", "#d98300"


def refuse_no_figure(path: Path) -> None:
    """Refuse the place of a figure that nothing can be drawn into, before anything was compared.

    Raises
    ------
    OutputError
        It is a folder, or its name does not end as that of a picture does.
    """
    if path.is_dir():
        msg = f"--figure {path}: that is a folder; give the name of a file in it, such as {path / 'figure.png'}"
        raise OutputError(msg)
    if path.suffix.lower() not in _FORMATS:
        msg = f"--figure {path}: no picture of that kind can be drawn; end its name in .png (or .pdf, .svg)"
        raise OutputError(msg)


def plot_evaluation(evaluation: Evaluation, path: Path) -> None:
    """Three panels as PNG: scatter with the 1:1 line, how many trees were found, difference against mean.

    The ending of ``path`` may name another format; see :func:`refuse_no_figure`, whose errors these are.
    """
    refuse_no_figure(Path(path))
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    both = np.array([[p.measured_cm, p.extracted_cm] for p in evaluation.pairs if p.extracted_cm is not None])
    both = both.reshape(-1, 2)
    figure = Figure(figsize=(_WIDTH_INCH, _HEIGHT_INCH), layout="constrained")
    FigureCanvasAgg(figure)
    scatter, counts, differences = figure.subplots(1, 3, width_ratios=_PARTS)
    _scatter(scatter, both, evaluation)
    _counts(counts, evaluation)
    _bland_altman(differences, both)
    with atomic_path(Path(path)) as temporary:
        figure.savefig(temporary, dpi=_PX_PER_INCH)


def _scatter(axes: Any, both: NDArray[np.float64], evaluation: Evaluation) -> None:
    low, high = (float(both.min()), float(both.max())) if len(both) else _EMPTY_CM
    margin = max(_MARGIN * (high - low), _LEAST_MARGIN_CM)
    limits = (max(low - margin, 0.0), high + margin)
    axes.plot(limits, limits, color="0.5", linewidth=1.0, label="1:1", zorder=1)
    axes.scatter(both[:, 0], both[:, 1], s=_DOT_PT2, color=_GREEN, edgecolor="white", linewidth=_RIM_PT, zorder=2)
    axes.set(xlim=limits, ylim=limits, xlabel="Measured DBH (cm)", ylabel="Extracted DBH (cm)", aspect="equal")
    title = f"{evaluation.matched} of {evaluation.n} trees"
    if evaluation.rmse_cm is not None:
        title += f" · RMSE {evaluation.rmse_cm:.2f} cm · bias {evaluation.bias_cm:+.2f} cm"
    axes.set_title(title, fontsize=_TITLE_PT)
    axes.grid(color="0.92")
    axes.set_axisbelow(True)
    axes.legend(loc="upper left", frameon=False)


def _counts(axes: Any, evaluation: Evaluation) -> None:
    bars = {
        "matched\nwith DBH": (evaluation.matched, _GREEN),
        "found,\nno DBH": (evaluation.detected - evaluation.matched, _GREY),
        "omitted": (evaluation.omitted, _ORANGE),
        "false": (evaluation.false, _RED),
    }
    drawn = axes.bar(list(bars), [n for n, _ in bars.values()], color=[c for _, c in bars.values()])
    axes.bar_label(drawn)
    axes.set_title(f"{evaluation.n} measured trees", fontsize=_TITLE_PT)
    axes.set(ylabel="Trees")
    axes.margins(y=_BAR_ROOM)


def _bland_altman(axes: Any, both: NDArray[np.float64]) -> None:
    """Bland and Altman (Lancet 1986): limits of agreement at 1.96 standard deviations of the differences."""
    axes.set(xlabel="Mean of both (cm)", ylabel="Extracted - measured (cm)")
    axes.set_title("Differences", fontsize=_TITLE_PT)
    axes.axhline(0.0, color="0.5", linewidth=1.0)
    if len(both) == 0:
        return
    difference = both[:, 1] - both[:, 0]
    axes.scatter(both.mean(axis=1), difference, s=_DOT_PT2, color=_GREEN, edgecolor="white", linewidth=_RIM_PT)
    lines = [(float(difference.mean()), "bias", "-")]
    if len(difference) > 1:
        spread = _LIMITS_OF_AGREEMENT * float(difference.std(ddof=1))
        lines += [(lines[0][0] + spread, "+1.96 SD", "--"), (lines[0][0] - spread, "-1.96 SD", "--")]
    for level, name, style in lines:
        axes.axhline(level, color="#2b5c8a", linestyle=style, linewidth=1.2, label=f"{name} {level:+.2f} cm")
    axes.margins(y=_DIFFERENCE_ROOM)
    axes.grid(color="0.92")
    axes.set_axisbelow(True)
    axes.legend(loc="best", frameon=False, fontsize=_LEGEND_PT)

"""Figures of docs/capture.md: ``python docs/figures/capture.py`` writes them beside this file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge

HERE = Path(__file__).parent
BLUE, ORANGE, YELLOW, BARK, GREEN = "#0072B2", "#D55E00", "#E69F00", "#5b4636", "#7a9a5a"


def sheet(width: float, height: float, parts: int = 1) -> tuple[Figure, Any]:
    """An empty figure without axes lines."""
    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, parts)
    for one in np.ravel(axes):
        one.set_aspect("equal")
        one.set_axis_off()
    return figure, axes


def phone(axes: Any, x: float, y: float, angle_deg: float, *, reach: float, color: str = BLUE, fan: float = 32) -> None:
    """A photo: a dot, and the fan that it sees."""
    axes.add_patch(Wedge((x, y), reach, angle_deg - fan, angle_deg + fan, color=color, alpha=0.12, linewidth=0))
    axes.plot(x, y, "o", color=color, markersize=4)


def draw_walk() -> None:
    """The path through a plot from above."""
    figure, axes = sheet(7.5, 7.0)
    rng = np.random.default_rng(3)
    boards = [(6.6 * np.cos(turn), 6.6 * np.sin(turn)) for turn in np.radians([20, 140, 262])]
    trees: list[tuple[float, float]] = []
    while len(trees) < 16:
        x, y = rng.uniform(-8, 8, 2)
        free = abs(np.hypot(x, y) - 4.6) > 0.9 and np.hypot(x, y) < 8
        if free and all(np.hypot(x - a, y - b) > 2 for a, b in [*trees, *boards]):
            trees.append((float(x), float(y)))
    axes.add_patch(Circle((0, 0), 8.2, fill=False, color="0.6", linestyle=":", linewidth=1.5))
    axes.text(0, 8.3, "edge of the plot", ha="center", va="bottom", fontsize=9, color="0.4")
    for x, y in trees:
        axes.add_patch(Circle((x, y), 0.22, color=BARK))
    angle = np.radians(np.linspace(-100, 260, 200))
    for radius, color, label in (
        (9.6, BLUE, "1. round the plot, looking in"),
        (4.6, GREEN, "2. round inside, looking out"),
    ):
        axes.plot(radius * np.cos(angle[:-6]), radius * np.sin(angle[:-6]), color=color, linewidth=2, label=label)
        for turn in np.radians([-40, 80, 200]):
            step = np.array([-np.sin(turn), np.cos(turn)]) * 0.01
            place = radius * np.array([np.cos(turn), np.sin(turn)])
            axes.annotate("", place + step, place, arrowprops={"arrowstyle": "-|>", "color": color, "lw": 2})
    for turn in np.radians(np.arange(-100, 240, 14)):
        phone(axes, 9.6 * np.cos(turn), 9.6 * np.sin(turn), np.degrees(turn) + 180, reach=2.2)
    for turn in np.radians(np.arange(-95, 240, 28)):
        phone(axes, 4.6 * np.cos(turn), 4.6 * np.sin(turn), np.degrees(turn), reach=1.8, color=GREEN)
    for x, y in boards:
        box = Rectangle((x - 0.32, y - 0.32), 0.64, 0.64, color="black", zorder=4)
        axes.add_patch(box)
        axes.add_patch(Rectangle((x - 0.12, y - 0.12), 0.24, 0.24, color="white", zorder=5))
    axes.plot([], [], "s", color="black", markersize=9, label="boards, three or more, spread out")
    axes.plot([], [], "o", color=BARK, markersize=9, label="trees")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=2, fontsize=10, frameon=False)
    axes.set_xlim(-10.8, 10.8)
    axes.set_ylim(-10.8, 10.8)
    figure.savefig(HERE / "capture_walk.png")


def draw_height() -> None:
    """Height and distance from the side."""
    figure, axes = sheet(8.5, 3.9)
    axes.add_patch(Rectangle((-1, -1), 11, 1, color="white", zorder=1.5))
    axes.plot([-0.8, 9.2], [0, 0], color=GREEN, linewidth=3)
    axes.add_patch(Polygon([(7.8, 0), (8.2, 0), (8.14, 4), (7.86, 4)], color=BARK))
    axes.plot([7.5, 8.5], [1.3, 1.3], color=ORANGE, linewidth=2)
    axes.text(8.6, 1.3, "1.3 m:\nDBH is\nmeasured\nhere", color=ORANGE, va="center", fontsize=10)
    # Three photos of a walk towards the tree.
    for x, label in ((0.0, "8 m: the farthest"), (3.0, "5 m: good"), (5.0, "3 m: the nearest")):
        low, high = 1.5 - 0.52 * (8 - x), 1.5 + 0.36 * (8 - x)
        axes.add_patch(Polygon([(x, 1.5), (8, low), (8, high)], color=BLUE, alpha=0.1, linewidth=0))
        axes.plot([x, x], [0, 1.5], color="0.6", linestyle=":")
        axes.plot(x, 1.5, "s", color=BLUE, markersize=9)
        axes.text(x, 1.75, label, ha="center", fontsize=10)
    axes.text(-0.9, 0.75, "1.5 m", ha="left", fontsize=10, color="0.3")
    axes.text(
        3.9,
        -0.42,
        "tilt the phone down a little: the foot of the stem and the ground must be in the picture",
        ha="center",
        fontsize=10,
    )
    axes.set_xlim(-1.0, 9.7)
    axes.set_ylim(-0.7, 4.1)
    figure.savefig(HERE / "capture_height.png")


def draw_round() -> None:
    """All round, and one side only."""
    figure, parts = sheet(8.5, 4.4, 2)
    for axes, turns, title in (
        (parts[0], np.arange(0, 360, 30), "all round: the whole stem is measured"),
        (parts[1], np.arange(200, 345, 18), "one side only: the far half is a guess"),
    ):
        axes.add_patch(Circle((0, 0), 0.55, color=BARK))
        for turn in np.radians(turns):
            phone(axes, 2.6 * np.cos(turn), 2.6 * np.sin(turn), np.degrees(turn) + 180, reach=1.5, fan=14)
        first, last = (0, 360) if len(turns) == 12 else (185, 350)
        axes.add_patch(Wedge((0, 0), 0.85, first, last, width=0.2, color=BLUE))
        if len(turns) != 12:
            axes.add_patch(Wedge((0, 0), 0.95, -10, 185, width=0.3, color=ORANGE))
            axes.text(0, 1.35, "not seen", color=ORANGE, ha="center", fontsize=11)
        axes.text(0, 3.1, title, fontsize=12, ha="center")
        axes.set_xlim(-3.2, 3.2)
        axes.set_ylim(-3, 3.5)
    figure.savefig(HERE / "capture_round.png")


def draw_board() -> None:
    """A board and the photos of it."""
    figure, parts = sheet(8.5, 4.0, 2)
    side, top = parts
    side.plot([-0.5, 4.2], [0, 0], color=GREEN, linewidth=3)
    side.plot([3.4, 3.4], [0, 1.35], color="0.5", linewidth=4)
    side.add_patch(Rectangle((3.3, 0.95), 0.07, 0.42, color="black"))
    side.plot(0.8, 1.5, "s", color=BLUE, markersize=9)
    side.add_patch(Polygon([(0.8, 1.5), (3.3, 0.5), (3.3, 1.9)], color=BLUE, alpha=0.12, linewidth=0))
    side.annotate("", (0.8, 0.3), (3.3, 0.3), arrowprops={"arrowstyle": "<->", "color": "0.3"})
    side.text(2.05, 0.38, "2 to 3 m", ha="center", fontsize=10)
    side.text(3.55, 1.15, "1 to 1.5 m\nhigh, flat,\nupright", fontsize=10, va="center")
    side.set_xlim(-0.2, 4.9)
    side.set_ylim(-0.3, 2.4)
    side.set_title("from the side", fontsize=11)
    top.add_patch(Rectangle((-0.3, 2.5), 0.6, 0.08, color="black"))
    for x in np.linspace(-1.9, 1.9, 6):
        y = 0.25 * abs(x)
        phone(top, x, y, float(np.degrees(np.arctan2(2.5 - y, -x))), reach=2.2, fan=10)
    top.text(
        0, -0.55, "five photos or more from different places,\nnone more slanted than this", ha="center", fontsize=10
    )
    top.set_xlim(-2.6, 2.6)
    top.set_ylim(-0.9, 2.9)
    top.set_title("from above", fontsize=11)
    figure.savefig(HERE / "capture_board.png")


if __name__ == "__main__":
    for draw in (draw_walk, draw_height, draw_round, draw_board):
        draw()

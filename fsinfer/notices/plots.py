"""What is to be told of a plot's border and of its figures a hectare."""

from __future__ import annotations

from enum import StrEnum


class PlotCode(StrEnum):
    """Warnings of the border, and what a border lacks."""

    border_cases = "border_cases"
    plot_partly_seen = "plot_partly_seen"
    plot_hardly_seen = "plot_hardly_seen"
    border_elsewhere = "border_elsewhere"
    outside_walk_in_plot = "outside_walk_in_plot"
    border_not_placed = "border_not_placed"
    # Why a border could not be placed.
    no_such_marker = "no_such_marker"
    marker_twice = "marker_twice"
    no_walk = "no_walk"
    no_metres = "no_metres"


#: What each code says; ``{name}`` is filled with the notice's values.
SENTENCES: dict[PlotCode, str] = {
    PlotCode.border_cases: (
        "at the plot's border, nearer than their radius or the error of their place: {trees}; measure in the forest "
        "whether they are in"
    ),
    PlotCode.plot_partly_seen: (
        "only {percent:.0f} % of the plot was seen: figures a hectare take the rest to be like it; walk through the "
        "rest, too"
    ),
    PlotCode.plot_hardly_seen: (
        "only {percent:.0f} % of the plot was seen, less than {least:.0f} %: no figures a hectare are given; look at "
        "the plot's centre and radius, or walk through the rest, too"
    ),
    PlotCode.border_elsewhere: (
        "nothing of the cloud lies within the plot's border, whose middle is at ({x_m:.1f}, {y_m:.1f}): no figures a "
        "hectare are given; give its place in metres of the cloud's own frame"
    ),
    PlotCode.outside_walk_in_plot: (
        "stems outside of the walk, but in the plot ({stems}): {trees}; they count there, with the mean section "
        "of the others; go nearer, or measure them with --far-stems"
    ),
    PlotCode.border_not_placed: "the plot has no border ({why}): figures a hectare are of seen ground only",
    PlotCode.no_such_marker: (
        "its centre, marker {number}, was not found; found: {found}; markers are looked for where the scale comes from "
        "them"
    ),
    PlotCode.marker_twice: "its centre, marker {number}, was found at two places {apart_m:.1f} m apart",
    PlotCode.no_walk: "where the photos were taken is not known; give --plot-center as x,y",
    PlotCode.no_metres: "its size is in metres, and no scale is known",
}

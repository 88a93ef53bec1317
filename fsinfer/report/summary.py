"""The head of the report: the plot in a few large numbers, and a table of all that is known of it."""

from __future__ import annotations

from dataclasses import dataclass

from fsinfer.notices.numbers import noun
from fsinfer.report.contents import Contents, measured_cm, number, tree_number
from fsinfer.report.number_table import NumberTable
from fsinfer.report.page import Part
from fsinfer.report.plot_border import (
    SEEN_GROUND_ONLY,
    WITHOUT_BORDER,
    border_facts,
    border_of,
    is_in,
    lost_border,
    rows_in,
    same_mean,
)
from fsinfer.report.stand_figures import basal_area_m2, class_table, diameters_cm, stand_of

SCALE_SOURCES = {
    "aruco": "markers in the photos",
    "factor": "the factor that was given",
    "endpoints": "the length between two points that were given",
    "unknown": "an unknown source",
}


@dataclass(frozen=True, kw_only=True)
class TilesView:
    """Large numbers: (value, what it is)."""

    tiles: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class PlotView:
    """Names and values, then the tables of the stand and of the markers."""

    facts: tuple[tuple[str, str], ...]
    tables: tuple[NumberTable, ...]


def tiles_part(contents: Contents) -> Part:
    """The row of large numbers; only what is known. Of a plot with a border they are those of the plot."""
    plot, stand, border = contents.plot, stand_of(contents), border_of(contents)
    shown: list[tuple[str, str]] = []
    if contents.trees is not None:
        own = stand if border is None else border
        # Stems outside of the walk are found, too: those of them that stand in the plot count there.
        where = noun(own.stems, "stem", "stems")
        where += " found" if border is None else f" in the plot, of {border.stems + border.outside} found"
        shown += [(str(own.stems), where), (str(own.measured), "with a DBH")]
        if own.quadratic_mean_dbh_cm is not None:
            shown.append((f"{own.quadratic_mean_dbh_cm:.1f} cm", "quadratic mean DBH"))
        if own.measured:
            shown.append((f"{basal_area_m2(diameters_cm(contents)):.2f} m²", "basal area of these stems"))
    if plot.get("photos") is not None:
        used = "?" if contents.registered is None else f"{contents.registered:.0f}"
        shown.append((f"{used} of {plot['photos']}", "photos used"))
    points = number(plot.get("points"))
    if points is not None:
        shown.append((f"{int(points):,}", "points in the cloud"))
    return Part(anchor="tiles", view=TilesView(tiles=tuple(shown)))


def plot_part(contents: Contents) -> Part:
    """Plot summary and stand table."""
    tables = (class_table(contents, stand_of(contents)), _markers(contents))
    facts = (*_stand_facts(contents), *_cloud_facts(contents))
    return Part(
        anchor="plot", title="Plot", view=PlotView(facts=facts, tables=tuple(t for t in tables if t is not None))
    )


def _stand_facts(contents: Contents) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    if contents.plot.get("source"):
        rows.append(("Photos from" if contents.photographed else "Cloud", str(contents.plot["source"])))
    if contents.trees is None:
        return [*rows, ("Trees", contents.why_missing("trees.csv"))]
    stand = stand_of(contents)
    rows += [("Stems found", str(stand.stems)), ("Stems with a DBH", str(stand.measured))]
    plot = border_of(contents)
    if outside := len(contents.trees) - len(contents.counted):
        within = 0 if plot is None else len(rows_in(contents)) - sum(is_in(tree) is True for tree in contents.counted)
        but = f", but for {within} in the plot" if within else ""
        rows.append(("Outside of the walk", f"{outside} more, listed and not counted{but}"))
    if stand.mean_dbh_cm is not None and stand.quadratic_mean_dbh_cm is not None:
        # Otherwise whoever takes the mean of the table finds another one.
        everywhere = same_mean(measured_cm(contents.counted), stand.mean_dbh_cm)
        # With a border it is the plot that counts to the hectare, and its own means follow.
        ground = "ground that counts to the hectare" if plot is None else "seen ground, in the plot or not"
        of_which = "" if everywhere else f", of those on the {ground}"
        rows += [
            ("Mean DBH", f"{stand.mean_dbh_cm:.1f} cm{of_which}"),
            ("Quadratic mean DBH", f"{stand.quadratic_mean_dbh_cm:.1f} cm{of_which}"),
            ("Basal area of these stems", f"{basal_area_m2(diameters_cm(contents, everywhere=True)):.3f} m²"),
        ]
    # A plot without stems, or without diameters, has its area and its stems a hectare all the same.
    if plot is not None:
        return [*rows, *border_facts(plot)]
    if stand.plot_area_m2 is None or stand.stems_per_ha is None:
        why = "not given: the area of the plot is not known"
        return rows if stand.mean_dbh_cm is None else [*rows, ("Per hectare", why)]
    rows.append(("Plot area", f"{stand.plot_area_m2:,.0f} m²"))
    if stand.stems_on_area is not None and stand.stems_on_area < stand.stems:
        of = f"{stand.stems_on_area} of {stand.stems}; only they count to the hectare"
        rows.append(("Stems on that ground", of))
    rows.append(("Stems per hectare", f"{stand.stems_per_ha:,.0f}"))
    if stand.basal_area_m2_per_ha is not None:
        counted = [tree for tree in contents.counted if tree_number(tree) not in stand.off_area]
        unknown = len(counted) - len(measured_cm(counted))
        told = "counted with what is roughly known of them, or the mean of the others"
        by_mean = f" ({unknown} without a DBH {told})" if unknown else ""
        rows.append(("Basal area per hectare", f"{stand.basal_area_m2_per_ha:.1f} m²/ha{by_mean}"))
    of_what = WITHOUT_BORDER if lost_border(contents) else SEEN_GROUND_ONLY
    return [*rows, ("These figures per hectare", of_what)]


def _cloud_facts(contents: Contents) -> list[tuple[str, str]]:
    plot = contents.plot
    rows: list[tuple[str, str]] = []
    points, density = number(plot.get("points")), number(plot.get("density_per_m2"))
    if points is not None:
        rows.append(("Points", f"{points:,.0f}"))
    if density:
        rows.append(("Point density", f"{density:,.0f} per m²"))
        if points:
            rows.append(("Ground area covered by the cloud", f"{points / density:,.0f} m²"))
    scale, spread = number(plot.get("scale_m_per_unit")), number(plot.get("scale_rel_std"))
    if scale is not None:
        source = str(plot.get("scale_source") or "unknown")
        known = f"{scale:.6g} m per model unit, from {SCALE_SOURCES.get(source, source)}"
        rows.append(
            ("Scale", known + (f", ± {100 * spread:.2f} % (one standard deviation)" if spread is not None else ""))
        )
    elif plot:
        unknown = "none: lengths are in model units"
        rows.append(("Scale", "none was given: the cloud was taken to be in metres" if contents.metric else unknown))
    difference = number(plot.get("depth_vs_sfm_median_rel"))
    if difference is not None:
        rows.append(("Depth against tie points (median)", f"{100 * difference:.2f} %"))
    rows.append(("Lengths in", "m" if contents.metric else "model units"))
    return rows


def _markers(contents: Contents) -> NumberTable | None:
    """The markers that gave the scale, each with how far it disagrees with the others."""
    details = contents.plot.get("scale_details")
    markers = details.get("markers") if isinstance(details, dict) else None
    if not isinstance(markers, list) or not markers or not all(isinstance(marker, dict) for marker in markers):
        return None
    rows = []
    for marker in markers:
        views, residual = marker.get("views"), number(marker.get("residual_rel"))
        without, pixels = number(marker.get("leave_one_out_rel")), number(marker.get("error_px"))
        rows.append(
            (
                str(marker.get("id", "?")),
                str(len(views)) if isinstance(views, list) else "",
                "" if residual is None else f"{100 * residual:+.2f} %",
                "" if without is None else f"{100 * without:+.2f} %",
                "" if pixels is None else f"{pixels:.2f}",
            )
        )
    head = ("Marker", "Photos", "Its length differs by", "Scale without it", "Error (pixels)")
    return NumberTable(title="Scale by markers", head=head, rows=tuple(rows))

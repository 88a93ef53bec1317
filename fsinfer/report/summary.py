"""The head of the report: the plot in a few numbers, the stand table, and the warnings in plain words."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from fsinfer.report.contents import Contents, number
from fsinfer.report.html import escape, facts, section

# Width of the diameter classes of the stand table: inventories use 2, 4 or 5 cm.
CLASS_CM = 5
SCALE_SOURCES = {
    "aruco": "markers in the photos",
    "factor": "the factor that was given",
    "endpoints": "the length between two points that were given",
    "unknown": "an unknown source",
}


@dataclass(frozen=True, kw_only=True)
class Stand:
    """The stand table.

    Attributes
    ----------
    stems, measured: trees found; those with a DBH.
    dbh_mean_cm, quadratic_mean_dbh_cm: over the measured; None without one.
    basal_area_m2: of the measured stems, sum of pi/4 DBH^2.
    area_m2: of the plot, where it was given.
    """

    stems: int
    measured: int
    dbh_mean_cm: float | None
    quadratic_mean_dbh_cm: float | None
    basal_area_m2: float | None
    area_m2: float | None


def stand_of(contents: Contents) -> Stand:
    """Compute the stand table from ``trees.csv`` (and ``plot_area_m2`` of ``plot.json`` where it is given)."""
    trees = contents.trees or []
    dbh_cm = [d for d in (number(tree.get("dbh_cm")) for tree in trees) if d is not None]
    area_m2 = number(contents.plot.get("plot_area_m2"))
    return Stand(
        stems=len(trees),
        measured=len(dbh_cm),
        dbh_mean_cm=sum(dbh_cm) / len(dbh_cm) if dbh_cm else None,
        quadratic_mean_dbh_cm=math.sqrt(sum(d * d for d in dbh_cm) / len(dbh_cm)) if dbh_cm else None,
        basal_area_m2=math.pi / 4 * sum((d / 100) ** 2 for d in dbh_cm) if dbh_cm else None,
        area_m2=area_m2 if area_m2 and area_m2 > 0 else None,
    )


def tiles(contents: Contents) -> str:
    """Return the row of large numbers; only what is known."""
    plot, stand = contents.plot, stand_of(contents)
    shown: list[tuple[str, str]] = []
    if contents.trees is not None:
        shown += [(str(stand.stems), "stems found"), (str(stand.measured), "with a DBH")]
    if stand.quadratic_mean_dbh_cm is not None:
        shown.append((f"{stand.quadratic_mean_dbh_cm:.1f} cm", "quadratic mean DBH"))
    if stand.basal_area_m2 is not None:
        shown.append((f"{stand.basal_area_m2:.2f} m²", "basal area of these stems"))
    if plot.get("photos") is not None:
        shown.append((f"{plot.get('registered', '?')} of {plot['photos']}", "photos used"))
    if number(plot.get("points")) is not None:
        shown.append((f"{int(float(plot['points'])):,}", "points in the cloud"))
    cells = "".join(
        f'<div class="tile"><b>{escape(value)}</b><span>{escape(name)}</span></div>' for value, name in shown
    )
    return f'<div class="tiles">{cells}</div>' if cells else ""


def plot_section(contents: Contents) -> str:
    """Return plot summary and stand table."""
    plot, stand = contents.plot, stand_of(contents)
    unit = "m" if contents.metric else "model units"
    rows: list[tuple[str, str]] = []
    if plot.get("source"):
        rows.append(("Photos from", str(plot["source"])))
    if contents.trees is None:
        rows.append(("Trees", "trees.csv is not in this folder"))
    else:
        rows += [("Stems found", str(stand.stems)), ("Stems with a DBH", str(stand.measured))]
    if stand.dbh_mean_cm is not None and stand.quadratic_mean_dbh_cm is not None and stand.basal_area_m2 is not None:
        rows += [
            ("Mean DBH", f"{stand.dbh_mean_cm:.1f} cm"),
            ("Quadratic mean DBH", f"{stand.quadratic_mean_dbh_cm:.1f} cm"),
            ("Basal area of these stems", f"{stand.basal_area_m2:.3f} m²"),
        ]
        if stand.area_m2 is not None:
            hectares = stand.area_m2 / 10_000
            rows += [
                ("Plot area", f"{stand.area_m2:.0f} m²"),
                ("Stems per hectare", f"{stand.stems / hectares:.0f}"),
                ("Basal area per hectare, stems with a DBH", f"{stand.basal_area_m2 / hectares:.1f} m²/ha"),
            ]
        else:
            rows.append(("Per hectare", "not given: the area of the plot is not known"))
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
        rows.append(("Scale", "none: lengths are in model units"))
    difference = number(plot.get("depth_vs_sfm_median_rel"))
    if difference is not None:
        rows.append(("Depth against tie points (median)", f"{100 * difference:.2f} %"))
    rows.append(("Lengths in", unit))
    return section("Plot", facts(rows), _classes(contents, stand), _boards(contents), anchor="plot")


def _classes(contents: Contents, stand: Stand) -> str:
    """The stand table: stems and basal area by classes of diameter."""
    dbh_cm = [d for d in (number(tree.get("dbh_cm")) for tree in contents.trees or ()) if d is not None]
    if not dbh_cm:
        return ""
    per_hectare = None if stand.area_m2 is None else 10_000 / stand.area_m2
    head = ["DBH class (cm)", "Stems", "Basal area (m²)"]
    if per_hectare is not None:
        head += ["Stems per ha", "Basal area (m²/ha)"]
    counted = Counter(int(d // CLASS_CM) for d in dbh_cm)
    rows = []
    for k in range(min(counted), max(counted) + 1):
        own = [d for d in dbh_cm if int(d // CLASS_CM) == k]
        rows.append(_class_row(f"{k * CLASS_CM} to under {(k + 1) * CLASS_CM}", own, per_hectare))
    rows.append(_class_row("All with a DBH", dbh_cm, per_hectare))
    return _wide_table("Stand table", head, rows, total=True)


def _wide_table(title: str, head: list[str], rows: list[list[str]], *, total: bool = False) -> str:
    """A table of numbers under a heading; ``total`` sets its last row off."""
    top = "".join(f'<th scope="col">{escape(text)}</th>' for text in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in rows)
    return (
        f'<h3>{escape(title)}</h3><div class="wide" tabindex="0" role="region" aria-label="{escape(title)}">'
        f'<table class="stand{" total" if total else ""}"><thead><tr>{top}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _boards(contents: Contents) -> str:
    """The markers that gave the scale, each with how far it disagrees with the others."""
    details = contents.plot.get("scale_details")
    boards = details.get("markers") if isinstance(details, dict) else None
    if not isinstance(boards, list) or not boards or not all(isinstance(board, dict) for board in boards):
        return ""
    rows = []
    for board in boards:
        views, residual = board.get("views"), number(board.get("residual_rel"))
        without, pixels = number(board.get("leave_one_out_rel")), number(board.get("error_px"))
        rows.append(
            [
                str(board.get("id", "?")),
                str(len(views)) if isinstance(views, list) else "",
                "" if residual is None else f"{100 * residual:+.2f} %",
                "" if without is None else f"{100 * without:+.2f} %",
                "" if pixels is None else f"{pixels:.2f}",
            ]
        )
    head = ["Marker", "Photos", "Its length differs by", "Scale without it", "Error (pixels)"]
    return _wide_table("Scale by markers", head, rows)


def _class_row(name: str, dbh_cm: list[float], per_hectare: float | None) -> list[str]:
    basal_m2 = math.pi / 4 * sum((d / 100) ** 2 for d in dbh_cm)
    row = [name, str(len(dbh_cm)), f"{basal_m2:.3f}"]
    if per_hectare is not None:
        row += [f"{len(dbh_cm) * per_hectare:.0f}", f"{basal_m2 * per_hectare:.1f}"]
    return row

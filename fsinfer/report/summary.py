"""The head of the report: the plot in a few numbers, the stand table, and the warnings in plain words."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

from fsinfer.report.contents import Contents, number
from fsinfer.report.html import bullets, escape, facts, paragraph, section

NO_SCALE = (
    "No scale is known: all lengths, positions and densities are in model units, not metres, and no DBH is given. "
    "Photograph a marker of known size and run again with --aruco-length-m, or give --endpoints with --length-m."
)


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


def warnings_section(contents: Contents) -> str:
    """Return scale alarm and warnings, first of all things to read."""
    plot = contents.plot
    parts = []
    if plot and not contents.metric:
        parts.append(paragraph(NO_SCALE, "alarm"))
    given = plot.get("warnings")
    texts = [str(text) for text in given] if isinstance(given, list) else [str(given)] if given else []
    if parts:
        # The alarm above says it already.
        texts = [text for text in texts if not text.startswith("no scale")]
    diagnosis = plot.get("diagnosis")
    if diagnosis and diagnosis not in texts and not (contents.trees or []):
        texts.append(str(diagnosis))
    photos, registered = number(plot.get("photos")), number(plot.get("registered"))
    if photos and registered is not None and registered < 0.8 * photos:
        texts.append(
            f"Only {registered:.0f} of {photos:.0f} photos could be placed: parts of the plot may be missing. Take "
            "more photos with more overlap, walking slowly."
        )
    difference = number(plot.get("depth_vs_sfm_median_rel"))
    if difference is not None and difference > 0.01:
        texts.append(
            f"The depth maps differ from the tie points of the photos by {100 * difference:.1f} % (median); below 1 % "
            "is usual. Treat the diameters with care."
        )
    unsure = Counter(tree.get("status", "") for tree in contents.trees or ())
    told = [
        f"{unsure[k]} {what}" for k, what in (("unmeasured", "without a DBH"), ("doubtful", "doubtful")) if unsure[k]
    ]
    if told:
        texts.append(f"Stems {' and '.join(told)}: the last column of the tree table says why.")
    texts += contents.notes
    if texts:
        parts.append(bullets(texts, "warnings"))
    elif not parts:
        parts.append(paragraph("None." if plot else "plot.json is not in this folder, so nothing is known.", "note"))
    return section("What to look out for", *parts, anchor="warnings")


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
        known = f"{scale:.6g} m per model unit, from {plot.get('scale_source', 'an unknown source')}"
        rows.append(
            ("Scale", known + (f", ± {100 * spread:.2f} % (one standard deviation)" if spread is not None else ""))
        )
    elif plot:
        rows.append(("Scale", "none: lengths are in model units"))
    difference = number(plot.get("depth_vs_sfm_median_rel"))
    if difference is not None:
        rows.append(("Depth against tie points (median)", f"{100 * difference:.2f} %"))
    rows.append(("Lengths in", unit))
    return section("Plot", facts(rows), anchor="plot")

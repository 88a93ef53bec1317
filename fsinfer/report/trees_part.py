"""The trees in the report: the sortable table, the stem map and a card with the cross-section of each tree."""

from __future__ import annotations

import re

from fsinfer.report.contents import Contents, number
from fsinfer.report.html import embedded_file, paragraph, section, sortable_table

_KINDS = ("ok", "doubtful", "unmeasured")


def table_section(contents: Contents) -> str:
    """Return the table of all trees; click on a column's head to sort."""
    if contents.trees is None:
        return section("Trees", paragraph("trees.csv is not in this folder.", "missing"), anchor="trees")
    if not contents.trees:
        why = str(contents.plot.get("diagnosis") or "The table of trees is empty.")
        return section("Trees", paragraph("No trees were found."), paragraph(why), anchor="trees")
    unit = "m" if contents.metric else "units"
    columns = (
        ("Tree", "tree_id", "{:.0f}"),
        ("DBH (cm)", "dbh_cm", "{:.1f}"),
        ("95 % interval (cm)", "", ""),
        ("Status", "status", ""),
        ("From perimeter (cm)", "dbh_perimeter_cm", "{:.1f}"),
        ("Seen all round (%)", "arc_coverage", "{:.0%}"),
        ("Residual (cm)", "residual_cm", "{:.2f}"),
        ("Points", "points", "{:.0f}"),
        ("Lean (°)", "lean_deg", "{:.1f}"),
        (f"x ({unit})", "x_m", "{:.2f}"),
        (f"y ({unit})", "y_m", "{:.2f}"),
    )
    rows = []
    for tree in contents.trees:
        cells = []
        for _, name, form in columns:
            if name == "status":
                cells.append((tree.get("status", ""), tree.get("status", "")))
            elif name:
                value = number(tree.get(name))
                cells.append(("" if value is None else form.format(value), "" if value is None else repr(value)))
            else:
                cells.append(_interval(tree))
        rows.append([*cells, (tree.get("reason", ""), tree.get("reason", ""))])
    kinds = [tree["status"] if tree.get("status") in _KINDS else "ok" for tree in contents.trees]
    return section(
        "Trees",
        paragraph("Click on a heading to sort. An empty DBH was not measured; the last column says why.", "note"),
        sortable_table([*(head for head, _, _ in columns), "Remark"], rows, kinds),
        anchor="trees",
    )


def figures_section(contents: Contents) -> str:
    """Return the stem map and the cross-sections that lie in ``figures``."""
    folder = contents.out / "figures"
    parts = []
    stem_map = folder / "stem_map.png"
    if stem_map.is_file():
        parts.append(f'<div class="single">{embedded_file(stem_map, "Stem map")}</div>')
    else:
        parts.append(paragraph("There is no stem map in this folder.", "missing"))
    by_id = {str(int(i)): tree for tree in contents.trees or () if (i := number(tree.get("tree_id"))) is not None}
    cards = [
        (int(found[1]), path)
        for path in folder.glob("tree_*.png")
        if (found := re.fullmatch(r"tree_0*(\d+)", path.stem)) is not None
    ]
    figures = [embedded_file(path, _caption(number_, by_id.get(str(number_)))) for number_, path in sorted(cards)]
    if figures:
        parts.append(f"<h3>Cross-sections at breast height</h3><div class='cards'>{''.join(figures)}</div>")
    else:
        parts.append(paragraph("There are no cross-section figures in this folder.", "missing"))
    return section("Stem map and cross-sections", *parts, anchor="figures")


def _interval(tree: dict[str, str]) -> tuple[str, str]:
    low, high = number(tree.get("dbh_lo95_cm")), number(tree.get("dbh_hi95_cm"))
    if low is None or high is None:
        return "", ""
    # Sorted by its width: the surest tree first.
    return f"{low:.1f} to {high:.1f}", repr(high - low)


def _caption(tree_id: int, tree: dict[str, str] | None) -> str:
    if tree is None:
        return f"Tree {tree_id} (not in trees.csv)"
    dbh_cm = number(tree.get("dbh_cm"))
    if dbh_cm is None:
        return f"Tree {tree_id}: DBH not measured. {tree.get('reason', '')}".strip()
    interval, _ = _interval(tree)
    return f"Tree {tree_id}: DBH {dbh_cm:.1f} cm" + (f" (95 %: {interval} cm)" if interval else "")

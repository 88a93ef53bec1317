"""The trees in the report: the map beside the card of the tree picked on it, and the sortable table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fsinfer.errors import FsinferError
from fsinfer.io.images import read_image
from fsinfer.report.contents import Contents, number, tree_number
from fsinfer.report.html import embedded_image, escape, facts, paragraph, section, shrink, sortable_table
from fsinfer.report.stem_map import stem_map
from fsinfer.report.tree_photos import TreePhoto, tree_photos

KINDS = ("ok", "doubtful", "unmeasured")
STATUS_WORDS = {"ok": "measured", "doubtful": "doubtful", "unmeasured": "no diameter"}
# The page stays below 15 MB: of many trees each gets fewer and smaller pictures.
MAX_PHOTOS = 180
PHOTOS_PER_TREE = 3
MANY_TREES = 90


def table_section(contents: Contents) -> str:
    """Return the table of all trees; a column's head sorts, a tree's number shows its card."""
    if contents.trees is None:
        return section("Tree table", paragraph("trees.csv is not in this folder.", "missing"), anchor="trees")
    if not contents.trees:
        why = str(contents.plot.get("diagnosis") or "The table of trees is empty.")
        return section("Tree table", paragraph("No trees were found."), paragraph(why), anchor="trees")
    unit = "m" if contents.metric else "units"
    columns: tuple[tuple[str, str, str], ...] = (
        ("Tree", "tree_id", "{:.0f}"),
        ("DBH (cm)", "dbh_cm", "{:.1f}"),
        ("95 % interval (cm)", "", ""),
        ("Status", "status", ""),
        ("Seen all round (%)", "arc_coverage", "{:.0%}"),
        ("DBH by tape (cm)", "dbh_perimeter_cm", "{:.1f}"),
        ("Unevenness (cm)", "residual_cm", "{:.2f}"),
        ("Points", "points", "{:.0f}"),
        ("Lean (°)", "lean_deg", "{:.1f}"),
        ("Height (m)", "height_m", "{:.1f}"),
        (f"x ({unit})", "x_m", "{:.2f}"),
        (f"y ({unit})", "y_m", "{:.2f}"),
    )
    # A column without a single value only takes room.
    columns = tuple(
        c for c in columns if c[1] in ("", "status") or any(number(t.get(c[1])) is not None for t in contents.trees)
    )
    rows = []
    for tree in contents.trees:
        cells = []
        for _, name, form in columns:
            if name == "status":
                cells.append((STATUS_WORDS.get(tree.get("status", ""), tree.get("status", "")), tree.get("status", "")))
            elif name:
                value = number(tree.get(name))
                cells.append(("" if value is None else form.format(value), "" if value is None else repr(value)))
            else:
                cells.append(_interval(tree))
        rows.append([*cells, (tree.get("reason", ""), tree.get("reason", ""))])
    kinds = [tree["status"] if tree.get("status") in KINDS else "ok" for tree in contents.trees]
    ids = [tree_number(tree) for tree in contents.trees]
    return section(
        "Tree table",
        paragraph(
            "Choose a heading to sort, a number to see the tree. An empty DBH was not measured; the remark says why.",
            "note screen",
        ),
        sortable_table([*(head for head, _, _ in columns), "Remark"], rows, kinds, ids=ids, label="Trees of the plot"),
        anchor="trees",
    )


def stems_section(contents: Contents) -> str:
    """Return the stem map and the card of every tree: diameter, photos that see it, its section at breast height."""
    trees = [(i, tree) for tree in contents.trees or () if (i := tree_number(tree)) is not None]
    if not trees:
        return ""
    photos, why = _photos(contents, len(trees))
    cards = "".join(_card(contents, tree_id, tree, photos, small=len(trees) > MANY_TREES) for tree_id, tree in trees)
    options = "".join(f'<option value="{i}">Tree {i}</option>' for i, _ in trees)
    steps = (
        '<div class="steps"><button type="button" data-step="-1" aria-label="Previous tree">‹ Previous</button>'
        f'<select id="choose-tree" aria-label="Show tree">{options}</select>'
        '<button type="button" data-step="1" aria-label="Next tree">Next ›</button></div>'
    )
    told = paragraph(
        "Choose a tree on the map: its card shows how it was measured and which photos see it.", "note screen"
    )
    if why:
        told += paragraph(why, "missing")
    return section(
        "Stem map and trees",
        told,
        f'<div class="stems">{stem_map(contents)}<div>{steps}<p class="said" role="status"></p>{cards}</div></div>',
        anchor="stems",
    )


def _photos(contents: Contents, trees: int) -> tuple[dict[int, list[TreePhoto]], str]:
    per_tree = min(max(MAX_PHOTOS // trees, 1), PHOTOS_PER_TREE)
    return tree_photos(contents, per_tree=per_tree, height_px=480 if trees <= MANY_TREES else 330)


def _card(
    contents: Contents,
    tree_id: int,
    tree: Mapping[str, str],
    photos: Mapping[int, Sequence[TreePhoto]],
    *,
    small: bool,
) -> str:
    status = tree.get("status", "")
    kind = status if status in KINDS else "ok"
    dbh_cm = number(tree.get("dbh_cm"))
    interval, _ = _interval(tree)
    shown = "DBH not measured" if dbh_cm is None else f"DBH {dbh_cm:.1f} cm"
    head = (
        f'<h3>Tree {tree_id} <span class="status {kind}">{escape(STATUS_WORDS[kind])}</span></h3>'
        f'<div class="dbh">{escape(shown)}</div>'
    )
    if interval:
        head += paragraph(f"95 % interval: {interval} cm", "note")
    if tree.get("reason"):
        head += paragraph(tree["reason"], "reason")
    pictures = "".join(
        embedded_image(
            photo.image,
            f"{photo.name}, {photo.distance_m:.1f} {'m' if contents.metric else 'm (guessed)'} away",
            suffix=".webp",
            alt=f"Tree {tree_id} in photo {photo.name}, with the line at breast height",
        )
        for photo in photos.get(tree_id, ())
    )
    if pictures:
        what = (
            "Orange: breast height, as wide as the measured stem." if dbh_cm is not None else "Orange: breast height."
        )
        pictures = f'<div class="photos">{pictures}</div>' + paragraph(what, "note")
    elif photos:
        guess = "" if contents.metric else " (its height is guessed: no scale is known)"
        pictures = paragraph(f"No photo shows this stem unhidden at breast height{guess}.", "note")
    button = (
        f'<p class="viewer"><button type="button" data-cloud="{tree_id}">Show tree {tree_id} in the cloud</button></p>'
    )
    folder = contents.out / "figures"
    section = f"Section of tree {tree_id} at breast height, from above"
    figure = _figure(folder / f"tree_{tree_id:03d}.png", section, small=small)
    edges = f"Edges of tree {tree_id} at breast height, found in the photos (green)"
    figure += _figure(folder / f"tree_{tree_id:03d}_edges.png", edges, small=small)
    return (
        f'<article class="card" id="tree-{tree_id}" data-tree="{tree_id}" aria-label="Tree {tree_id}">'
        f"{head}{pictures}{facts(_rows(tree, contents.metric))}{figure}{button}</article>"
    )


def _rows(tree: Mapping[str, str], metric: bool) -> list[tuple[str, str]]:
    unit = "m" if metric else "model units"
    rows = []
    for name, column, form in (
        ("DBH as a tape reads it", "dbh_perimeter_cm", "{:.1f} cm"),
        ("Seen of the stem's girth", "arc_coverage", "{:.0%}"),
        ("Points in the section", "points", "{:.0f}"),
        ("Unevenness of the section", "residual_cm", "{:.1f} cm"),
        ("Lean", "lean_deg", "{:.1f}°"),
        ("Height", "height_m", "{:.1f} m"),
    ):
        value = number(tree.get(column))
        if value is not None:
            rows.append((name, form.format(value)))
    least, most = number(tree.get("dbh_min_cm")), number(tree.get("dbh_max_cm"))
    if least is not None and most is not None:
        rows.insert(1, ("Least and greatest diameter", f"{least:.1f} and {most:.1f} cm"))
    x, y = number(tree.get("x_m")), number(tree.get("y_m"))
    if x is not None and y is not None:
        rows.append(("Position x, y", f"{x:.2f}, {y:.2f} {unit}"))
    return rows


def _figure(path: Path, caption: str, *, small: bool) -> str:
    if not path.is_file():
        return ""
    try:
        image = read_image(path)
    except FsinferError as error:
        return paragraph(f"{path.name} could not be read ({error}).", "missing")
    image = shrink(image, 420 if small else 620)
    return f'<div class="section">{embedded_image(image, caption, suffix=".webp")}</div>'


def _interval(tree: Mapping[str, str]) -> tuple[str, str]:
    low, high = number(tree.get("dbh_lo95_cm")), number(tree.get("dbh_hi95_cm"))
    if low is None or high is None:
        return "", ""
    # Sorted by its width: the surest tree first.
    return f"{low:.1f} to {high:.1f}", repr(high - low)

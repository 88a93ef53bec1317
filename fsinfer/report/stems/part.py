"""The map of the stems, and the card of every tree: diameter, photos that see it, its section at breast height."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from fsinfer.errors import FsinferError
from fsinfer.io.images import read_image
from fsinfer.processes import shared_out
from fsinfer.report.contents import Contents, number, tree_number
from fsinfer.report.page import Part
from fsinfer.report.picture import Picture, picture_of, shrink
from fsinfer.report.plot_border import where
from fsinfer.report.stems.photos import TreePhoto, tree_photos
from fsinfer.report.stems.row import STATUS_WORDS, interval_of, interval_text, remark_of, status_of
from fsinfer.report.stems.stem_map import MapView, stem_map

#: Photos of all trees and of one at most, and trees of which each gets fewer and smaller ones. Source: layout; the page
#: stays below 15 MB.
MAX_PHOTOS, PHOTOS_PER_TREE, MANY_TREES = 180, 3, 90
#: Trees that have pictures at most; of more the page would grow by 4 MB a hundred, and open no more. Source: layout;
#: the page stays below 15 MB.
MOST_PICTURED = 300
_ROWS = (
    ("DBH as a tape reads it", "dbh_perimeter_cm", "{:.1f} cm"),
    ("Seen of the stem's girth", "arc_coverage", "{:.0%}"),
    ("Points in the section", "points", "{:.0f}"),
    ("Unevenness of the section", "residual_cm", "{:.1f} cm"),
    ("Lean", "lean_deg", "{:.1f}°"),
    ("Height", "height_m", "{:.1f} m"),
)


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """A picture of ``figures/``, or why it cannot be shown."""

    picture: Picture | None
    missing: str = ""


@dataclass(frozen=True, kw_only=True)
class Card:
    """A tree.

    Attributes
    ----------
    status, status_words: CSS class, and what is shown of it.
    dbh, interval, reason: texts; the last two may be empty.
    photos, photo_note: crops, and what their line means or why there are none.
    facts: names and values.
    drawings: of its section and its edges.
    """

    tree_id: int
    status: str
    status_words: str
    dbh: str
    interval: str
    reason: str
    photos: tuple[Picture, ...]
    photo_note: str
    facts: tuple[tuple[str, str], ...]
    drawings: tuple[Drawing, ...]


@dataclass(frozen=True, kw_only=True)
class StemsView:
    """Map and cards; ``missing`` says why no tree has photos, where none has."""

    missing: str
    map: MapView | None
    cards: tuple[Card, ...]


def stems_part(contents: Contents) -> Part | None:
    """The map beside the card of the tree picked on it; None without a tree."""
    trees = [(i, tree) for tree in contents.trees or () if (i := tree_number(tree)) is not None]
    if not trees:
        return None
    small = len(trees) > MANY_TREES
    per_tree = min(max(MAX_PHOTOS // len(trees), 1), PHOTOS_PER_TREE)
    pictured = _pictured(trees)
    of_pictured = replace(contents, trees=[tree for tree_id, tree in trees if tree_id in pictured])
    photos, missing = tree_photos(of_pictured, per_tree=per_tree, height_px=330 if small else 480)
    # What is not shown is not looked for either: of three thousand trees that takes many minutes.
    asked = [tree_id for tree_id, _ in trees if tree_id in pictured]
    drawings = dict(zip(asked, shared_out(partial(_drawings, contents.out / "figures", small), asked), strict=True))
    cards = tuple(_card(contents, tree_id, tree, photos, drawings.get(tree_id)) for tree_id, tree in trees)
    view = StemsView(missing=missing, map=stem_map(contents), cards=cards)
    return Part(anchor="stems", title="Stem map and trees", view=view)


def _pictured(trees: Sequence[tuple[int, Mapping[str, str]]]) -> frozenset[int]:
    """Numbers of the trees whose cards have pictures: all, or of too many those that ask to be looked at, then the
    first.
    """
    by_need = sorted(trees, key=lambda numbered: status_of(numbered[1]) != "doubtful")
    return frozenset(tree_id for tree_id, _ in by_need[:MOST_PICTURED])


def _card(
    contents: Contents,
    tree_id: int,
    tree: Mapping[str, str],
    photos: Mapping[int, Sequence[TreePhoto]],
    drawings: tuple[Drawing, ...] | None,
) -> Card:
    """The card of a tree; without ``drawings`` (None) it is one of too many to have pictures."""
    status, dbh_cm, interval_cm = status_of(tree), number(tree.get("dbh_cm")), interval_of(tree)
    pictures = tuple(_crop(photo, tree_id, metric=contents.metric) for photo in photos.get(tree_id, ()))
    photo_note = ""
    if drawings is None:
        photo_note = f"This page has pictures of {MOST_PICTURED} trees only, of the doubtful ones first."
        section = _section_file(contents.out / "figures", tree_id)
        if section.is_file():
            photo_note += f" The section of this tree is {section.parent.name}/{section.name}."
    elif pictures:
        photo_note = "Orange: breast height" + (", as wide as the measured stem." if dbh_cm is not None else ".")
    elif photos:
        guess = "" if contents.metric else " (its height is guessed: no scale is known)"
        photo_note = f"No photo shows this stem unhidden and in its whole width at breast height{guess}."
    return Card(
        tree_id=tree_id,
        status=status,
        status_words=STATUS_WORDS[status],
        dbh="DBH not measured" if dbh_cm is None else f"DBH {dbh_cm:.1f} cm",
        interval="" if interval_cm is None else interval_text(interval_cm),
        reason=remark_of(tree),
        photos=pictures,
        photo_note=photo_note,
        facts=tuple(_facts(tree, "m" if contents.metric else "model units")),
        drawings=drawings or (),
    )


def _crop(photo: TreePhoto, tree_id: int, *, metric: bool) -> Picture:
    caption = f"{photo.name}, {photo.distance_m:.1f} {'m' if metric else 'm (guessed)'} away"
    alt = f"Tree {tree_id} in photo {photo.name}, with the line at breast height"
    return picture_of(photo.image, caption, alt=alt)


def _facts(tree: Mapping[str, str], unit: str) -> list[tuple[str, str]]:
    rows = []
    for name, column, form in _ROWS:
        value = number(tree.get(column))
        if value is not None:
            rows.append((name, form.format(value)))
    least, most = number(tree.get("dbh_min_cm")), number(tree.get("dbh_max_cm"))
    if least is not None and most is not None:
        rows.insert(1, ("Least and greatest diameter", f"{least:.1f} and {most:.1f} cm"))
    x, y = number(tree.get("x_m")), number(tree.get("y_m"))
    if x is not None and y is not None:
        rows.append(("Position x, y", f"{x:.2f}, {y:.2f} {unit}"))
    if where(tree):
        rows.append(("In the plot", where(tree)))
    return rows


def _drawings(folder: Path, small: bool, tree_id: int) -> tuple[Drawing, ...]:
    """Those of a tree that are there: its section and its edges."""
    section = f"Section of tree {tree_id} at breast height, from above"
    edges = f"Edges of tree {tree_id} at breast height, found in the photos (green)"
    drawings = (
        _drawing(_section_file(folder, tree_id), section, small=small),
        _drawing(folder / f"tree_{tree_id:03d}_edges.png", edges, small=small),
    )
    return tuple(drawing for drawing in drawings if drawing is not None)


def _section_file(folder: Path, tree_id: int) -> Path:
    return folder / f"tree_{tree_id:03d}.png"


def _drawing(path: Path, caption: str, *, small: bool) -> Drawing | None:
    if not path.is_file():
        return None
    try:
        image = read_image(path)
    except FsinferError as error:
        return Drawing(picture=None, missing=f"{path.name} could not be read ({error}).")
    return Drawing(picture=picture_of(shrink(image, 420 if small else 620), caption))

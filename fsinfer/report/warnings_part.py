"""What a forester should look out for before trusting the numbers: the first thing in the report."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from fsinfer.notices.capture import CaptureCode
from fsinfer.notices.stems import StemCode
from fsinfer.report.contents import Contents, number, tree_number
from fsinfer.report.page import Part
from fsinfer.report.plot_border import CHANGED_TABLE
from fsinfer.report.stand_figures import is_changed

NO_SCALE = (
    "No scale is known: all lengths, positions and densities are in model units, not metres, and no DBH is given. "
    "Is something of known length in the photos? Click its two ends with fsinfer scale OUT --click --length-m (its "
    "length). Before new photos put up boards printed by fsinfer marker, or markers of your own and give "
    "--aruco-length-m."
)
# Warnings of stages that NO_SCALE says in other words. That markers of unknown length were seen is another one, and why
# those that were asked for gave no scale: who gave --aruco-length-m must not only be told to give it.
NO_SCALE_CODES = frozenset({CaptureCode.no_scale_given.value, StemCode.model_units.value})
#: Below this share of the photos registered, parts of the plot are likely to be missing. Source: judgement.
LEAST_PLACED = 0.8
#: Median difference between depth maps and tie points from which it is large. Source: field photos with good poses
#: have 0.1 to 0.4 %.
LARGE_DIFFERENCE = 0.01
#: A scale less certain than this is said to be. Source: it adds 0.3 cm and more to a stem of 30 cm.
LARGE_SCALE_STD = 0.01
#: The reasons of more trees than these are left to their cards. Source: layout.
MOST_REASONS = 3
#: Less of the girth than this was seen from one side only. Source: judgement; a side is half of it.
ONE_SIDE = 0.45
#: Trees that a warning links to; the others have it in their row of the table. Source: layout; the doubtful ones of a
#: hectare would fill screens.
MOST_NAMED = 60


@dataclass(frozen=True, kw_only=True)
class TreesWarning:
    """A warning about ``trees`` (their numbers): links to the cards of the first, then text."""

    trees: tuple[int, ...]
    text: str

    @property
    def named(self) -> tuple[int, ...]:
        """Those that it links to."""
        return self.trees[:MOST_NAMED]


@dataclass(frozen=True, kw_only=True)
class PartApart:
    """A part of the walk and what is said of it; its report is at ``link``, relative to this one, empty for none."""

    link: str
    text: str


@dataclass(frozen=True, kw_only=True)
class WarningsView:
    """What the section shows.

    Attributes
    ----------
    alarm: that there is no scale; empty where there is one.
    sentences, trees: warnings of the plot, and of its trees.
    parts: of the walk, measured apart.
    remarks: sentences that ask for nothing.
    known: False where there is no ``plot.json``.
    """

    alarm: str
    sentences: tuple[str, ...]
    trees: tuple[TreesWarning, ...]
    parts: tuple[PartApart, ...]
    remarks: tuple[str, ...]
    known: bool


def warnings_part(contents: Contents) -> Part:
    """Scale alarm and warnings in plain words, each with what to do about it; below them mere remarks."""
    plot = contents.plot
    alarm = NO_SCALE if plot and not contents.metric else ""
    said = [warning for warning in contents.warnings if not (alarm and warning.code in NO_SCALE_CODES)]
    texts = [warning.text for warning in said if not warning.remark]
    if plot.get("diagnosis") and not contents.trees:
        texts.append(str(plot["diagnosis"]))
    texts += _measurement_warnings(contents)
    texts += contents.notes
    view = WarningsView(
        alarm=alarm,
        # The diagnosis may be a warning of its stage, too.
        sentences=tuple(_sentence(text) for text in dict.fromkeys(texts)),
        trees=tuple(_tree_warnings(contents)),
        parts=tuple(_parts_apart(contents)),
        remarks=tuple(_sentence(warning.text) for warning in said if warning.remark),
        known=bool(plot),
    )
    return Part(anchor="warnings", title="What to look out for", view=view)


def _parts_apart(contents: Contents) -> Iterator[PartApart]:
    for part in contents.parts:
        folder = str(part.get("folder", ""))
        # What a file says becomes a link: only what this program writes.
        if re.fullmatch(r"part-[0-9]+", folder):
            photos, trees, measured = (part.get(name) for name in ("photos", "trees", "trees_with_dbh"))
            text = f"{photos} photos that nothing ties to the rest "
            joined = part.get("joined")
            if isinstance(joined, dict):
                text = (
                    f"{photos} photos that share nothing with the rest were measured by themselves and put into this "
                    f"plot by the pattern of their stems: {joined.get('common')} that the rest saw too, and "
                    f"{joined.get('new')} new ones."
                )
            elif part.get("error"):
                text += f"could not be measured: {part['error']}"
            else:
                text += (
                    f"were measured on their own scale: {trees} {'tree' if trees == 1 else 'trees'}, "
                    f"{measured} with a DBH, in a frame of their own. Trees that both see are in both reports."
                )
            # What lies in the folder of one that failed is of an earlier run, and may be of other photos.
            link = "" if part.get("error") else f"{folder}/report.html"
            yield PartApart(link=link, text=_sentence(text))


def _measurement_warnings(contents: Contents) -> list[str]:
    plot, texts = contents.plot, [f"{CHANGED_TABLE}."] if is_changed(contents) else []
    photos, registered = number(plot.get("photos")), contents.registered
    if photos and registered is not None and registered < LEAST_PLACED * photos:
        texts.append(
            f"Only {registered:.0f} of {photos:.0f} photos could be placed: parts of the plot may be missing. Take "
            "more photos with more overlap, walking slowly."
        )
    difference = number(plot.get("depth_vs_sfm_median_rel"))
    if difference is not None and difference > LARGE_DIFFERENCE:
        texts.append(
            f"The depth maps differ from the tie points of the photos by {100 * difference:.1f} % (median); below 1 % "
            "is usual. Treat the diameters with care."
        )
    spread = number(plot.get("scale_rel_std"))
    if contents.metric and spread is not None and spread > LARGE_SCALE_STD:
        texts.append(
            f"The scale is only known to ± {100 * spread:.1f} %: a stem of 30 cm may be {30 * 1.96 * spread:.1f} cm "
            f"thicker or thinner for that alone. {_better_scale(plot)}"
        )
    return texts


def _better_scale(plot: Mapping[str, object]) -> str:
    if plot.get("scale_source") == "endpoints":
        return "Boards are better (fsinfer marker), or the two ends of something longer."
    return "Put up more markers, and photograph each from several places."


def _tree_warnings(contents: Contents) -> list[TreesWarning]:
    """One sentence for each kind of tree that asks for a second visit."""
    trees = [(i, tree) for tree in contents.trees or () if (i := tree_number(tree)) is not None]
    doubtful = tuple(i for i, tree in trees if tree.get("status") == "doubtful")
    missing = [(i, tree.get("reason", "")) for i, tree in trees if tree.get("status") == "unmeasured"]
    one_side = tuple(
        i
        for i, tree in trees
        if tree.get("status") == "ok" and (share := number(tree.get("arc_coverage"))) is not None and share < ONE_SIDE
    )
    items = []
    if doubtful:
        verb = "is" if len(doubtful) == 1 else "are"
        text = f"{verb} doubtful: look at the card, and check with a tape before you use the diameter."
        items.append(TreesWarning(trees=doubtful, text=text))
    if missing and contents.metric:
        items.append(_without_diameter(missing, contents))
    if one_side:
        text = (
            f"{'was' if len(one_side) == 1 else 'were'} seen from one side only (less than {100 * ONE_SIDE:.0f} % of "
            "the girth): the diameter holds if the stem is round."
        )
        items.append(TreesWarning(trees=one_side, text=text))
    return items


def _without_diameter(missing: Sequence[tuple[int, str]], contents: Contents) -> TreesWarning:
    """``missing``: number and reason of each tree without a diameter."""
    trees, reasons = tuple(i for i, _ in missing), [reason for _, reason in missing]
    shown = len(missing) <= MOST_REASONS and all(reasons)
    text = "has no diameter" if len(missing) == 1 else "have no diameter"
    text += f": {'; '.join(reasons)}." if shown else "; the card says why."
    # Where a reason that is shown says it already, not twice; and three to six metres are those of photographs.
    if contents.photographed and not (shown and contents.revisit_advised.intersection(trees)):
        text += " Mostly it helps to walk round the stem again, within three to six metres."
    return TreesWarning(trees=trees, text=text)


def _sentence(text: str) -> str:
    """A warning of a stage as a sentence: those are written without a capital and a full stop, for the terminal."""
    text = text.strip()
    # A file's name stays as it is.
    head = text[:1] if "." in text.split(" ", 1)[0] else text[:1].upper()
    return head + text[1:] + ("" if text.endswith((".", "!", "?")) else ".")

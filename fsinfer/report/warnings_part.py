"""What a forester should look out for before trusting the numbers: the first thing in the report."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from fsinfer.report.contents import Contents, number, tree_number
from fsinfer.report.html import bullets, escape, paragraph, section

NO_SCALE = (
    "No scale is known: all lengths, positions and densities are in model units, not metres, and no DBH is given. "
    "Photograph a marker of known size and run again with --aruco-length-m, or give --endpoints with --length-m."
)
# Below this share of the photos placed, parts of the plot are likely to be missing.
LEAST_PLACED = 0.8
# Median difference between depth maps and tie points; field photos with good poses have 0.1 to 0.4 %.
LARGE_DIFFERENCE = 0.01
# A scale less certain than this adds 0.3 cm and more to a stem of 30 cm.
LARGE_SCALE_STD = 0.01
# The reasons of more trees than these are left to their cards.
MOST_REASONS = 3
# Less of the girth than this was seen from one side only.
ONE_SIDE = 0.45
# Said by a stage, of use to those who look closely, but nothing to act upon.
_REMARKS = re.compile(
    r"error of a scale given as a number|points far outside the plot|no finite coordinates|"
    r"was taken for the post of a marker|corrected by hand"
)


def warnings_section(contents: Contents) -> str:
    """Return scale alarm and warnings in plain words, each with what to do about it; below them mere remarks."""
    plot = contents.plot
    parts = []
    if plot and not contents.metric:
        parts.append(paragraph(NO_SCALE, "alarm"))
    given = plot.get("warnings")
    said = [str(text) for text in given] if isinstance(given, list) else [str(given)] if given else []
    if parts:
        # The alarm above says it already, unless markers were seen.
        said = [text for text in said if not text.startswith("no scale") or "markers are seen" in text]
    remarks = [text for text in said if _REMARKS.search(text)]
    texts = [text for text in said if text not in remarks]
    diagnosis = plot.get("diagnosis")
    if diagnosis and diagnosis not in texts and not (contents.trees or []):
        texts.append(str(diagnosis))
    texts += _measurement_warnings(contents)
    texts += contents.notes
    items = [escape(_sentence(text)) for text in texts] + _tree_warnings(contents)
    if items:
        parts.append(f'<ul class="warnings">{"".join(f"<li>{item}</li>" for item in items)}</ul>')
    elif not parts:
        known = "Nothing: photos, scale and stems are as they should be."
        parts.append(
            paragraph(known, "well")
            if plot
            else paragraph("plot.json is not in this folder, so nothing is known.", "note")
        )
    if remarks:
        parts.append(f"<details><summary>Remarks</summary>{bullets(map(_sentence, remarks))}</details>")
    return section("What to look out for", *parts, anchor="warnings")


def _measurement_warnings(contents: Contents) -> list[str]:
    plot, texts = contents.plot, []
    photos, registered = number(plot.get("photos")), number(plot.get("registered"))
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


def _tree_warnings(contents: Contents) -> list[str]:
    """One sentence (HTML with links to the cards) for each kind of tree that asks for a second visit."""
    trees = [(i, tree) for tree in contents.trees or () if (i := tree_number(tree)) is not None]
    doubtful = [i for i, tree in trees if tree.get("status") == "doubtful"]
    missing = [i for i, tree in trees if tree.get("status") == "unmeasured"]
    reasons = [escape(tree["reason"]) for _, tree in trees if tree.get("status") == "unmeasured" and tree.get("reason")]
    one_side = [
        i
        for i, tree in trees
        if tree.get("status") == "ok" and (share := number(tree.get("arc_coverage"))) is not None and share < ONE_SIDE
    ]
    items = []
    if doubtful:
        items.append(
            f"{_trees(doubtful)} {'is' if len(doubtful) == 1 else 'are'} doubtful: look at the card, and check with "
            "a tape before you use the diameter."
        )
    if missing and contents.metric:
        shown = reasons if len(reasons) == len(missing) <= MOST_REASONS else []
        why = ": " + "; ".join(shown) if shown else "; the card says why"
        text = f"{_trees(missing)} {'has' if len(missing) == 1 else 'have'} no diameter{why}."
        # Where a reason says it already, not twice.
        if not any("walk round" in reason for reason in shown):
            text += " Mostly it helps to walk round the stem again, within three to six metres."
        items.append(text)
    if one_side:
        items.append(
            f"{_trees(one_side)} {'was' if len(one_side) == 1 else 'were'} seen from one side only (less than "
            f"{100 * ONE_SIDE:.0f} % of the girth): the diameter holds if the stem is round."
        )
    return items


def _trees(ids: Sequence[int]) -> str:
    links = [f'<a href="#tree-{i}" data-card="{i}">{i}</a>' for i in ids]
    if len(links) == 1:
        return f"Tree {links[0]}"
    return f"Trees {', '.join(links[:-1])} and {links[-1]}"


def _sentence(text: str) -> str:
    """A warning of a stage as a sentence: those are written without a capital and a full stop, for the terminal."""
    text = text.strip()
    # A file's name stays as it is.
    head = text[:1] if "." in text.split(" ", 1)[0] else text[:1].upper()
    return head + text[1:] + ("" if text.endswith((".", "!", "?")) else ".")

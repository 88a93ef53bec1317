"""What the check found, in sentences for the person who still stands in the forest."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fsinfer.check.compass import Compass
from fsinfer.check.coverage import StemCoverage
from fsinfer.check.open_sides import OpenSide
from fsinfer.check.settings import CoverageSettings
from fsinfer.notices.numbers import counted
from fsinfer.scale.aruco import GOOD_SIGHTINGS
from fsinfer.scale.doubts import by_board, number_of_boards
from fsinfer.scale.scale import MarkerScale, RejectedMarker, Scale

#: Photos in directions so near to the middle of the unseen side are named as places to stand. Source: judgement.
_PLACE_DEG = 20.0
#: A board is measured well with sides of so many pixels. Source: 0.07 px of both edges is 0.35 % of 40.
_BOARD_SIDE_PX = 40.0
#: Photos missing beyond this share are a part of the walk, not a few blurred ones. Source: judgement.
_TORN_SHARE = 0.15
#: Gaps of the walk that are named at most. Source: layout.
_MOST_GAPS = 10


def advice(
    *,
    names: Sequence[str],
    left_out: Sequence[str],
    given: Sequence[str],
    stems: Sequence[StemCoverage],
    compass: Compass,
    offsets_m: Sequence[NDArray[np.float64]],
    sides: Sequence[OpenSide] = (),
    far_m: float = CoverageSettings.far_m,
) -> list[str]:
    """Sentences, what matters most first; empty when nothing has to be done again.

    Parameters
    ----------
    names: of the placed photos in the order of walking; ``left_out``: of the others; ``given``: of all, in order.
    offsets_m: for each stem, (P, 2) plan positions of the placed photos from it.
    sides: along which no photo was placed.
    far_m: photos farther than this from a stem show little of it.
    """
    lines = _gaps_of_the_walk(given, set(left_out))
    if len(left_out) > _TORN_SHARE * len(given):
        lines.append(
            f"{len(left_out)} of {len(given)} photos are missing so: mend the walk first, check again. The trees are "
            "judged without them, and some may be named that they saw."
        )
    lines += _sides_left_open(names, stems, sides)
    lines += _all_beside(stems)
    for entry, offsets in zip(stems, offsets_m, strict=True):
        if entry.verdict == "one side":
            side = compass.side(entry.gap_center_deg)
            lines.append(
                f"Walk round tree {entry.number} again, from {side}: it was seen from one side only"
                f"{_from_far(entry, offsets, far_m)} ({_place(entry, names, offsets)})."
            )
    for entry in stems:
        if entry.verdict == "hardly seen":
            many = len(entry.views)
            # Of a stem that no photo shows every side is missing, and none more than another.
            side = f", above all from {compass.side(entry.gap_center_deg)}" if many and entry.one_sided else ""
            shows = f"only {counted(many, 'photo shows', 'photos show')} it" if many else "no photo shows it unhidden"
            lines.append(
                f"Photograph tree {entry.number} again from nearer, all round{side}: {shows} "
                f"(nearest photo {names[entry.nearest]})."
            )
    far = [str(entry.number) for entry in stems if entry.verdict == "far"]
    if far:
        lines.append(f"Seen all round, but from far: {_trees(far)}. Pass at 3 to 6 m if their diameter matters to you.")
    return lines


def _place(entry: StemCoverage, names: Sequence[str], offsets_m: NDArray[np.float64]) -> str:
    """Where that is in the walk: nearest photo, and the nearest of those on the missing side if there is one."""
    text = f"the tree near photo {names[entry.nearest]}"
    azimuths = np.degrees(np.arctan2(offsets_m[:, 1], offsets_m[:, 0]))
    there = np.abs((azimuths - entry.gap_center_deg + 180) % 360 - 180) < _PLACE_DEG
    if not there.any():
        return text
    nearest = int(np.where(there, np.linalg.norm(offsets_m, axis=1), np.inf).argmin())
    return f"{text}; the missing side faces the place of photo {names[nearest]}"


def _from_far(entry: StemCoverage, offsets_m: NDArray[np.float64], far_m: float) -> str:
    """Added where photos do stand on the missing side, but all of them too far away."""
    azimuths = np.degrees(np.arctan2(offsets_m[:, 1], offsets_m[:, 0]))
    there = np.abs((azimuths - entry.gap_center_deg + 180) % 360 - 180) < entry.gap_deg / 2 - _PLACE_DEG
    if not there.any() or np.linalg.norm(offsets_m[there], axis=1).min() < far_m:
        return ""
    return f", or from more than {far_m:g} m"


def _sides_left_open(names: Sequence[str], stems: Sequence[StemCoverage], sides: Sequence[OpenSide]) -> list[str]:
    """One sentence for each side along which no photo stands."""
    lines = []
    for side in sides:
        there = [
            str(entry.number) for entry in stems if entry.verdict == "beyond" and side.beyond(entry.stem.center)[0]
        ]
        first, last = (names[photo] for photo in side.photos)
        which = f"{_trees(there)} beyond it, seen from one side only," if there else "trees beyond it"
        lines.append(
            f"Between the places of photos {first} and {last} no photo was placed for {side.length_m:.0f} m. Walk "
            f"there if {which} belong{'s' if len(there) == 1 else ''} to your plot."
        )
    return lines


def _all_beside(stems: Sequence[StemCoverage]) -> list[str]:
    """One sentence where the walk went round no stem at all: nothing was judged, and nothing is not all good."""
    if any(entry.inside for entry in stems):
        return []
    count = sum(entry.verdict == "outside" and entry.one_sided for entry in stems)
    if not count:
        return []
    were = counted(count, "stem beside it was", "stems beside it were")
    return [
        f"No stem stands within your walk, and {were} seen from one side only. Walk round those that belong to "
        "your plot."
    ]


def _trees(numbers: Sequence[str]) -> str:
    return f"trees {', '.join(numbers)}" if len(numbers) > 1 else f"tree {numbers[0]}"


def _gaps_of_the_walk(given: Sequence[str], left_out: set[str]) -> list[str]:
    """One sentence for each run of photos that could not be placed."""
    runs: list[list[str]] = []
    ranks = [rank for rank, name in enumerate(given) if name in left_out]
    for before, rank in pairwise([-2, *ranks]):
        if rank != before + 1:
            runs.append([])
        runs[-1].append(given[rank])
    lines = []
    for run in sorted(runs, key=len, reverse=True)[:_MOST_GAPS]:
        which = f"Photos {run[0]} to {run[-1]} ({len(run)})" if len(run) > 1 else f"Photo {run[0]}"
        again = "walk this stretch again, slower, with two thirds of each photo in the next"
        single = "its neighbours make up for it if no tree is named here"
        lines.append(f"{which} did not join the others: {again if len(run) > 1 else single}.")
    return lines


def _as_seen(markers: Sequence[MarkerScale]) -> list[list[MarkerScale]]:
    """The markers by their order, with those of one number that are one board at several places of a walk together."""
    of_board = {id(marker): (index, marker.id) for index, group in enumerate(by_board(markers)) for marker in group}
    seen: dict[tuple[int, int], list[MarkerScale]] = {}
    for marker in markers:
        seen.setdefault(of_board[id(marker)], []).append(marker)
    return list(seen.values())


def marker_lines(
    scale: Scale, rejected: Sequence[RejectedMarker] = (), *, given: bool, elsewhere: bool = False
) -> list[str]:
    """How well each board was seen, and what to do about it.

    Parameters
    ----------
    scale: by the boards, whatever their length. rejected: those that were seen where there is no such scale.
    given: whether their length is known. elsewhere: whether something else gives the scale.
    """
    found = scale.markers
    lines = []
    for places in _as_seen(found):
        number, views = places[0].id, len({view for place in places for view in place.views})
        enough = [place.near_side_px for place in places if len(place.views) >= GOOD_SIGHTINGS]
        side_px = max(enough) if enough else min(place.near_side_px for place in places)
        good = views >= GOOD_SIGHTINGS and side_px >= _BOARD_SIDE_PX
        hint = "good" if good else "pass it again at 2 to 3 m, facing it, for five sharp photos"
        # One sharp photo from near by does not make five: what is told is what five of them have.
        where = "the five nearest" if views > GOOD_SIGHTINGS else "all of them" if views > 1 else "it"
        lines.append(
            f"Board {number}: in {counted(views, 'photo', 'photos')}, in {where} its side is at least "
            f"{side_px:.0f} pixels: {hint}."
        )
    reasons: dict[int, list[str]] = {}
    for marker in (*scale.rejected, *rejected):
        reasons.setdefault(marker.id, []).append(marker.reason)
    for number in (number for number in reasons if number not in {entry.id for entry in found}):
        why = "; ".join(reasons[number])
        lines.append(f"Board {number} cannot be used ({why}): pass it again at 2 to 3 m, facing it.")
    if not found and not elsewhere:
        lines.append(
            "No board can be used: no diameter is measured, unless something else of known length is in the photos, "
            "whose two ends you click later (fsinfer scale OUT --click --length-m)."
        )
    elif found and (boards := number_of_boards(found)) < 3:
        lines.append(f"{counted(boards, 'board', 'boards')}: three or more, spread out, show a wrong one.")
    if found and not given:
        lines.append("The boards do not tell their length: give --aruco-length-m to fsinfer run.")
    return lines

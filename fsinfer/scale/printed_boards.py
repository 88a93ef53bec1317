"""Boards that carry their own length: which marker numbers ``fsinfer marker`` prints at which size.

A number of the dictionary 4X4_50 from 20 on means a size, so that a folder of photographs with these boards needs no
scale option:

======  =====================================  ==================
number  side of the black square               fits on
======  =====================================  ==================
0-19    nothing: anybody's boards              --aruco-length-m
20-29   0.150 m                                A4, Letter
30-39   0.200 m                                A3
40-49   0.250 m                                A3
======  =====================================  ==================

Numbers below 20 mean nothing on purpose: they are what people print first when they make boards of their own.
"""

from __future__ import annotations

from enum import StrEnum

from fsinfer.errors import InputError

#: The only dictionary whose numbers mean a size. Source: OpenCV; 4x4 modules are seen from farthest.
DICTIONARY = "4X4_50"
#: Dictionaries that begin with its markers: who looks for those finds these under the same number. Source: OpenCV.
SAME_MARKERS = (DICTIONARY, "4X4_100", "4X4_250", "4X4_1000")
#: First number, number after the last, side of the black square in metres. Source: format; what fits on A4, Letter
#: and A3.
RANGES: tuple[tuple[int, int, float], ...] = ((20, 30, 0.150), (30, 40, 0.200), (40, 50, 0.250))
#: Lengths nearer than this are the same, metres. Source: numerics.
SAME_LENGTH_M = 1e-6
#: Boards that are printed where nobody says how many. Source: option; three or more show a wrong one.
BOARDS = 4


class Paper(StrEnum):
    """Paper of the boards."""

    a4 = "A4"
    a3 = "A3"
    letter = "Letter"


def board_lengths() -> dict[int, float]:
    """``{number: side in metres}`` of every number that means a size."""
    return {number: length_m for first, end, length_m in RANGES for number in range(first, end)}


def numbers_of_length(length_m: float, count: int) -> list[int]:
    """The first ``count`` numbers that mean ``length_m``; from 0 on, meaning nothing, for any other length.

    Raises
    ------
    InputError
        More boards than the dictionary has numbers for.
    """
    own = [number for number, meant_m in board_lengths().items() if abs(meant_m - length_m) < SAME_LENGTH_M]
    free = own or list(range(RANGES[0][0]))
    if not 1 <= count <= len(free):
        # A number at two places is what photos in a wrong place look like.
        told = ", ".join(f"{meant_m:g}" for _, _, meant_m in RANGES)
        msg = (
            f"{count} boards of {length_m:g} m: there are 1 to {len(free)} numbers for them, and each may hang in one "
            f"place only; print fewer, or give the others another length that fsinfer knows by the number ({told} m)"
        )
        raise InputError(msg)
    return free[:count]

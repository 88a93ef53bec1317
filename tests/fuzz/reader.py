"""What the fuzzer knows of a reader: how valid files of its kind are made, which of them are changed, and how."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

#: Changes the content of a file.
Mutator = Callable[[bytes, Random], bytes]


@dataclass(frozen=True, kw_only=True)
class Reader:
    """One reader of what a user can supply.

    Attributes
    ----------
    name: on the command line.
    what: in words, for the table.
    make: writes valid files into an empty folder.
    targets: patterns of the files that are changed, one a case.
    mutators: of which each case draws one.
    read: reads the folder; anything but a return or an error of fsinfer is a finding.
    mend: makes the rest of the folder agree with the changed file (hashes), so that deeper layers are reached.
    most_mb: memory that a case may take beside what its files are worth, MiB.
    """

    name: str
    what: str
    make: Callable[[Path], None]
    targets: tuple[str, ...]
    mutators: tuple[Mutator, ...]
    read: Callable[[Path], object]
    mend: Callable[[Path], None] | None = None
    most_mb: int = 256

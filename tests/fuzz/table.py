"""Tables of a document between two marks, of which a command writes the rows that it has measured anew."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.fuzz.__main__ import Tally


def put_rows(path: Path, mark: str, rows: Mapping[str, Sequence[str]]) -> None:
    """Write ``rows`` by their first cell into the table between ``<!-- MARK -->`` and ``<!-- /MARK -->``.

    Rows of the same name are replaced, others stay; the first two lines of the table are its head.

    Raises
    ------
    ValueError
        The document has no such marks.
    """
    text = path.read_text(encoding="utf-8")
    found = re.search(rf"<!-- {mark} -->\n(.*?)<!-- /{mark} -->", text, flags=re.DOTALL)
    if found is None:
        raise ValueError(f"{path} has no marks <!-- {mark} --> and <!-- /{mark} -->")
    lines = [line for line in found[1].splitlines() if line.startswith("|")]
    kept = {line.strip("| ").split(" | ")[0]: line for line in lines[2:]}
    kept |= {name: f"| {' | '.join([name, *cells])} |" for name, cells in rows.items()}
    table = "\n".join([*lines[:2], *kept.values()])
    path.write_text(text[: found.start(1)] + f"\n{table}\n\n" + text[found.end(1) :], encoding="utf-8")


def put_fuzz_rows(path: Path, tallies: Sequence[Tally]) -> None:
    """One row a reader: cases, how many were read all the same, seconds of the processor, and findings."""
    from tests.fuzz.catalogue import READERS

    rows = {
        READERS[tally.name].what: (
            f"`{tally.name}`", f"{tally.cases:,}", f"{tally.read:,}", f"{tally.seconds:.0f}",
            str(sum(tally.findings.values())),
        )
        for tally in tallies
    }  # fmt: skip
    put_rows(path, "fuzz", rows)

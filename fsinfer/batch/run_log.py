"""``run.log`` in a plot's folder: all that its runs have said, and which line of it to show."""

from __future__ import annotations

from pathlib import Path

LOG_FILE = "run.log"
#: The end of a log that is looked through, bytes. Source: numerics.
_END_BYTES = 65536
#: Longest message that is shown, characters. Source: layout.
_LONGEST = 500
# What rich draws round a message of the command line.
_FRAME = "│|╭╮╰╯─ +-\t"


def last_words(log: Path, begins: int = 0) -> str:
    """The message with which a run ended, on one line: what is written behind byte ``begins``, from "Error" on."""
    try:
        with log.open("rb") as stream:
            size = stream.seek(0, 2)
            stream.seek(max(begins, size - _END_BYTES))
            lines = stream.read().decode("utf-8", errors="replace").splitlines()
    except OSError as error:
        return f"its log {log} cannot be read ({error.strerror or error})"
    plain = ("".join(c if c.isprintable() else " " for c in line) for line in lines)
    said = [" ".join(line.strip(_FRAME).split()) for line in plain]
    said = [line for line in said if line]
    found = [line for line in said if line.startswith(("Error: ", "Internal error"))]
    boxed = [said[at + 1] for at, line in enumerate(said[:-1]) if line == "Error"]
    chosen = (found or boxed or said or ["said nothing"])[-1].removeprefix("Error: ")
    return chosen if len(chosen) <= _LONGEST else chosen[: _LONGEST - 3] + "..."

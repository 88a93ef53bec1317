"""How a stage tells its caller how far it is: a callback, so that only the command line prints."""

from __future__ import annotations

from collections.abc import Callable

#: ``progress(done, total, what)``: ``done`` of ``total`` units of work are finished; ``what`` says which.
Progress = Callable[[int, int, str], None]


def silent(done: int, total: int, what: str) -> None:
    """Report nothing; the default of every stage."""


#: Gives the progress callback of a stage by its name.
StageProgress = Callable[[str], Progress]


def silent_stages(_stage: str) -> Progress:
    """Report nothing for any stage."""
    return silent

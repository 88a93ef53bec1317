"""What the command line shows: progress bars with the remaining time, results, errors; and the exit codes."""

from __future__ import annotations

import errno
import functools
import logging
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, ParamSpec

import typer

from fsinfer.cli.faults import how_to_report, keep_trace
from fsinfer.cli.remaining import RemainingTime, as_words
from fsinfer.errors import NOT_ENOUGH_MEMORY, FsinferError
from fsinfer.progress import Progress, silent

#: Source: format; what the shell is told.
EXIT_OUR_FAULT, EXIT_USER_ERROR, EXIT_INTERRUPTED = 1, 2, 130

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show no progress; results and errors still appear.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the full technical trace when something fails.")]

# Errors of the operating system that the user can do something about.
#: Memory that a run cannot go on without. Source: judgement; an array of a photograph.
_PROBE_BYTES = 1 << 24
# What OpenCV, COLMAP and the system say instead of a MemoryError.
_NO_MEMORY = (
    "Insufficient memory",
    "Failed to allocate",
    "std::bad_alloc",
    "Cannot allocate memory",
    "failed to map segment",
    "can't start new thread",
)
_USER_ERRNOS = frozenset({errno.ENOSPC, errno.EACCES, errno.EPERM, errno.EROFS, errno.EDQUOT})

#: Stage, counts, time, step, what is left: "poses     300/300 0:07:12 matching photos, about 12 min left in all".
#: Source: layout.
_WIDTH_OF_WORDS = 76
#: Letters of the bar, at least and at most. Source: layout.
_LEAST_BAR, _MOST_BAR = 4, 40

P = ParamSpec("P")


def reports_errors(command: Callable[P, None]) -> Callable[P, None]:
    """Decorate a command: whatever it raises becomes one message on stderr and an exit code."""

    @functools.wraps(command)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except typer.Exit:
            raise
        except KeyboardInterrupt as error:
            say("Stopped. What is finished is kept: run the same command again to go on.")
            raise typer.Exit(EXIT_INTERRUPTED) from error
        except Exception as error:
            if isinstance(error, OSError) and error.errno == errno.EPIPE:
                raise  # The reader of a pipe has gone (fsinfer ... | head); typer ends quietly.
            if kwargs.get("debug"):
                traceback.print_exc()
            out = kwargs.get("out")
            raise typer.Exit(tell(error, out if isinstance(out, Path) else None)) from error

    return wrapper


def tell(error: Exception, out: Path | None = None) -> int:
    """Show what went wrong and return the exit code; the trace of a fault of ours is kept, if possible in ``out``."""
    message, code = explain(error)
    say(message)
    if code == EXIT_OUR_FAULT:
        say(how_to_report(keep_trace(error, out), out))
    return code


def explain(error: Exception) -> tuple[str, int]:
    """Return the message for the user and the exit code that belong to an exception."""
    if isinstance(error, FsinferError):
        return f"Error: {_one_line(error)}", EXIT_USER_ERROR
    if isinstance(error, OSError):
        where = f": {error.filename}" if error.filename else ""
        if error.errno in _USER_ERRNOS:
            return f"Error: {error.strerror}{where}; free some space or choose another output folder", EXIT_USER_ERROR
        if error.errno == errno.ENAMETOOLONG:
            return f"Error: a name is too long for this disk{where}; give a shorter one", EXIT_USER_ERROR
    if isinstance(error, MemoryError) or any(word in str(error) for word in _NO_MEMORY) or _is_memory_out():
        hint = "close other programs, or give a smaller --max-size; what is finished is kept"
        return f"Error: {NOT_ENOUGH_MEMORY}; {hint}", EXIT_USER_ERROR
    what = f"{type(error).__name__}: {_one_line(error)}".rstrip(": ")
    return f"Internal error ({what}). This is a fault of fsinfer; --debug shows the details.", EXIT_OUR_FAULT


def _is_memory_out() -> bool:
    """Whether there is no memory now: then libraries fail in ways that name something else."""
    try:
        bytearray(_PROBE_BYTES)
    except MemoryError:
        return True
    return False


def say(message: str) -> None:
    """Show a message for people (stderr; results go to stdout)."""
    typer.echo(message, err=True)


def stop_on_signals() -> None:
    """Let whoever ends the program or closes its window stop it as Ctrl-C does."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


_warned: set[str] = set()


def warn(messages: Iterable[str]) -> None:
    """Show warnings, each once: some are logged while a stage runs and are part of its result as well."""
    for message in messages:
        if message not in _warned:
            _warned.add(message)
            say(f"Warning: {message}")


class _WarningLines(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        warn([record.getMessage()])


def show_library_warnings() -> None:
    """Show the warnings that the library logs as lines for people."""
    _warned.clear()
    logger = logging.getLogger("fsinfer")
    if not any(isinstance(handler, _WarningLines) for handler in logger.handlers):
        logger.addHandler(_WarningLines(level=logging.WARNING))


@contextmanager
def stage_progress(*, quiet: bool, whole: RemainingTime | None = None) -> Iterator[Callable[[str], Progress]]:
    """Yield a function that gives each stage, by its name, its progress callback.

    On a terminal each stage is a bar with the remaining time; otherwise one line when it begins and one when it ends.
    With ``whole`` both say how long the whole run will still take.
    """
    if quiet:
        yield lambda _stage: silent
    elif sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        console = Console(stderr=True)
        # What is left of the width after the numbers and the words, which matter more.
        bar = min(max(console.width - _WIDTH_OF_WORDS, _LEAST_BAR), _MOST_BAR)
        columns = (
            TextColumn("{task.fields[stage]:<7}"),
            BarColumn(bar_width=bar),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            *((TextColumn("left"), TimeRemainingColumn()) if whole is None else ()),
            TextColumn("{task.description}"),
        )
        with Bars(*columns, console=console) as bars:
            yield lambda stage: _bar(stage, bars.add_task("", stage=stage, total=None), bars.update, whole)
    else:
        yield lambda stage: _lines(stage, whole)


def _bar(stage: str, task: object, update: Callable[..., None], whole: RemainingTime | None) -> Progress:
    def report(done: int, total: int, what: str) -> None:
        # A stage with several passes shows the bar of the pass it is in.
        update(task, completed=done, total=total, description=what + _left(whole, stage, done, total, what))

    return report


def _lines(stage: str, whole: RemainingTime | None) -> Progress:
    start = time.monotonic()
    say(f"{stage} ...")
    finished: set[str] = set()

    def report(done: int, total: int, what: str) -> None:
        left = _left(whole, stage, done, total, what)
        if done >= total and what not in finished:
            finished.add(what)
            say(f"{stage}: {done}/{total} {what} ({time.monotonic() - start:.0f} s){left}")

    return report


def _left(whole: RemainingTime | None, stage: str, done: int, total: int, what: str) -> str:
    if whole is None:
        return ""
    whole.update(stage, done, total, what)
    seconds = whole.seconds()
    return "" if seconds is None or seconds < 1 else f", about {as_words(seconds)} left in all"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())

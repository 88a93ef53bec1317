"""The process that does what :class:`fsinfer.processes.Workers` tells it: a function, then items for it, one by one.

Messages are pickled both ways. To it: ``("import", names of modules)``, ``("work", function)`` and ``("item", item)``.
From it, for each item: ``(True, result)`` or ``(False, error)``. It ends when its standard input does.
"""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import IO, Any

from fsinfer.child_process import end_with_parent, leave_interrupts_to_parent, take_pipes


def main() -> None:
    """Do what comes in on standard input until that ends."""
    leave_interrupts_to_parent()
    heard, told = take_pipes()
    # Who starts it hears nothing until the first answer, so that nobody can wait for the other.
    with os.fdopen(heard, "rb") as messages, os.fdopen(told, "wb") as answers:
        parent = pickle.load(messages)
        end_with_parent(parent)
        with suppress(EOFError, OSError), ExitStack() as kept:
            _answer(messages, answers, kept)
    # Nothing is left to be put in order, and libraries that tidy up at the end may crash at it.
    os._exit(0)


def _answer(messages: IO[bytes], answers: IO[bytes], kept: ExitStack) -> None:
    work: Callable[[Any], Any] | None = None
    while True:
        kind, what = pickle.load(messages)
        if kind == "import":
            _import(what, kept)
        elif kind == "work":
            work = what
        else:
            answers.write(_pickled(_done(work, what)))
            answers.flush()


def _import(names: tuple[str, ...], kept: ExitStack) -> None:
    """Load modules, and hold the threads of libraries to one, for as many processes work as there are cores."""
    import importlib

    import cv2

    from fsinfer.threads import one_blas_thread

    for name in names:
        importlib.import_module(name)
    cv2.setNumThreads(1)
    kept.enter_context(one_blas_thread())


def _done(work: Callable[[Any], Any] | None, item: Any) -> tuple[bool, Any]:
    try:
        if work is None:
            msg = "an item came before the work"
            raise RuntimeError(msg)
        return True, work(item)
    except Exception as error:  # whatever it is, who asked gets it
        error.add_note("in a worker process:\n" + "".join(traceback.format_exception(error)))
        return False, error


def _pickled(answer: tuple[bool, Any]) -> bytes:
    try:
        told = pickle.dumps(answer, protocol=pickle.HIGHEST_PROTOCOL)
        if not answer[0]:
            pickle.loads(told)  # of an error with two words only one is sent, and nobody could read it
        return told
    except Exception as error:  # an error or a result of a kind that cannot be sent
        unsent = RuntimeError(f"a worker process cannot send {answer[1]!r}: {error}")
        return pickle.dumps((False, unsent), protocol=pickle.HIGHEST_PROTOCOL)


if __name__ == "__main__":
    sys.exit("this module is run by fsinfer.processes")

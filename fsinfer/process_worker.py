"""The process that does what :class:`fsinfer.processes.Workers` tells it: a function, then items for it, one by one.

Messages are pickled both ways, each behind eight bytes with its length. To it: ``("import", names of modules)``,
``("work", function)`` and ``("item", item)``. From it, for each item: :class:`Answer`, which has the result, the error
of the work, or why this process cannot do it. It ends when its standard input does.
"""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import IO, Any

from fsinfer.child_process import end_with_parent, leave_interrupts_to_parent, take_pipes

#: Bytes of a message's length. Source: format.
LENGTH_BYTES = 8


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Of one item: the result, or the error of the work, or why this process could not try it."""

    result: Any = None
    error: Exception | None = None
    unfit: str = ""


def main() -> None:
    """Do what comes in on standard input until that ends."""
    leave_interrupts_to_parent()
    heard, told = take_pipes()
    # Who starts it hears nothing until the first answer, so that nobody can wait for the other.
    with os.fdopen(heard, "rb") as messages, os.fdopen(told, "wb") as answers:
        end_with_parent(pickle.loads(receive(messages)))
        with suppress(EOFError, OSError), ExitStack() as kept:
            _answer(messages, answers, kept)
    # Nothing is left to be put in order, and libraries that tidy up at the end may crash at it.
    os._exit(0)


def send(stream: IO[bytes], message: bytes) -> None:
    """Write a message behind its length."""
    stream.write(len(message).to_bytes(LENGTH_BYTES, "little"))
    stream.write(message)
    stream.flush()


def receive(stream: IO[bytes]) -> bytes:
    """Read a message; :class:`EOFError` where the stream ends before it does."""
    length = int.from_bytes(_exactly(stream, LENGTH_BYTES), "little")
    return _exactly(stream, length)


def _exactly(stream: IO[bytes], count: int) -> bytes:
    found = stream.read(count)
    if len(found) < count:
        raise EOFError
    return found


def _answer(messages: IO[bytes], answers: IO[bytes], kept: ExitStack) -> None:
    work: Callable[[Any], Any] | None = None
    unfit = ""
    while True:
        message = receive(messages)
        try:
            kind, what = pickle.loads(message)
        except Exception as error:  # of a kind that is not known here
            unfit = unfit or f"it cannot read what it is told: {error!r}"
            kind, what = "item", None
        if kind == "import":
            try:
                _import(what, kept)
            except Exception as error:
                unfit = f"it cannot load {', '.join(what)}: {error!r}"
        elif kind == "work":
            work = what
        else:
            send(answers, _pickled(Answer(unfit=unfit) if unfit else _done(work, what)))


def _import(names: tuple[str, ...], kept: ExitStack) -> None:
    """Load modules, and hold the threads of libraries to one, for as many processes work as there are cores."""
    import importlib

    import cv2

    from fsinfer.threads import one_blas_thread

    for name in names:
        importlib.import_module(name)
    cv2.setNumThreads(1)
    kept.enter_context(one_blas_thread())


def _done(work: Callable[[Any], Any] | None, item: Any) -> Answer:
    try:
        if work is None:
            return Answer(unfit="it was told no work")
        return Answer(result=work(item))
    except Exception as error:  # whatever it is, who asked gets it
        error.add_note("in a worker process:\n" + "".join(traceback.format_exception(error)))
        return Answer(error=error)


def _pickled(answer: Answer) -> bytes:
    try:
        told = pickle.dumps(answer, protocol=pickle.HIGHEST_PROTOCOL)
        if answer.error is not None:
            pickle.loads(told)  # of an error with two words only one is sent, and nobody could read it
        return told
    except Exception as error:  # an error or a result of a kind that cannot be sent
        what = answer.result if answer.error is None else answer.error
        unsent = RuntimeError(f"a worker process cannot send {what!r}: {error}")
        return pickle.dumps(Answer(error=unsent), protocol=pickle.HIGHEST_PROTOCOL)


if __name__ == "__main__":
    sys.exit("this module is run by fsinfer.processes")

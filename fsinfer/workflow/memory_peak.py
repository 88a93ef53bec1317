"""The largest resident memory of this process over a stretch of work."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress
from pathlib import Path

from fsinfer.processes import ended_peak_mb, forget_ended, peak_of_mb, workers_peak_mb

_CLEAR_REFS = Path("/proc") / "self" / "clear_refs"


class MemoryPeak:
    """Starts watching when made; :meth:`read_mb` gives the peak since then.

    On Linux the kernel's high-water mark is reset at the start, so the figure belongs to the stretch. Elsewhere it
    is the peak of the whole process so far (macOS), or unknown (Windows). Of child processes the largest that told its
    peak (:func:`fsinfer.processes.child_ended`) is added, and those that work for it now
    (:func:`fsinfer.processes.workers_peak_mb`).
    """

    def __init__(self) -> None:
        forget_ended()
        try:
            # "5" resets VmHWM (proc(5)); without the right to, the figure is that of the whole process.
            _CLEAR_REFS.write_text("5", encoding="ascii")
        except OSError:
            return

    def read_mb(self) -> float | None:
        """Peak resident memory, MiB; None where the system does not tell."""
        own = peak_of_mb("self")
        if own is not None:
            return round(own + ended_peak_mb() + workers_peak_mb(), 1)
        if sys.platform == "win32":
            return None
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return round(peak / (1024 * 1024 if sys.platform == "darwin" else 1024) + ended_peak_mb(), 1)


def hand_back() -> None:
    """Give back to the system what the allocator keeps of an earlier stage's memory, where it can (GNU's C library).

    It keeps some hundred MiB in pieces after depth, which would lie beside all that fusion holds.
    """
    if sys.platform != "linux":
        return
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)

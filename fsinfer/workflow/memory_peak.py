"""The largest resident memory of this process over a stretch of work."""

from __future__ import annotations

import sys
from pathlib import Path

from fsinfer.processes import ended_peak_mb, forget_ended, peak_of_mb, workers_peak_mb

_CLEAR_REFS = Path("/proc") / "self" / "clear_refs"


class MemoryPeak:
    """Starts watching when made; :meth:`read_mb` gives the peak since then.

    On Linux the kernel's high-water mark is reset at the start, so the figure belongs to the stretch. Elsewhere it
    is the peak of the whole process so far (macOS), or unknown (Windows). What child processes told at their end
    (:func:`fsinfer.processes.child_ended`) counts with what this one held then, and those that work for it now are
    added (:func:`fsinfer.processes.workers_peak_mb`).
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
            return round(max(own + workers_peak_mb(), ended_peak_mb()), 1)
        if sys.platform == "win32":
            return None
        import resource

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        own = peak / (1024 * 1024 if sys.platform == "darwin" else 1024)
        return round(own + ended_peak_mb(), 1)

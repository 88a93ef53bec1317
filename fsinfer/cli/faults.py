"""What becomes of a fault of fsinfer itself: its trace is kept, and the user is told how to report it."""

from __future__ import annotations

import datetime
import sys
import tempfile
import traceback
from pathlib import Path

from fsinfer._version import __version__
from fsinfer.output.layout import LOG_FILE, OutputFolder

#: Name of the form in .github/ISSUE_TEMPLATE that takes the support zip. Source: format.
ISSUE_FORM = "My plot failed"


def keep_trace(error: BaseException, out: Path | None) -> Path | None:
    """Append the trace of ``error`` to the log in the output folder, else to one in the folder for temporary files.

    Returns the log, or ``None`` where neither can be written.
    """
    head = (
        f"{datetime.datetime.now(datetime.UTC):%Y-%m-%d %H:%M:%S} UTC, fsinfer {__version__}: {' '.join(sys.argv[1:])}"
    )
    trace = "".join(traceback.format_exception(error))
    folders = [out] if out is not None and out.is_dir() else []
    for log in (*(OutputFolder(folder).log for folder in folders), Path(tempfile.gettempdir()) / LOG_FILE):
        try:
            with log.open("a", encoding="utf-8") as stream:
                stream.write(f"{head}\n{trace}\n")
        except OSError:
            continue
        return log
    return None


def how_to_report(log: Path | None, out: Path | None) -> str:
    """One line for the user: where the trace is, and what to send where."""
    kept = f"Its details are in {log}. " if log is not None else ""
    if log is not None and out is not None and log.parent == out:
        pack = f"fsinfer support {out} packs them into a zip without your photographs; attach it"
    else:
        pack = "attach them and the command" if log is not None else "run it again with --debug, attach what it shows"
    return f'{kept}Please report it: {pack} to the form "{ISSUE_FORM}" among the issues of fsinfer.'

"""The process that finds poses, struck when it tells of a step: STRUCK_STEP names it, STRUCK_HOW says how."""

from __future__ import annotations

import ctypes
import errno
import importlib
import os
import signal
import time
from pathlib import Path
from typing import Any

from fsinfer.workflow import poses_process


def main() -> None:
    tell = poses_process.Teller.tell

    def told(self: poses_process.Teller, **message: Any) -> None:
        tell(self, **message)
        if "progress" in message and message["progress"][2] == os.environ["STRUCK_STEP"]:
            strike(os.environ["STRUCK_HOW"])

    poses_process.Teller.tell = told  # type: ignore[method-assign]
    poses_process.main()


def strike(how: str) -> None:
    if how.startswith("SIG"):
        os.kill(os.getpid(), getattr(signal, how))
    elif how == "no features":
        importlib.import_module("pycolmap").extract_features = None  # type: ignore[attr-defined]
    elif how == "our fault":
        raise KeyError("ours", 3)
    elif how == "full disk":
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "there.jpg")
    else:
        Path(os.environ["STRUCK_MARK"]).write_text(str(os.getpid()), encoding="ascii")
        if how == "wait":
            time.sleep(600)
        # As a step of COLMAP that lets no other thread of Python do anything.
        ctypes.PyDLL(None).sleep(600)

"""Whose turn it is in a plot's folder: a small file there that its holder keeps fresh.

Two runs must never write into one folder: a worker that the cluster has given up may still be at work, and a batch may
have been started twice. Clocks of two computers differ, so what counts is whether the file changes while one looks.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

from fsinfer.errors import OutputError
from fsinfer.io.files import make_folder

LEASE_FILE = "batch-lease.json"
#: A holder touches the file so often, seconds. Source: numerics.
FRESH_S = 5.0
#: A file that has not changed for so long has lost its holder, seconds. Source: judgement; network file systems show
#: changes up to a minute late.
STALE_S = 90.0
#: A file that has lost its holder and cannot be moved for so long never can be, seconds. Source: judgement; on Windows
#: none can be while another process reads it.
STUCK_S = 5.0


class Lease:
    """Taken with :meth:`take`, kept with :meth:`keep`, given back with :meth:`give_back`."""

    def __init__(self, folder: Path, *, stale_s: float = STALE_S) -> None:
        self._path = folder / LEASE_FILE
        self._stale_s = stale_s
        self._text = json.dumps({"host": socket.gethostname(), "pid": os.getpid(), "token": secrets.token_hex(8)})
        self._kept = -FRESH_S

    def take(self, stop: Callable[[], bool], *, pause_s: float = 0.2) -> bool:
        """Wait for the folder; False when ``stop`` says that it is no longer wanted.

        Raises
        ------
        OutputError
            Nothing can be written into the folder, or the file of one who is gone cannot be taken away.
        """
        make_folder(self._path.parent)
        seen, since = "", time.monotonic()
        stuck: float | None = None
        while not stop():
            try:
                with self._path.open("x", encoding="utf-8") as stream:
                    stream.write(self._text)
            except FileExistsError:
                now = self._look()
                if now != seen:
                    seen, since = now, time.monotonic()
                if not (now and (_is_dead(now) or time.monotonic() - since > self._stale_s)):
                    stuck = None
                    time.sleep(pause_s)
                elif (error := self._throw_out(now)) is not None:
                    stuck = time.monotonic() if stuck is None else stuck
                    if time.monotonic() - stuck > STUCK_S:
                        msg = (
                            f"{self._path} is of a run that is gone, and cannot be taken away "
                            f"({error.strerror or error}); delete it, or make the folder writable"
                        )
                        raise OutputError(msg) from error
                    time.sleep(pause_s)
            except OSError as error:
                msg = f"cannot write {self._path}: {error.strerror or error}; make the folder writable"
                raise OutputError(msg) from error
            else:
                return True
        return False

    def keep(self) -> None:
        """Show that the holder is alive; cheap enough to be called often."""
        if time.monotonic() - self._kept >= FRESH_S:
            self._kept = time.monotonic()
            with contextlib.suppress(OSError):  # a share that does not answer for a moment: the next time it will
                os.utime(self._path)

    def give_back(self) -> None:
        """Let the next one in; a file that is another's by now stays."""
        try:
            if self._path.read_text(encoding="utf-8") == self._text:
                self._path.unlink()
        except OSError:
            pass

    def _look(self) -> str:
        """What stands in the file, and when it was touched; empty when it is gone."""
        try:
            return f"{self._path.read_text(encoding='utf-8')}\n{self._path.stat().st_mtime_ns}"
        except OSError:
            return ""

    def _throw_out(self, seen: str) -> OSError | None:
        """Take the file of one who is gone away; why that cannot be done, None where it is no longer there."""
        if self._look() != seen:
            return None
        aside = self._path.with_name(f".{LEASE_FILE}.{secrets.token_hex(4)}")
        try:
            # Of several who try only one can move it.
            self._path.replace(aside)
            aside.unlink()
        except FileNotFoundError:
            pass
        except OSError as error:
            return error
        return None


def _is_dead(seen: str) -> bool:
    """Whether the holder is a process of this computer that is gone."""
    try:
        holder = json.loads(seen.splitlines()[0])
        host, pid = holder["host"], int(holder["pid"])
    except (ValueError, KeyError, TypeError, IndexError):
        return False  # being written
    if host != socket.gethostname() or sys.platform == "win32":
        return False  # on Windows os.kill would end it
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False

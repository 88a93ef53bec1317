"""A real Dask cluster on this computer: a scheduler and its workers, processes of their own as on several computers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.support.batch_plots import wait_for
from tests.support.places import ROOT


@dataclass
class RunningCluster:
    """Where it is, and its processes."""

    address: str
    folder: Path
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@contextmanager
def running_cluster(folder: Path, *, workers: int = 2) -> Iterator[RunningCluster]:
    """Ended with the block. Each worker has two threads, and ``folder/wN`` as its own folder."""
    folder.mkdir()
    told = folder / "scheduler.json"
    scheduler = _start(
        folder, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(told)
    )
    started: list[subprocess.Popen[bytes]] = []
    try:
        wait_for(lambda: told.is_file() and told.read_text().strip().endswith("}"), seconds=120)
        address = json.loads(told.read_text(encoding="utf-8"))["address"]
        for number in range(workers):
            # Without a nanny, which would start it again: this worker is gone for good.
            words = ("--no-nanny", "--nthreads", "2", "--host", "127.0.0.1", "--no-dashboard", "--name", f"w{number}")
            started.append(_start(folder, "worker", address, *words, "--local-directory", str(folder / f"w{number}")))
        yield RunningCluster(address=address, folder=folder, scheduler=scheduler, workers=started)
    finally:
        for process in (*started, scheduler):
            process.kill()
            process.wait()


def _start(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    environment = os.environ | {"PYTHONPATH": paths, "DASK_DISTRIBUTED__ADMIN__TICK__LIMIT": "60s"}
    with (folder / "dask.log").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *words], cwd=folder, env=environment, stdout=log, stderr=log
        )

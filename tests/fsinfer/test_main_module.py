"""The command line without an installed script."""

from __future__ import annotations

import subprocess
import sys


def test_python_m_fsinfer_is_the_command() -> None:
    done = subprocess.run([sys.executable, "-m", "fsinfer", "trees"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "cloud" in (done.stderr + done.stdout).lower()

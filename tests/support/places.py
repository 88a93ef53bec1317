"""Where the project and the real data beside it lie."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Real data of third parties, never part of the project: tests that need it skip where it is missing.
DATA = ROOT / ".." / "shared" / "data"

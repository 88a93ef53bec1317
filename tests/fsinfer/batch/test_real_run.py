"""The installed ``fsinfer run`` under a batch: its options are understood, its messages arrive.

Plots that are measured to the end take half a minute each and are left to the demo; these end at once.
"""

from __future__ import annotations

from pathlib import Path

from fsinfer.batch.run import run_batch
from fsinfer.batch.settings import BatchSettings
from tests.support.batch_plots import write_table


def test_real_runs_say_what_is_wrong(tmp_path: Path) -> None:
    options = {
        "aruco_length_m": 0.25, "plot_radius_m": 12.62, "plot_center": "-1,2", "max_size": 320, "views": 3,
        "bh_rule": "uphill", "far_stems": "yes", "interval_s": 1.5, "equalize": "clahe",
    }  # fmt: skip
    rows = [{"name": "gone", **options}, {"name": "broken", **options}, {"name": "high", "bh": 9}]
    table = write_table(tmp_path, rows)
    (tmp_path / "photos" / "gone" / "one.jpg").unlink()
    (tmp_path / "photos" / "gone").rmdir()
    settings = BatchSettings(jobs=3, options=("--memory-gb=2.0", "--precision=float32"))
    result = run_batch(table, tmp_path / "out", settings=settings)
    said = {row.plot: row.message for row in result.rows}
    assert said["gone"] == f"{tmp_path / 'photos' / 'gone'} does not exist; give a folder of photos or a video file"
    assert "one.jpg" in said["broken"]
    assert said["high"].startswith("Invalid value for '--bh'")
    assert "3" in said["high"]
    assert [row.attempts for row in result.rows] == [1, 1, 1]

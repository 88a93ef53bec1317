"""``fsinfer batch`` tells a cell that no run would take before any plot is measured."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from fsinfer.cli.app import app


@pytest.mark.parametrize(
    ("column", "cell", "told"),
    [
        ("bh", "130", "--bh"),
        ("max_size", "10", "--max-size"),
        ("views", "99", "--views"),
        ("interval_s", "0", "--interval-s"),
        ("edits", "none.csv", "--edits"),
        ("plot_polygon", "none.csv", "--plot-polygon"),
    ],
)
def test_a_cell_that_a_run_would_refuse_is_told_with_its_row(column: str, cell: str, told: str, tmp_path: Path) -> None:
    table = tmp_path / "plots.csv"
    table.write_text(f"name,photos,{column}\nfirst,photos,\nsecond,photos,{cell}\n", encoding="utf-8")
    result = CliRunner().invoke(app, ["batch", str(table), str(tmp_path / "out")])
    assert result.exit_code == 2
    assert "row 3" in result.output
    assert told in result.output
    assert not (tmp_path / "out").exists()

"""``fsinfer batch`` tells a cell that no run would take before any plot is measured."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from fsinfer.cli.app import app
from fsinfer.errors import InputError


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


def test_rows_with_the_same_photos_are_told_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Copied rows count twice in the mean of the forest, and its interval is too short."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "a")

    def run_batch(*_: object, **__: object) -> None:
        msg = "nothing ran yet"
        raise InputError(msg)

    monkeypatch.setattr("fsinfer.batch.run.run_batch", run_batch)
    table = tmp_path / "plots.csv"
    table.write_text("name,photos\noak,a\nash,./b/../a\nelm,b\nfir,link\nyew,none\n", encoding="utf-8")
    said = " ".join(CliRunner().invoke(app, ["batch", str(table), str(tmp_path / "out")]).output.split())
    assert "Warning: oak, ash, fir have the same photos: as rows of their own they count as 3 plots" in said
    assert said.index("have the same photos") < said.index("nothing ran yet")
    table.write_text("name,photos\noak,a\nelm,b\n", encoding="utf-8")
    assert "same photos" not in CliRunner().invoke(app, ["batch", str(table), str(tmp_path / "out")]).output

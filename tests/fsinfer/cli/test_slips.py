"""Slips of the hand on the command line: decimal commas, folders and names for files; each told with its way out."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.command_line import Call


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("trees c.ply out --bh 1,37", "'--bh': '1,37': write a point, not a comma: 1.37"),
        ("run photos out --bh 1,37", "'--bh': '1,37': write a point, not a comma: 1.37"),
        ("run photos out --interval-s 0,5", "'--interval-s': '0,5': write a point, not a comma: 0.5"),
        ("run photos out --memory-gb 1,5", "'--memory-gb': '1,5': write a point, not a comma: 1.5"),
        ("check photos out --margin-m 1,5", "'--margin-m': '1,5': write a point, not a comma: 1.5"),
        ("evaluate a.csv b.csv --max-distance-m 0,8", "'--max-distance-m': '0,8': write a point, not a comma: 0.8"),
        ("evaluate a.csv b.csv --area-margin-m 2,5", "'--area-margin-m': '2,5': write a point, not a comma: 2.5"),
        ("trees c.ply out --bh 130", "'--bh': 130: it must be between 0.3 and 3"),
        ("trees c.ply out --bh nan", "'--bh': nan: it must be between 0.3 and 3"),
        ("check photos out --margin-m -1", "'--margin-m': -1: it must be at least 0"),
    ],
)
def test_numbers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, call: Call, words: str, told: str) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    code, _, error = call(*words.split())
    assert code == 2
    assert told in " ".join(error.replace("│", " ").split())
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("files", "told"),
    [
        (["cloud.ply", "cloud.laz", "trees.laz", "trees.csv"], "give the cloud in it, my plot/cloud.ply"),
        (["wald.laz", "trees.laz"], "give the cloud in it, my plot/wald.laz"),
        (["a.LAS", "b.ply"], "give one of the 2 clouds in it, such as my plot/a.LAS"),
        (["IMG_1.JPG"], "give a point cloud (.ply, .las, .laz or .xyz); a folder of photos is"),
    ],
)
def test_a_folder_for_a_cloud(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, call: Call, files: list[str], told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my plot").mkdir()
    for name in files:
        (Path("my plot") / name).touch()
    code, _, error = call("trees", "my plot", "out")
    assert code == 2
    assert f"my plot is a folder; {told}" in error.replace("\\", "/")
    assert not Path("out").exists()


@pytest.mark.parametrize("name", ["wald.xyz", "wald"])
def test_a_cloud_that_is_not_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, call: Call, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, error = call("trees", name, "out")
    assert code == 2
    assert f"there is no file {name}; check the path" in error

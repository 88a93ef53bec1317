"""COLMAP models whose counts lie are told before COLMAP asks for memory by them."""

from __future__ import annotations

import struct
from pathlib import Path

import pycolmap
import pytest

from fsinfer.errors import OutputError, SceneError
from fsinfer.poses import model_files
from fsinfer.poses.model_files import write_model
from fsinfer.poses.sparse import read_sparse
from tests.fuzz.scenes import make_colmap


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_colmap(tmp_path)
    return tmp_path / "sparse"


@pytest.mark.parametrize(
    ("name", "walk"),
    [("images", model_files._images), ("points3D", model_files._points), ("frames", model_files._frames),
     ("rigs", model_files._rigs)],
)  # fmt: skip
def test_the_walk_through_a_sound_file_ends_at_its_end(folder: Path, name: str, walk: object) -> None:
    reader = model_files._Reader((folder / f"{name}.bin").read_bytes())
    walk(reader)  # type: ignore[operator]
    assert reader.at == len(reader.data)
    assert len(read_sparse(folder).points) == 6


@pytest.mark.parametrize("count", [2**40, 2**63, 10**6])
@pytest.mark.parametrize("name", ["cameras", "images", "points3D", "frames", "rigs"])
def test_counts_that_lie(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, count: int) -> None:
    # COLMAP would ask for the memory, or read on for hours.
    monkeypatch.setattr(pycolmap, "Reconstruction", lambda _: pytest.fail("COLMAP was asked"))
    path = folder / f"{name}.bin"
    path.write_bytes(struct.pack("<Q", count) + path.read_bytes()[8:])
    with pytest.raises(SceneError, match=rf"{name}\.bin .*promises more than it holds"):
        read_sparse(folder)


@pytest.mark.parametrize("share", [0.3, 0.7, 0.99])
def test_files_that_were_cut(folder: Path, share: float) -> None:
    path = folder / "points3D.bin"
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    with pytest.raises(SceneError, match=r"points3D\.bin is cut short"):
        read_sparse(folder)


def test_a_model_that_cannot_be_written_whole_is_told(folder: Path, tmp_path: Path) -> None:
    model = pycolmap.Reconstruction(folder)
    write_model(model, tmp_path / "whole")
    assert len(read_sparse(tmp_path / "whole").points) == 6
    (tmp_path / "barred" / "images.bin").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"cannot write .*barred .*images\.bin.*free some space"):
        write_model(model, tmp_path / "barred")

    class FullDisk:
        """What COLMAP leaves there: it says nothing of it."""

        def write_binary(self, out: Path) -> None:
            model.write_binary(out)
            (out / "points3D.bin").write_bytes((out / "points3D.bin").read_bytes()[:256])

    with pytest.raises(OutputError, match=r"points3D\.bin is cut short.*free some space"):
        write_model(FullDisk(), tmp_path / "full")

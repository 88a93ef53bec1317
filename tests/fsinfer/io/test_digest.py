"""A digest sees an edit wherever it is, at a price that fits the kind of file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from fsinfer.io.cloud import PointCloud, write_cloud
from fsinfer.io.digest import COMPRESSED_SUFFIXES, DIGEST_BYTES, file_digest
from fsinfer.io.pfm import read_pfm, write_pfm
from fsinfer.io.photo_folders import PHOTO_SUFFIXES, VIDEO_SUFFIXES


def test_a_map_masked_in_its_middle_is_another_and_a_copy_is_not(tmp_path: Path) -> None:
    path = tmp_path / "a.pfm"
    depth = np.full((240, 320), 4.0, np.float32)
    write_pfm(path, depth)
    before, size = file_digest(path), path.stat().st_size
    os.utime(path, (1, 1))
    assert file_digest(path) == before
    depth[100:140] = 0
    write_pfm(path, depth)
    assert path.stat().st_size == size > 2 * DIGEST_BYTES
    np.testing.assert_array_equal(read_pfm(path), depth)
    assert file_digest(path) != before


@pytest.mark.parametrize("suffix", [".ply", ".las", ".laz"])
def test_a_cloud_with_a_point_moved_is_another(tmp_path: Path, suffix: str) -> None:
    xyz = np.random.default_rng(0).uniform(0, 9, (100_000, 3)).round(3)
    path = tmp_path / f"a{suffix}"
    write_cloud(path, PointCloud(xyz=xyz))
    before = file_digest(path)
    write_cloud(path, PointCloud(xyz=xyz))
    assert file_digest(path) == before
    xyz[50_000] = [1.0, 2.0, 3.0]
    write_cloud(path, PointCloud(xyz=xyz))
    assert file_digest(path) != before


@pytest.mark.parametrize("suffix", [".pfm", ".ply", ".las", ".xyz", ".csv", ".tif", ".bmp", ""])
@pytest.mark.parametrize("place", [0, 65_536, 150_000, 2_000_000, 2_999_999])
def test_each_byte_counts(tmp_path: Path, suffix: str, place: int) -> None:
    path = tmp_path / f"a{suffix}"
    content = bytearray(3_000_000)
    path.write_bytes(content)
    before = file_digest(path)
    content[place] = 1
    path.write_bytes(content)
    assert file_digest(path) != before


def test_of_compressed_files_both_ends_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    content = bytearray(300_000)
    path.write_bytes(content)
    before = file_digest(path)
    for place, same in ((0, False), (DIGEST_BYTES - 1, False), (150_000, True), (len(content) - DIGEST_BYTES, False)):
        path.write_bytes(content[:place] + b"1" + content[place + 1 :])
        assert (file_digest(path) == before) == same
    plain = {".tif", ".tiff", ".bmp"}
    assert (PHOTO_SUFFIXES - plain) | VIDEO_SUFFIXES <= COMPRESSED_SUFFIXES
    assert not plain & COMPRESSED_SUFFIXES

"""PLY files: what is written is read back bit for bit, whole or in pieces, and damage is told."""

from __future__ import annotations

import struct
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.io.ply import find_table, read_ply, read_rows, write_ply

KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")


def columns_of(kinds: list[str], count: int, seed: int) -> dict[str, NDArray[Any]]:
    """Columns of any scalar types; every bit pattern of a row may occur, NaN too."""
    rng = np.random.default_rng(seed)
    raw = {f"p{i}": rng.bytes(count * np.dtype(kind).itemsize) for i, kind in enumerate(kinds)}
    return {name: np.frombuffer(raw[name], kind).copy() for name, kind in zip(raw, kinds, strict=True)}


@given(
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=5),
    count=st.integers(0, 30),
    cut=st.integers(0, 30),
    seed=st.integers(0, 99),
)
def test_any_table_comes_back_bit_for_bit_whole_and_in_pieces(
    kinds: list[str], count: int, cut: int, seed: int
) -> None:
    columns = columns_of(kinds, count, seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "c.ply"
        write_ply(path, columns, comments=("a comment",))
        whole, table = read_ply(path), find_table(path)
        assert table is not None
        first = min(cut, count)
        pieces = [read_rows(path, table, 0, first), read_rows(path, table, first, count - first)]
    assert list(whole) == list(columns)
    for name, column in columns.items():
        assert whole[name].dtype == column.dtype
        assert whole[name].tobytes() == column.tobytes()
        assert np.concatenate([piece[name] for piece in pieces]).tobytes() == column.tobytes()


@pytest.mark.parametrize(("form", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_elements_before_the_vertices_are_stepped_over(tmp_path: Path, form: str, order: str) -> None:
    header = (
        f"ply\nformat {form} 1.0\nelement camera 2\nproperty float32 f\nproperty uchar b\n"
        "element vertex 2\nproperty double x\nproperty short q\nelement face 1\nproperty list uchar int i\nend_header\n"
    )
    body = struct.pack(f"{order}fBfBdhdhBi", 1.5, 7, 2.5, 8, -4.25, -300, 1e300, 301, 1, 0)
    path = tmp_path / "c.ply"
    path.write_bytes(header.encode() + body)
    columns = read_ply(path)
    assert columns["x"].tolist() == [-4.25, 1e300]
    assert columns["q"].tolist() == [-300, 301]
    table = find_table(path)
    assert table is not None
    assert read_rows(path, table, 1, 1)["q"].tolist() == [301]


def test_an_ascii_file_is_read_whole_only(tmp_path: Path) -> None:
    path = tmp_path / "c.ply"
    header = "ply\nformat ascii 1.0\nelement camera 1\nproperty float f\nelement vertex 2\nproperty int x\nend_header\n"
    path.write_text(header + "0.5\n7\n-8\n")
    assert read_ply(path)["x"].tolist() == [7, -8]
    assert find_table(path) is None


def test_decimal_commas_are_told(tmp_path: Path) -> None:
    path = tmp_path / "c.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 2\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_text(f"{head}1,5 2,5 3,5\n1,0 2,0 3,0\n", encoding="ascii")
    with pytest.raises(CloudError, match="commas in its numbers, as in '1,5 2,5 3,5'; export the cloud with decimal"):
        read_ply(path)


def test_a_file_cut_while_it_is_read_in_pieces_is_told(tmp_path: Path) -> None:
    path = tmp_path / "c.ply"
    write_ply(path, {"x": np.arange(10.0)})
    table = find_table(path)
    assert table is not None
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(CloudError, match="cut short: 7 of 10"):
        read_rows(path, table, 4, 6)
    with pytest.raises(CloudError, match="cut short: 7 of 10"):
        find_table(path)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["format ascii 1.0", "element face 1", "property list uchar int i"], "no vertices"),
        (["format ascii 1.0", "element vertex 1", "property list uchar int i"], "list property"),
        (["format ascii 1.0", "element vertex 1", "property quad x"], "header is damaged"),
        (["format ascii 1.0", "element vertex 1", "property int x", "property int x"], "header is damaged"),
        (["format ascii 1.0", "element vertex -1", "property int x"], "header is damaged"),
        (["format morse 1.0", "element vertex 1", "property int x"], "header is damaged"),
    ],
)
def test_headers_that_cannot_be_used_are_told(tmp_path: Path, lines: list[str], message: str) -> None:
    path = tmp_path / "c.ply"
    path.write_text("\n".join(["ply", *lines, "end_header", "1 2 3", ""]))
    with pytest.raises(CloudError, match=message):
        read_ply(path)

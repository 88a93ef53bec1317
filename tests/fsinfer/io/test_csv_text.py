"""Tables as people and spreadsheets write them, and as spreadsheets must not run them."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from fsinfer.errors import InputError
from fsinfer.io.csv_text import FORMULA_STARTS, Cell, CsvTable, read_rows, read_table, table_text, write_table


def table_of(tmp_path: Path, text: str, required: tuple[str, ...] = ("name", "x_m")) -> CsvTable:
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode("utf-8"))
    return read_table(path, what="the table", required=required, way_out="write it again")


@pytest.mark.parametrize(
    "text",
    [
        "name,x_m,note\noak,-1.5,old\n",
        "\ufeffname,x_m,note\r\noak,-1.5,old\r\n",
        "Name , X_m, note\n oak ,-1.5, old\n",
        'name, x_m, note\n"oak", "-1.5", "old"\n',
        "name;x_m;note\noak;-1,5;old\n",
        "name;x_m;note\noak;-1.5;old\n",
        "name\tx_m\tnote\noak\t-1,5\told\n",
        "sep=;\nname;x_m;note\noak;-1,5;old\n",
        '"sep=,"\r\nname,x_m,note\r\noak,-1.5,old\r\n',
        "note,x_m,name,more\nold,-1.5,oak,, \n",
        "name,x_m,note\n,,\noak,-1.5,old\n\n",
    ],
)
def test_every_dialect_reads_the_same(tmp_path: Path, text: str) -> None:
    (row,) = table_of(tmp_path, text).rows
    assert (row.text("name"), row.number("x_m"), row.text("note"), row.text("height_m")) == ("oak", -1.5, "old", "")


def test_a_row_with_more_cells_than_columns_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"row 3: it has 3 cells, and the file 2 columns; with decimal commas"):
        table_of(tmp_path, "name,x_m\noak,3\nash,12,62\n")
    with pytest.raises(InputError, match=r"row 2: it has 3 cells, and the file 2 columns$"):
        table_of(tmp_path, "name;x_m\noak;3,5;beyond\n")


def test_a_comma_is_a_point_only_in_numbers_between_semicolons(tmp_path: Path) -> None:
    table = table_of(tmp_path, "name;x_m;y_m\n1,2;,5;1.234,5\n")
    assert table.rows[0].text("name") == "1,2"
    assert table.rows[0].number("x_m") == 0.5
    with pytest.raises(InputError, match=r"row 2, column y_m: '1\.234,5' is not a number"):
        table.rows[0].number("y_m")
    with pytest.raises(InputError, match=r"row 2, column x_m: '1,5' is not a number"):
        table_of(tmp_path, 'name,x_m\noak,"1,5"\n').rows[0].number("x_m")


def test_rows_are_counted_as_a_spreadsheet_does(tmp_path: Path) -> None:
    table = table_of(tmp_path, 'name,x_m\n"two\nlines",1\n\noak,2\n')
    assert [(row.row, row.text("name")) for row in table.rows] == [(2, "two\nlines"), (4, "oak")]
    assert table.rows[1].place == f"{tmp_path / 'table.csv'}, row 4"


@pytest.mark.parametrize(
    ("text", "read", "told"),
    [
        ("", None, "has no column name, x_m; write it again"),
        ("name\noak\n", None, "has no column x_m; write it again"),
        ("name,x_m\noak,thick\n", "given", r"row 2, column x_m: 'thick' is not a number"),
        ("name,x_m\noak,inf\n", "number", r"row 2, column x_m: 'inf' is not a number"),
        ("name,x_m\noak\n", "given", r"row 2, column x_m: the cell is empty"),
        ("name,x_m\noak,2.5\n", "whole", r"row 2, column x_m: '2\.5' is no whole number"),
        ("name,x_m\noak,\n", "whole", r"row 2, column x_m: the cell is empty"),
    ],
)
def test_what_does_not_fit_is_named(tmp_path: Path, text: str, read: str | None, told: str) -> None:
    with pytest.raises(InputError, match=told):
        getattr(table_of(tmp_path, text).rows[0], read or "")("x_m")


def test_files_that_cannot_be_read_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot read the table .*table\.csv: there is no such file; write it again"):
        read_table(tmp_path / "table.csv", what="the table", required=(), way_out="write it again")
    (tmp_path / "table.csv").write_bytes("name,x_m\nbl\u00e4tter,1\n".encode("cp1252"))
    with pytest.raises(InputError, match=r"no text in UTF-8 \(byte 11\); save it as 'CSV UTF-8'"):
        read_table(tmp_path / "table.csv", what="the table", required=(), way_out="write it again")
    with pytest.raises(InputError, match="cannot read the table"):
        read_table(tmp_path, what="the table", required=(), way_out="write it again")
    with pytest.raises(InputError, match="it is no CSV"):
        table_of(tmp_path, f"name,x_m\n{'a' * 200_000},1\n")


def test_the_lenient_reader_asks_for_nothing(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("\ufeffName;x_m;note\noak;1,5\n\n;2;a, b;beyond\n", encoding="utf-8")
    assert read_rows(path) == [{"Name": "oak", "x_m": "1.5", "note": ""}, {"Name": "", "x_m": "2", "note": "a, b"}]
    path.write_text("", encoding="utf-8")
    assert read_rows(path) == []
    with pytest.raises(FileNotFoundError):
        read_rows(tmp_path / "none.csv")
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UnicodeDecodeError):
        read_rows(path)


TEXTS = [
    "ordinary", "", "a, b", 'say "so"', "1.5 m", "it's", "'quoted'", " around ", "two\nlines",
    "=1+1", '=HYPERLINK("http://a.example","b")', "+1+1", "-2+3", "@SUM(A1)", "\tx", "\nx",
    "'=1", "''-x", "-5.25", "+3",
]  # fmt: skip


def test_texts_come_back_as_they_were_and_none_is_a_formula(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    write_table(path, ["text", "x_m"], [(text, -1.5) for text in TEXTS])
    assert [row["text"] for row in read_rows(path)] == TEXTS
    with path.open(encoding="utf-8", newline="") as stream:
        written = [row["text"] for row in csv.DictReader(stream)]
    for text in written:
        assert not text.startswith(FORMULA_STARTS) or float(text) in (-5.25, 3.0)


def test_ordinary_content_is_written_plainly() -> None:
    rows: list[tuple[Cell, ...]] = [(1, "-0.250", None, True, 'a "b", c'), (2, -1, "ok", False, "5 cm")]
    expected = 'id,x,y,kept,reason\n1,-0.250,,1,"a ""b"", c"\n2,-1,ok,0,5 cm\n'
    assert table_text(["id", "x", "y", "kept", "reason"], rows) == expected

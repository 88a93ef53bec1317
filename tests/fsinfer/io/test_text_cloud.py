"""Text clouds are read as they are meant, or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fsinfer.errors import CloudError
from fsinfer.io.cloud import read_cloud

POINTS = [[1.25, 2.5, 0.75], [4.1, -5.2, 130.0]]
COLOURS = [[255, 0, 7], [1, 2, 3]]


def written(folder: Path, text: str, name: str = "a.csv", *, encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("header", ["", "X;Y;Z\n", '"x","y","z"\n', "//X Y Z\n", "2\n", "X (m), Y [m], Z (m)\n"])
@pytest.mark.parametrize(
    "rows",
    [
        "1.25 2.50 0.75\n4.10 -5.20 1.3e2",
        "1.25\t2.50\t0.75\r\n4.10\t-5.20\t130\r\n",
        "1.25,2.50,0.75\n4.10,-5.20,130\n",
        "1.25, 2.50 , 0.75\n4.10, -5.20, 130\n",
        "1.25;2.50;0.75\n4.10;-5.20;130",
        "1,25;2,50;0,75\n4,10;-5,20;1,3e2\n",
        "1,25; 2,50; 0,75;\n4,10; -5,20; 130;\n",
        "1,25 2,50 0,75\n4,10 -5,20 130\n",
        "1,25\t2,50\t0,75\n4,10\t-5,20\t130,0\n",
        '"1.25","2.50","0.75"\n"4.10","-5.20","130"\n',
        '"1,25";"2,50";"0,75"\n"4,10";"-5,20";"130"\n',
        '"1,25","2,50","0,75"\n"4,10","-5,20","130"\n',
        "1.25,2.50,0.75;\n4.10,-5.20,130;\n",
        "1.25,2.50,0.75 # a stem\n4.10,-5.20,130\n",
    ],
)
def test_separators_and_decimal_commas(tmp_path: Path, rows: str, header: str, encoding: str) -> None:
    np.testing.assert_array_equal(read_cloud(written(tmp_path, header + rows, encoding=encoding)).xyz, POINTS)


@pytest.mark.parametrize("header", ["Easting,Northing,Elevation,id", "e,n,h,x0", "Easting (m),Northing (m),Height,no"])
def test_what_surveyors_call_the_axes(tmp_path: Path, header: str) -> None:
    rows = "1.25,2.50,0.75,7\n4.10,-5.20,130,8\n"
    np.testing.assert_array_equal(read_cloud(written(tmp_path, f"{header}\n{rows}")).xyz, POINTS)
    swapped = "Northing,Easting,Elevation\n2.50,1.25,0.75\n-5.20,4.10,130\n"
    np.testing.assert_array_equal(read_cloud(written(tmp_path, swapped)).xyz, POINTS)
    # Not where it says what x and y are, or has two heights.
    for other in ("easting,y,z", "easting,northing,height,altitude"):
        with pytest.raises(CloudError, match="no x, y and z"):
            read_cloud(
                written(tmp_path, f"{other}\n1.25,2.50,0.75,7\n".replace(",7", "" if other[-1] == "z" else ",7"))
            )


@pytest.mark.parametrize("mark", ["//", "# ", "#", " ## "])
@pytest.mark.parametrize("comma", [".", ","])
def test_a_header_in_a_comment_says_where_the_axes_are(tmp_path: Path, mark: str, comma: str) -> None:
    rows = "9;2.50;1.25;0.75\n8;-5.20;4.10;130\n".replace(".", comma)
    text = f"// of a scanner\n{mark}Intensity; Y (m); X (m); Z (m)\n{rows}"
    np.testing.assert_array_equal(read_cloud(written(tmp_path, text)).xyz, POINTS)
    # What names other columns, or not all three, is a remark.
    for remark in ("y x z", "a b c d", "id x y height over sea", "written by x"):
        plain = f"{mark}{remark}\n1.25 2.50 0.75 7\n4.10 -5.20 130 8\n"
        np.testing.assert_array_equal(read_cloud(written(tmp_path, plain)).xyz, POINTS)


def test_a_comment_farther_up_is_no_header(tmp_path: Path) -> None:
    text = "//Y X Z\n// written on a Monday\n1.25 2.50 0.75\n4.10 -5.20 130\n"
    np.testing.assert_array_equal(read_cloud(written(tmp_path, text)).xyz, POINTS)


@pytest.mark.parametrize("first", [0, 1])
def test_a_first_column_that_numbers_the_points(tmp_path: Path, first: int) -> None:
    rng = np.random.default_rng(0)
    xyz, count = rng.normal(size=(12, 3)).round(3), np.arange(first, first + 12)
    rows = [f"{n} {x:.3f} {y:.3f} {z:.3f}" for n, (x, y, z) in zip(count, xyz, strict=True)]
    np.testing.assert_allclose(read_cloud(written(tmp_path, "\n".join(rows), "a.xyz")).xyz, xyz)
    # Nine may be so by chance, and a step of two numbers nothing.
    for other in (rows[:9], rows[::2] + rows[1::2]):
        read = read_cloud(written(tmp_path, "\n".join(other), "a.xyz")).xyz
        assert read[0, 0] == first


@pytest.mark.parametrize(
    "rows",
    [
        "1,25;2,50;0,75;255;0;7\n4,10;-5,20;130;1;2;3\n",
        "1,25 2,50 0,75 255 0 7\n4,10 -5,20 130 1 2 3\n",
        "1.25,2.50,0.75,255,0,7\n4.10,-5.20,130,1,2,3\n",
    ],
)
def test_colours_stay_what_they_are(tmp_path: Path, rows: str) -> None:
    cloud = read_cloud(written(tmp_path, rows, "a.xyz"))
    np.testing.assert_array_equal(cloud.xyz, POINTS)
    assert cloud.rgb is not None
    np.testing.assert_array_equal(cloud.rgb, COLOURS)


@pytest.mark.parametrize(
    "row",
    [
        "1,2 3",  # 1.2 and 3, or three columns
        "1,25;2.50;0,75",
        "691,234.50 5,335,123.20 512.30",
        "1,234,567;2;3",
        "1,2,3 255,0,7",
        "1,;2;3",
        '"1,234.5","2","3"',
        '"1,234,567","2","3"',
    ],
)
def test_commas_that_may_be_either_are_refused(tmp_path: Path, row: str) -> None:
    path = written(tmp_path, f"{row}\n{row}\n")
    with pytest.raises(CloudError, match=r"a\.csv: a comma may stand between columns or be a decimal point.*export"):
        read_cloud(path)


def test_a_value_that_is_not_finite_is_one_with_decimal_commas_too(tmp_path: Path) -> None:
    cloud = read_cloud(written(tmp_path, "1,5;2,5;nan\n4;5;6\nNaN;1;2\n"))
    np.testing.assert_array_equal(cloud.xyz, [[4, 5, 6]])


@pytest.mark.parametrize("text", ["", "\ufeff", "x;y;z\n", "a\n", "1;2\n3;4\n", "1;2;3\n4;5\n", "1;2;fir\n"])
def test_what_is_no_cloud_is_told(tmp_path: Path, text: str) -> None:
    with pytest.raises(CloudError, match=r"a\.csv"):
        read_cloud(written(tmp_path, text))

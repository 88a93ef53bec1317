"""PLOTS.csv: its columns are options of ``fsinfer run``, and what does not fit is told by row and column."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer

from fsinfer.batch.plots_table import OPTIONS, read_plots
from fsinfer.cli.app import app
from fsinfer.errors import InputError


def write(folder: Path, text: str) -> Path:
    path = folder / "plots.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_rows_become_options_of_run(tmp_path: Path) -> None:
    header = (
        "Name;photos;aruco_length_m;plot_radius_m;plot_center;edits;far_stems;bh_rule;views;latitude_deg;longitude_deg"
    )
    table = write(
        tmp_path,
        f"{header}\nHütte 3;walks/3;0,25;12,62;-1.5,2;edits 3.csv;yes;uphill;4;47,1;8,25\nb;/far/b.mp4;;;;;no;;;;\n",
    )
    first, second = read_plots(table)
    assert first.name == "Hütte 3"
    assert first.photos == tmp_path / "walks" / "3"
    # A value never stands alone, where one that begins with a dash would be taken for an option.
    assert set(first.options) == {
        "--aruco-length-m=0.25", "--plot-radius-m=12.62", "--plot-center=-1.5,2", "--far-stems", "--bh-rule=uphill",
        "--views=4",
    }  # fmt: skip
    assert first.files == (("--edits", tmp_path / "edits 3.csv"),)
    assert first.place_deg == (47.1, 8.25)
    assert second.photos == tmp_path / Path("/far/b.mp4")
    assert (second.options, second.files, second.place_deg) == ((), (), None)


def test_two_points_are_two_words(tmp_path: Path) -> None:
    (plot,) = read_plots(write(tmp_path, 'name,photos,endpoints,length_m\na,p,"-1,2,3 4,5,6",2\n'))
    assert plot.options == ("--endpoints", "-1,2,3", "4,5,6", "--length-m=2.0")


def test_every_column_is_an_option_of_run() -> None:
    command = typer.main.get_command(app).commands["run"]  # type: ignore[attr-defined]
    options = {word for parameter in command.params for word in parameter.opts}
    assert {flag for flag, _ in OPTIONS.values()} <= options
    # What is left out says how the computer is used, which is said for all plots alike, or has no place in a table.
    left = options - {flag for flag, _ in OPTIONS.values()}
    assert {word for word in left if word.startswith("--")} == {
        "--model", "--jobs", "--threads", "--memory-gb", "--provider", "--precision", "--quiet", "--debug",
        "--trust-model", "--scheduler", "--copy",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name,photos,radius\na,p,5\n", "'radius'; known are name, photos, latitude_deg"),
        ("name;photos;;\na;p;;5\n", "row 2: it has 4 cells, and the file 2 columns"),
        ("name,photos,plot_radius_m,,\na,p,12,62,\n", "row 2: it has 5 cells, and the file 3 columns; with decimal"),
        ("name;;photos\na;5;p\n", "row 2: it has 3 cells, and the file 3 columns"),
        ("name,photos,plot_radius_m\na,p,12,62\n", "row 2: it has 4 cells, and the file 3 columns"),
        ("name\na\n", "no column photos"),
        ("name,photos\n", "holds no plot"),
        ("name,photos,bh,BH\na,p,1.3,1.3\n", "the column bh twice"),
        ("name,photos\na,p\nB,q\nA,r\n", "row 4: the name 'A' stands in row 2 already"),
        ("name,photos\n../a,p\n", "row 2, column name: '../a' holds one of"),
        ("name,photos\n..,p\n", "begins or ends with a point"),
        ("name,photos\nCON.old,p\n", "Windows keeps for itself"),
        ("name,photos\n,p\n", "'' is empty"),
        (f"name,photos\n{'a' * 81},p\n", "more than 80 characters"),
        ("name,photos\na,\n", "column photos: the cell is empty"),
        ("name,photos,scale\na,p,big\n", "row 2, column scale: 'big' is not a number"),
        ("name,photos,views\na,p,4.5\n", "column views: '4.5' is no whole number"),
        ("name,photos,bh_rule\na,p,top\n", "column bh_rule: 'top' is none of midpoint, uphill"),
        ("name,photos,far_stems\na,p,maybe\n", "neither yes nor no"),
        ('name,photos,endpoints\na,p,"1,2,3"\n', "are no two points"),
        ("name,photos,scale,aruco_length_m\na,p,1,0.25\n", "row 2: --scale and --aruco-length-m were given together"),
        ("name,photos,aruco_length_m,aruco_dictionary\na,p,0.2,5X\n", "row 2: --aruco-dictionary 5X is unknown"),
        ("name,photos,plot_center\na,p,marker:7\n", "row 2: --plot-center was given without --plot-radius-m"),
        ("name,photos,plot_radius_m,plot_polygon\na,p,5,b.csv\n", "row 2: --plot-radius-m and --plot-polygon"),
        ("name,photos,latitude_deg\na,p,47\n", "belong together"),
        ("name,photos,stratum,stratum_ha\na,p,oak,3\nb,p,Oak ,4\n", "row 3, column stratum_ha: stratum 'Oak' has 4 ha"),
        ("name,photos,stratum,stratum_ha\na,p,oak,0\n", "row 2, column stratum_ha: 0 is no area"),
        ("name,photos,stratum,stratum_ha\na,p,oak,much\n", "row 2, column stratum_ha: 'much' is not a number"),
        ("name,photos,stratum_ha\na,p,3\n", "row 2, column stratum_ha: it is the area of a stratum"),
        ("name,photos,latitude_deg,longitude_deg\na,p,470,8\n", "no latitude and longitude"),
    ],
)
def test_what_does_not_fit_is_told(tmp_path: Path, text: str, words: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_plots(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_stratum_has_the_area_that_any_of_its_rows_says(tmp_path: Path) -> None:
    text = "name;photos;stratum;stratum_ha\na;p;Buche;\nb;p;buche ;12,5\nc;p;;\nd;p;Fichte;\ne;p;BUCHE;12,50\n"
    plots = read_plots(write(tmp_path, text))
    assert [(plot.stratum, plot.stratum_ha) for plot in plots] == [
        ("Buche", 12.5), ("Buche", 12.5), ("", None), ("Fichte", None), ("Buche", 12.5),
    ]  # fmt: skip


def test_columns_that_a_spreadsheet_leaves_empty_beside_the_table_are_none(tmp_path: Path) -> None:
    (plot,) = read_plots(write(tmp_path, "name;photos;plot_radius_m;;\na;p;12,62;;\n;;;;\n"))
    assert plot.options == ("--plot-radius-m=12.62",)

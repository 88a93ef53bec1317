"""Readers of tables, corrections and borders that people write by hand."""

from __future__ import annotations

from pathlib import Path

from tests.fuzz.mutators import change_bytes, change_json, change_text, cut
from tests.fuzz.reader import Reader

_TEXT = (change_text, change_text, change_bytes, cut)


def _make_truth(folder: Path) -> None:
    rows = "".join(f"{i},{i * 1.5:.2f},{-i * 0.7:.2f},{20 + i}\n" for i in range(1, 9))
    (folder / "comma.csv").write_text("tree_id,x_m,y_m,dbh_cm\n" + rows, encoding="utf-8")
    other = rows.replace(",", ";").replace(".", ",")
    (folder / "semicolon.csv").write_text("\ufefftree_id;x_m;y_m;dbh_cm\n" + other, encoding="utf-8")


def _read_truth(folder: Path) -> None:
    from fsinfer.evaluation.measured import read_measured
    from fsinfer.evaluation.metrics import evaluate

    one, other = read_measured(folder / "comma.csv"), read_measured(folder / "semicolon.csv", need_dbh=False)
    evaluate(one, other)
    evaluate(one, other, by_id=True)


def _make_edits(folder: Path) -> None:
    text = "action,tree_id,other_id,x_m,y_m\ndelete,1,,,\nadd,9,,1.5,2.5\nadd,,,-1,0.25\nmerge,2,3,,\n"
    (folder / "edits.csv").write_text(text, encoding="utf-8")


def _read_edits(folder: Path) -> None:
    from fsinfer.trees.edit_rows import read_edits

    read_edits(folder / "edits.csv")


def _make_frames(folder: Path) -> None:
    from fsinfer.frames.table import FrameRow, frames_csv

    rows = [
        FrameRow(name=f"p{i}", source=f"p{i}.jpg", time_s=None, sharpness=0.5, mean_luminance=100.0, dark_share=0.1,
                 bright_share=0.2, kept=i > 0, reason="" if i else "=blurred")
        for i in range(4)
    ]  # fmt: skip
    (folder / "frames.csv").write_text(frames_csv(rows), encoding="utf-8")


def _read_frames(folder: Path) -> None:
    from fsinfer.frames.table import read_frames_csv

    read_frames_csv(folder / "frames.csv")


def _make_trees(folder: Path) -> None:
    from fsinfer.trees.outputs.table import COLUMNS
    from tests.support.report_plot import tree_rows

    rows = [",".join(str(row.get(name, "")) for name in COLUMNS) for row in tree_rows()]
    (folder / "trees.csv").write_text("\n".join([",".join(COLUMNS), *rows, ""]), encoding="utf-8")


def _read_trees(folder: Path) -> None:
    from fsinfer.trees.outputs.table import read_trees

    read_trees(folder / "trees.csv")


def _make_border(folder: Path) -> None:
    (folder / "plot.csv").write_text("x_m,y_m\n0,0\n20,0\n20,20\n0,20\n", encoding="utf-8")


def _make_geojson(folder: Path) -> None:
    text = (
        '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": {}, "geometry": {"type": '
        '"Polygon", "coordinates": [[[0, 0], [20, 0], [20, 20], [0, 20], [0, 0]]]}}]}'
    )
    (folder / "plot.geojson").write_text(text, encoding="utf-8")


def _read_border(folder: Path) -> None:
    from fsinfer.plot_border.request import read_polygon

    for path in folder.iterdir():
        read_polygon(path)


def _make_clicks(folder: Path) -> None:
    from fsinfer.scale.clicks.file import SavedClicks, write_clicks
    from fsinfer.scale.request import ClickedEnds, ClickedLength

    ends = tuple(ClickedEnds(view=name, first=(10.0, 20.0), second=(30.0, 5.5)) for name in ("a", "b"))
    draft = {"a": ((10.0, 20.0), None)}
    write_clicks(folder, SavedClicks(used=ClickedLength(views=ends, length_m=1.0), draft=draft))


def _read_clicks(folder: Path) -> None:
    from fsinfer.scale.clicks.file import read_clicks

    read_clicks(folder)


READERS = (
    Reader(name="truth", what="measured trees (CSV)", make=_make_truth, targets=("*.csv",), mutators=_TEXT,
           read=_read_truth),
    Reader(name="edits", what="edits.csv", make=_make_edits, targets=("*.csv",), mutators=_TEXT, read=_read_edits),
    Reader(name="frames", what="frames.csv", make=_make_frames, targets=("*.csv",), mutators=_TEXT, read=_read_frames),
    Reader(name="trees", what="trees.csv", make=_make_trees, targets=("*.csv",), mutators=_TEXT, read=_read_trees),
    Reader(name="border", what="borders (CSV)", make=_make_border, targets=("*.csv",), mutators=_TEXT,
           read=_read_border),
    Reader(name="geojson", what="borders (GeoJSON)", make=_make_geojson, targets=("*.geojson",), read=_read_border,
           mutators=(change_json, change_json, change_text, cut)),
    Reader(name="clicks", what="scale_clicks.json", make=_make_clicks, targets=("*.json",), read=_read_clicks,
           mutators=(change_json, change_json, change_text, cut)),
)  # fmt: skip

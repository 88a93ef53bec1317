"""Texts of other people (tables, photo names, warnings) stay texts in the report, whatever they hold."""

from __future__ import annotations

import csv
import dataclasses
import json
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from markupsafe import escape

from fsinfer.report import make_report
from fsinfer.report.cloud.depth_part import depth_part
from fsinfer.report.cloud.part import cloud_part
from fsinfer.report.contents import Contents, read_contents
from fsinfer.report.made_part import made_part
from fsinfer.report.page import Part, missing_part, render_page, render_part
from fsinfer.report.photos_part import photos_part
from fsinfer.report.picture import Picture
from fsinfer.report.stems.part import stems_part
from fsinfer.report.summary import plot_part, tiles_part
from fsinfer.report.table_part import table_part
from fsinfer.report.warnings_part import warnings_part
from fsinfer.scene import read_scene
from tests.support.report_plot import tree_rows, write_report_folder

HOSTILE = "\"><script>alert('&')</script>"


def hostile_codes() -> list[dict[str, object]]:
    return [
        {"code": HOSTILE, "values": {}, "text": f"was seen {HOSTILE}", "remark": False},
        {"code": "a", "values": {}, "text": f"mere {HOSTILE}", "remark": True},
    ]


def hostile_rows() -> list[dict[str, Any]]:
    one, two, three = tree_rows()
    return [
        one,
        two | {"status": "unmeasured", "dbh_cm": "", "reason": HOSTILE},
        three | {"status": HOSTILE, "x_m": HOSTILE, "points": HOSTILE, "reason": f"doubt {HOSTILE}"},
    ]


def write_rows(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = write_report_folder(tmp_path_factory.mktemp("plot"))
    write_rows(out / "trees.csv", hostile_rows())
    write_rows(out / "frames.csv", [{"file": HOSTILE, "chosen": "no", "reason": f"why {HOSTILE}"}])
    plot = json.loads((out / "plot.json").read_text(encoding="utf-8"))
    plot |= dict.fromkeys(("source", "scale_source", "model", "model_sha256", "model_precision", "photos"), HOSTILE)
    plot |= {"warning_codes": hostile_codes(), "versions": {HOSTILE: HOSTILE}, "settings": {HOSTILE: HOSTILE}}
    plot |= {"scale_details": {"markers": [{"id": HOSTILE, "views": []}]}, "seconds": {HOSTILE: 3}}
    (out / "plot.json").write_text(json.dumps(plot), encoding="utf-8")
    return out


def assert_harmless(page: str, *, times: int = 1) -> None:
    assert HOSTILE not in page
    assert "<script>alert" not in page
    # Shown as it is, not dropped. A str: the methods of Markup escape what they are given.
    assert str(page).count(str(escape(HOSTILE))) >= times


def test_a_whole_page_of_hostile_files(folder: Path) -> None:
    # Reason and status in table and cards, warnings, source, model, versions, settings, markers, frames.
    page = make_report(folder).read_text(encoding="utf-8")
    assert_harmless(page, times=15)
    assert "Was seen &#34;&gt;&lt;script&gt;" in page
    # Nothing was cut short: all sections are there.
    assert page.count("<section id=") == 8


def test_names_of_photos(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = read_scene(folder / "scene")
    views = [dataclasses.replace(view, name=f"{view.name}{HOSTILE}") for view in scene.views]
    named = dataclasses.replace(scene, views=tuple(views))
    monkeypatch.setattr("fsinfer.report.stems.photos.read_scene", lambda _: named)
    part = stems_part(read_contents(folder))
    assert part is not None
    html = render_part(part).html
    assert html.count("<figure>") >= 3
    # In caption and spoken text of each.
    assert_harmless(html, times=2 * 3)


def poisoned(value: Any) -> Any:
    """``value`` with each text in it replaced; what we make ourselves (encoded pictures and points) is left."""
    if isinstance(value, str):
        return HOSTILE
    if isinstance(value, tuple):
        return tuple(poisoned(item) for item in value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        ours = {"source", "points_base64"} if isinstance(value, Picture) else {"points_base64"}
        names = [field.name for field in dataclasses.fields(value) if field.name not in ours]
        return dataclasses.replace(value, **{name: poisoned(getattr(value, name)) for name in names})
    return value


PARTS = (
    warnings_part, tiles_part, plot_part, stems_part, table_part, cloud_part, depth_part, photos_part, made_part,
    lambda _: missing_part("cloud", "Point cloud", "none"),
)  # fmt: skip


@pytest.mark.parametrize("part_of", PARTS, ids=lambda one: str(one.__name__))
def test_no_template_lets_a_text_of_its_view_through(folder: Path, part_of: Callable[[Contents], Part | None]) -> None:
    part = part_of(read_contents(folder))
    assert part is not None
    html = render_part(dataclasses.replace(part, view=poisoned(part.view))).html
    assert_harmless(html)


def test_title_of_the_page() -> None:
    assert_harmless(render_page(HOSTILE, HOSTILE, []), times=3)


def test_json_of_the_viewer_cannot_end_its_script(folder: Path) -> None:
    part = cloud_part(read_contents(folder), max_points=100)
    html = render_part(dataclasses.replace(part, view=poisoned(part.view))).html
    start = html.index('id="viewer-info">') + len('id="viewer-info">')
    assert json.loads(html[start : html.index("</script>", start)])["unit"] == HOSTILE


def test_the_template_engine_is_loaded_only_for_a_report() -> None:
    code = "import sys, fsinfer.report; sys.exit('jinja2' in sys.modules or 'markupsafe' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0

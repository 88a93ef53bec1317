"""Names in an output folder: each once, the same that the stages write by, and nowhere typed again."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from fsinfer.output import layout
from fsinfer.output.layout import OutputFolder

ROOT = Path(__file__).parents[3]
OUT = Path("out")
FOLDER = OutputFolder(OUT)
NAMES = {name: value for name, value in vars(layout).items() if name.isupper() and isinstance(value, str)}
PATHS = {
    name: getattr(FOLDER, name)
    for name, entry in vars(OutputFolder).items()
    if isinstance(entry, property) and isinstance(getattr(FOLDER, name), Path)
}
# Where every name is taken from the layout.
USERS = ("check", "cli/stage_commands.py")


def test_no_two_names_are_the_same() -> None:
    assert len(set(NAMES.values())) == len(NAMES)
    assert len(set(PATHS.values())) == len(PATHS)


def test_paths_are_those_of_the_contract() -> None:
    assert {path.relative_to(OUT).as_posix() for path in PATHS.values()} == {
        ".fsinfer", "frames", "frames/images", "frames/frames.csv", "frames/frames_contact.jpg", "scene",
        "scene/images", "scene/sparse", "depth", "depth/depth.json", "confidence", "fused/cloud.ply", "cloud.ply",
        "cloud.laz", "trees.csv", "trees.json", "trees.xlsx", "trees.laz", "stem_curve.csv", "dbh_sources.csv",
        "figures", "figures/stem_map.png", "edits.csv", "scale_clicks.json", "plot.json", "report.html", "check",
        "check/check.png", "check/check.json", "check/work", "photos", "truth.csv", "fsinfer.log",
    }  # fmt: skip
    assert FOLDER.section_figure(7) == OUT / "figures" / "tree_007.png"
    assert FOLDER.edges_figure(7) == OUT / "figures" / "tree_007_edges.png"
    assert {path.name for path in FOLDER.scene_parts} == {"cams", "images", "pair.txt"}
    assert set(FOLDER.metric_tree_files) == {
        OUT / name
        for name in (
            "trees.gpkg", "trees.geojson", "trees.laz", "trees.xlsx", "stem_curve.csv", "dbh_sources.csv",
        )
    }  # fmt: skip


def test_stages_below_write_by_the_same_names() -> None:
    from fsinfer.frames.select import CONTACT_SHEET
    from fsinfer.scale.clicks.file import CLICKS_FILE
    from fsinfer.trees.edit_rows import EDITS_FILE
    from fsinfer.trees.outputs.maps import GEOJSON, GEOPACKAGE

    assert (CONTACT_SHEET, EDITS_FILE) == (layout.CONTACT_SHEET_FILE, layout.EDITS_FILE)
    assert CLICKS_FILE == layout.CLICKS_FILE
    assert (GEOJSON, GEOPACKAGE) == (layout.TREES_GEOJSON, layout.TREES_GPKG)


@pytest.mark.parametrize("part", USERS)
def test_names_are_typed_nowhere_else(part: str) -> None:
    # Records of stages are named for the stages.
    names = set(NAMES.values()) - {layout.DEPTH_INDEX_FILE}
    place = ROOT / "fsinfer" / part
    for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
        joins = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.BinOp)]
        typed = [node.right.value for node in joins if isinstance(node.right, ast.Constant)]
        assert names.isdisjoint(typed), path


def test_the_layout_is_light() -> None:
    code = "import json, sys, fsinfer.output.layout; print(json.dumps(list(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert not {"numpy", "scipy", "cv2", "matplotlib"} & set(json.loads(result.stdout))

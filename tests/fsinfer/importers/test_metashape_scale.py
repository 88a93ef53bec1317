"""A chunk that camera positions alone put to metres: its scale is told to be as good as these."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from fsinfer.importers.formats import reader_of
from fsinfer.importers.metashape_scale import doubt_of_scale
from tests.support import foreign_scenes as made
from tests.support.foreign_scenes import PINHOLE

CAMERAS = "<cameras><group>{}</group></cameras>"
POSITION = '<camera><reference x="8.5" y="47.3" z="500" enabled="1"/></camera>'
ACCURACY = '<settings><property name="accuracy_cameras" value="{}"/></settings>'
MARKER = '<marker id="1"><reference x="8.5" y="47.3" z="500" enabled="{}"/></marker>'
BAR = '<scalebars><scalebar id="0"><reference distance="1.5" enabled="{}"/></scalebar></scalebars>'
#: A ring of 10 m about the plot.
RING = 10 * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0, 2 * np.pi, 40, endpoint=False)])


def doubt(*parts: str) -> str | None:
    return doubt_of_scale(ElementTree.fromstring(f"<chunk>{''.join(parts)}</chunk>"), RING)


@pytest.mark.parametrize(
    ("settings", "position", "error", "percent"),
    [
        ("", POSITION, "5", "25"),
        (ACCURACY.format("10"), POSITION, "10", "50"),
        (ACCURACY.format("300"), POSITION, "300", "100"),
        (ACCURACY.format("0.03/0.03/0.05"), POSITION, "0.03", "0.1"),
        (ACCURACY.format("10"), POSITION.replace(" z=", ' sxyz="4" z='), "4", "20"),
        (ACCURACY.format("-1"), POSITION.replace(" z=", ' sxyz="good" z='), "5", "25"),
    ],
)
def test_the_error_follows_from_the_positions_and_the_walk(
    settings: str, position: str, error: str, percent: str
) -> None:
    told = doubt(CAMERAS.format(40 * position), settings)
    assert told is not None
    assert f"good to {error} m; over this walk lengths and all DBH may be wrong by {percent} %" in told


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ([CAMERAS.format(POSITION)], True),
        ([CAMERAS.format(POSITION), f"<markers>{MARKER.format(1)}{MARKER.format('true')}</markers>"], False),
        ([CAMERAS.format(POSITION), f"<markers>{MARKER.format(1)}</markers>"], True),
        ([CAMERAS.format(POSITION), f"<markers>{MARKER.format(0)}{MARKER.format('false')}</markers>"], True),
        ([CAMERAS.format(POSITION), "<markers>" + 3 * '<marker id="1"/>' + "</markers>"], True),
        ([CAMERAS.format(POSITION), BAR.format("true")], False),
        ([CAMERAS.format(POSITION), BAR.format("false")], True),
        # Where it does not say what its scale is from nothing is made up.
        ([CAMERAS.format(POSITION.replace('"1"', '"0"'))], False),
        ([], False),
    ],
)
def test_only_a_scale_by_camera_positions_alone_is_doubted(parts: list[str], told: bool) -> None:
    assert (doubt(*parts) is not None) == told


def test_cameras_at_one_place_have_no_scale_by_their_positions() -> None:
    chunk = ElementTree.fromstring(f"<chunk>{CAMERAS.format(POSITION)}</chunk>")
    told = doubt_of_scale(chunk, np.zeros((3, 3)))
    assert told is not None
    assert "wrong by 100 %" in told


def test_it_is_a_remark_of_the_scene(tmp_path: Path) -> None:
    scene = made.truth(PINHOLE)
    made.write_photos(scene, tmp_path)
    path = tmp_path / "cameras.xml"
    made.write_metashape(scene, path)
    reader = reader_of(path)
    assert reader is not None
    assert reader().remarks == ()
    reference = '<reference x="8.5" y="47.3" z="500" sxyz="5" enabled="true"/></camera>'
    path.write_text(path.read_text(encoding="utf-8").replace("</camera>", reference), encoding="utf-8")
    (remark,) = reader().remarks
    assert re.search(r"positions of the cameras.*good to 5 m.*fsinfer scale --click", remark)

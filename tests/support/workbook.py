"""An XLSX file read back without the library that wrote it: cells, formats, widths (ECMA-376, part 1)."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
import zipfile
from dataclasses import dataclass
from pathlib import Path

SPACE = {"m": "http://schemas.openxmlformats.org/spreadsheetml/2006/main"}
BUILT_IN_FORMATS = {0: "General", 1: "0", 2: "0.00"}


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """A sheet: values by place ("A1"; numbers as float), number formats and bold places, widths, and its raw XML."""

    name: str
    values: dict[str, float | str | bool]
    formats: dict[str, str]
    bold: set[str]
    widths: list[float]
    frozen_rows: int
    xml: str

    def rows(self) -> list[list[float | str | bool | None]]:
        """The values as a table with None for empty cells."""
        width = max(_column(place) for place in self.values)
        height = max(int(place.lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZ")) for place in self.values)
        table: list[list[float | str | bool | None]] = [[None] * (width + 1) for _ in range(height)]
        for place, value in self.values.items():
            letters = place.rstrip("0123456789")
            table[int(place[len(letters) :]) - 1][_column(place)] = value
        return table


def read_sheets(path: Path) -> list[Sheet]:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        parts = {name: archive.read(name) for name in archive.namelist()}
    for part in parts.values():
        ElementTree.fromstring(part)
    # A workbook that is written row by row has its texts in the cells instead.
    texts = ElementTree.fromstring(parts.get("xl/sharedStrings.xml", b"<sst/>"))
    shared = ["".join(text.itertext()) for text in texts.iterfind("m:si", SPACE)]
    styles = ElementTree.fromstring(parts["xl/styles.xml"])
    codes = BUILT_IN_FORMATS | {
        int(entry.attrib["numFmtId"]): entry.attrib["formatCode"]
        for entry in styles.iterfind("m:numFmts/m:numFmt", SPACE)
    }
    bold = [font.find("m:b", SPACE) is not None for font in styles.iterfind("m:fonts/m:font", SPACE)]
    kinds = [
        (codes[int(kind.attrib["numFmtId"])], bold[int(kind.attrib["fontId"])])
        for kind in styles.iterfind("m:cellXfs/m:xf", SPACE)
    ]
    names = [
        sheet.attrib["name"] for sheet in ElementTree.fromstring(parts["xl/workbook.xml"]).iterfind(".//m:sheet", SPACE)
    ]
    return [
        _sheet(name, parts[f"xl/worksheets/sheet{number}.xml"].decode("utf-8"), shared, kinds)
        for number, name in enumerate(names, start=1)
    ]


def _sheet(name: str, xml: str, shared: list[str], kinds: list[tuple[str, bool]]) -> Sheet:
    root = ElementTree.fromstring(xml)
    values: dict[str, float | str | bool] = {}
    formats, bold = {}, set()
    for cell in root.iterfind(".//m:c", SPACE):
        place, kind = cell.attrib["r"], cell.attrib.get("t", "n")
        text = cell.findtext("m:is/m:t" if kind == "inlineStr" else "m:v", namespaces=SPACE)
        if text is None:
            continue
        values[place] = (
            text
            if kind == "inlineStr"
            else shared[int(text)]
            if kind == "s"
            else text == "1"
            if kind == "b"
            else float(text)
        )
        formats[place], is_bold = kinds[int(cell.attrib.get("s", 0))]
        if is_bold:
            bold.add(place)
    pane = root.find(".//m:pane", SPACE)
    return Sheet(
        name=name,
        values=values,
        formats=formats,
        bold=bold,
        widths=[
            float(columns.attrib["width"])
            for columns in root.iterfind("m:cols/m:col", SPACE)
            for _ in range(int(columns.attrib["min"]), int(columns.attrib["max"]) + 1)
        ],
        frozen_rows=0 if pane is None else int(pane.attrib["ySplit"]),
        xml=xml,
    )


def _column(place: str) -> int:
    """Column of a place, counted from 0."""
    column = 0
    for letter in place.rstrip("0123456789"):
        column = 26 * column + ord(letter) - ord("A") + 1
    return column - 1


def _value(kind: str, text: str, shared: list[str]) -> float | str | bool:
    if kind in ("s", "inlineStr"):
        return shared[int(text)] if kind == "s" else text
    return text == "1" if kind == "b" else float(text)

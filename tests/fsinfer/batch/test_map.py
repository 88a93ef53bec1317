"""Where plots lie: what photographs say, and the map of all of them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from PIL import Image

from fsinfer.batch.outcome import State
from fsinfer.batch.place import place_of_photos
from fsinfer.batch.report import write_report
from fsinfer.batch.rows import PlotRow


def photo(path: Path, latitude_deg: float, longitude_deg: float) -> Path:
    """A photograph with its place, as a phone notes it."""
    exif = Image.Exif()
    exif[0x8825] = {
        1: "S" if latitude_deg < 0 else "N", 2: _parts(latitude_deg), 3: "W" if longitude_deg < 0 else "E",
        4: _parts(longitude_deg),
    }  # fmt: skip
    Image.new("RGB", (8, 8)).save(path, exif=exif)
    return path


def _parts(degrees: float) -> tuple[float, float, float]:
    minutes = abs(degrees) % 1 * 60
    return float(int(abs(degrees))), float(int(minutes)), minutes % 1 * 60


def test_the_middle_of_the_photos_is_the_place(tmp_path: Path) -> None:
    files = [photo(tmp_path / f"{i}.jpg", 47.0 + i / 1000, -8.5) for i in range(3)]
    # One that is far off does not move it, one without a place and a film say nothing.
    files.append(photo(tmp_path / "3.jpg", -33.0, 151.0))
    Image.new("RGB", (8, 8)).save(tmp_path / "plain.jpg")
    (tmp_path / "walk.mp4").write_bytes(b"film")
    files += [tmp_path / "plain.jpg", tmp_path / "walk.mp4"]
    place = place_of_photos([*files[:3], *files[4:]])
    assert place == pytest.approx((47.001, -8.5), abs=1e-5)
    assert place_of_photos([tmp_path / "plain.jpg", tmp_path / "walk.mp4"]) is None
    assert place_of_photos([]) is None


def test_the_middle_across_the_date_line(tmp_path: Path) -> None:
    files = [photo(tmp_path / f"{i}.jpg", -17.0, lon) for i, lon in enumerate((179.999, -179.999, -179.998))]
    place = place_of_photos(files)
    assert place == pytest.approx((-17.0, -179.999), abs=1e-5)


def row(name: str, latitude_deg: float | None, longitude_deg: float | None, state: State = State.done) -> PlotRow:
    return PlotRow(plot=name, state=state, latitude_deg=latitude_deg, longitude_deg=longitude_deg, trees=3)


def dots(text: str) -> dict[str, tuple[float, float]]:
    found = re.findall(r'<title>(\w+): .*?</title><circle class="dot \w+" cx="([\d.]+)" cy="([\d.]+)"', text)
    return {name: (float(x), float(y)) for name, x, y in found}


def test_north_is_up_and_the_bar_is_true(tmp_path: Path) -> None:
    rows = [row("south", 47.0, 8.0), row("north", 47.1, 8.0), row("east", 47.0, 8.1), row("nowhere", None, None)]
    text = write_report(tmp_path, rows, title="Plots").read_text(encoding="utf-8")
    place = dots(text)
    assert set(place) == {"south", "north", "east"}
    assert place["north"][1] < place["south"][1] == place["east"][1]
    assert place["north"][0] == place["south"][0] < place["east"][0]
    assert "1 of 4 plots has no place and is not on the map" in text
    up, right = place["south"][1] - place["north"][1], place["east"][0] - place["south"][0]
    # A degree of longitude is shorter there.
    assert right / up == pytest.approx(math.cos(math.radians(47.05)), abs=0.01)
    (start, end) = re.findall(r'class="bar" x1="([\d.]+)" x2="([\d.]+)"', text)[0]
    bar_km = float(re.findall(r">([\d.]+) km</text>", text)[0])
    # A tenth of a degree of latitude is 11.1 km.
    assert (float(end) - float(start)) / up * 11.11 == pytest.approx(bar_km, rel=0.01)


@pytest.mark.parametrize("places", [[(0.0, 179.9), (0.0, -179.9)], [(47.0, 8.0)], [(47.0, 8.0), (47.0, 8.0)]])
def test_plots_at_one_place_or_across_the_date_line_are_on_the_map(
    tmp_path: Path, places: list[tuple[float, float]]
) -> None:
    rows = [row(f"p{i}", *place) for i, place in enumerate(places)]
    text = write_report(tmp_path, rows, title="Plots").read_text(encoding="utf-8")
    place = dots(text)
    assert len(place) == len(rows)
    width, height = (float(n) for n in re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', text)[0])
    assert all(0 < x < width and 0 < y < height for x, y in place.values())
    if places[0][1] == 179.9:
        assert place["p0"][0] < place["p1"][0]


@pytest.mark.parametrize(
    ("places", "told"),
    [
        ([(47.0, 8.0), (47.5, 8.25)], "47.00000° N to 47.50000° N, 8.00000° E to 8.25000° E"),
        ([(-33.2, -70.5), (-33.1, -70.25)], "33.20000° S to 33.10000° S, 70.50000° W to 70.25000° W"),
        ([(-0.5, -0.25), (0.5, 0.25)], "0.50000° S to 0.50000° N, 0.25000° W to 0.25000° E"),
        ([(-17.0, 179.75), (-17.0, -179.5)], "17.00000° S to 17.00000° S, 179.75000° E to 179.50000° W"),
    ],
)
def test_the_corners_of_the_map_name_their_side(tmp_path: Path, places: list[tuple[float, float]], told: str) -> None:
    rows = [row(f"p{i}", *place) for i, place in enumerate(places)]
    assert f"{told} (WGS84)" in write_report(tmp_path, rows, title="Plots").read_text(encoding="utf-8")


def test_one_plot_is_one(tmp_path: Path) -> None:
    one = [PlotRow(plot="a", state=State.failed, message="dark"), PlotRow(plot="b", state=State.done, trees=1)]
    text = re.sub(r"<[^>]*>", " ", write_report(tmp_path, one, title="Plots").read_text(encoding="utf-8"))
    assert re.search(r"\b1\s+plot failed", text)
    assert re.search(r"\b1\s+stem found", text)
    two = [PlotRow(plot=name, state=State.failed, message="dark") for name in "ab"]
    text = re.sub(r"<[^>]*>", " ", write_report(tmp_path, two, title="Plots").read_text(encoding="utf-8"))
    assert re.search(r"\b2\s+plots failed", text)


def test_what_failed_and_what_waits_is_told(tmp_path: Path) -> None:
    rows = [
        PlotRow(plot="a", state=State.failed, message="too <dark>", latitude_deg=1.0, longitude_deg=1.0),
        row("b", 1.1, 1.0, State.waiting),
    ]
    text = write_report(tmp_path, rows, title="Plots").read_text(encoding="utf-8")
    assert "<li><b>a</b>: too &lt;dark&gt;</li>" in text
    assert "1 plot is not yet measured. Run the same command again" in text
    assert 'class="dot failed"' in text
    assert 'class="dot waiting"' in text
    # Without a report of its own there is nothing to link.
    assert 'href="plots/' not in text

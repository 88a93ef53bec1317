"""The support zip: what is in it, what is not, and that nobody's folders and name are."""

from __future__ import annotations

import json
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from fsinfer.cli import main
from fsinfer.errors import InputError, OutputError
from fsinfer.output import support
from fsinfer.output.support import scrubber, write_support_zip

Scrub = Callable[[str], str]
PICTURE = b"\xff\xd8 a small picture"
NO_PATH = "DBH 12.1/13 m/s, 1 / 2"
PLOT = {
    "source": "photos",
    "warnings": ["/media/usb stick/forest/IMG 1.jpg cannot be read, take it out", NO_PATH],
    "settings": {"depth": {"model": "/opt/pines,old/mine.json", "max_size_px": 1280}},
}


@pytest.fixture(autouse=True)
def anna(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user who is not whoever runs the tests."""
    monkeypatch.setattr(Path, "home", classmethod(lambda cls: cls("/home/anna")))
    monkeypatch.setattr("getpass.getuser", lambda: "anna")


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A run that got as far as the depth; the photographs are there."""
    folder = tmp_path / "my-plot"
    texts = {
        "plot.json": json.dumps(PLOT),
        "trees.csv": "tree_id,reason\n1,\n2,too few points\n",
        "frames/frames.csv": "name,source\nanna_01,/home/anna/Pictures/oak/anna_01.jpg\n",
        "scene/poses.json": '{"photos": 3}',
        "depth/depth.json": '{"views": {}}',
        ".fsinfer/poses.json": '{"state": "started", "model": "C:\\\\Users\\\\anna\\\\m.json"}',
        ".fsinfer/frames.json": '{"state": "done"}',
        "fsinfer.log": "started by Anna in /home/anna/plots\nC:\\Users\\anna\\photos\\a.jpg: truncated\n",
        "notes.txt": "the owner's telephone number",
    }
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    for name in ("frames/frames_contact.jpg", "frames/images/IMG_1.jpg", "scene/images/IMG_1.jpg"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(PICTURE)
    return folder


def unpack(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def test_it_holds_the_records_and_no_photographs(out: Path, tmp_path: Path) -> None:
    assert write_support_zip(out, tmp_path / "s.zip") == tmp_path / "s.zip"
    files = unpack(tmp_path / "s.zip")
    assert set(files) == {
        "plot.json", "trees.csv", "frames/frames.csv", "frames/frames_contact.jpg", "scene/poses.json",
        "depth/depth.json", ".fsinfer/poses.json", ".fsinfer/frames.json", "fsinfer.log", "system.txt",
    }  # fmt: skip
    assert files["frames/frames_contact.jpg"] == PICTURE
    # What needs no scrubbing is passed on byte by byte.
    assert files["trees.csv"] == (out / "trees.csv").read_bytes()
    assert files["scene/poses.json"] == (out / "scene" / "poses.json").read_bytes()


def test_photographs_only_when_asked_for_and_once(out: Path, tmp_path: Path) -> None:
    files = unpack(write_support_zip(out, tmp_path / "s.zip", photos=True))
    assert [name for name in files if "IMG_1" in name] == ["frames/images/IMG_1.jpg"]
    assert files["frames/images/IMG_1.jpg"] == PICTURE


def test_folders_and_the_users_name_are_taken_out(out: Path, tmp_path: Path) -> None:
    files = unpack(write_support_zip(out, tmp_path / "s.zip"))
    texts = {name: content.decode() for name, content in files.items() if not name.endswith(".jpg")}
    told = ("/home", "Users", "/media", "/opt", "pines", "usb stick", "Pictures", str(tmp_path))
    assert [(name, part) for name, text in texts.items() for part in told if part in text] == []
    plot = json.loads(texts["plot.json"])
    assert plot["warnings"] == ["IMG 1.jpg cannot be read, take it out", NO_PATH]
    assert plot["settings"]["depth"] == {"model": "mine.json", "max_size_px": 1280}
    # A photograph keeps its name: the other tables speak of it.
    assert texts["frames/frames.csv"] == "name,source\nanna_01,anna_01.jpg\n"
    assert texts["fsinfer.log"] == "started by user in plots\na.jpg: truncated\n"
    assert json.loads(texts[".fsinfer/poses.json"])["model"] == "m.json"


@pytest.mark.parametrize(
    ("text", "clean"),
    [
        ("read /data/a b/c/x.png: bad", "read x.png: bad"),
        ("file:/srv/x/y.jpg", "file:y.jpg"),
        (r"\\server\share\plots\x.jpg", "x.jpg"),
        ("D:/plots/oak/x.jpg", "x.jpg"),
        ("see https://example.org/a/b", "see https://example.org/a/b"),
        ("frames/images/x.jpg, 3 m/s, 1/2, and/or", "frames/images/x.jpg, 3 m/s, 1/2, and/or"),
        ("annas anna's anna.", "annas user's user."),
    ],
)
def test_what_is_a_path_and_what_is_not(text: str, clean: str, out: Path) -> None:
    assert scrubber(out)(text) == clean


def test_a_comma_in_the_home_folder_ends_no_path(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "home", classmethod(lambda cls: cls("/home/Doe, Anna")))
    assert scrubber(out)("cannot read /home/Doe, Anna/plots/x.jpg") == "cannot read x.jpg"


def test_names_of_everybody_and_short_ones_stay(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("getpass.getuser", lambda: "root")
    monkeypatch.setattr(Path, "home", classmethod(lambda cls: cls("/home/al")))
    assert scrubber(out)("al at the root of the stem") == "al at the root of the stem"


def test_without_a_user_there_is_nothing_to_replace(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody() -> str:
        raise KeyError

    monkeypatch.setattr("getpass.getuser", nobody)
    assert scrubber(out)("x in /home/anna/y") == "x in y"


def test_the_system_is_described(out: Path, tmp_path: Path) -> None:
    text = unpack(write_support_zip(out, tmp_path / "s.zip"))["system.txt"].decode()
    for part in ("platform: ", "processor: ", "logical cores", " GB\n", "  numpy ", "  fsinfer "):
        assert part in text
    assert "not in the folder: trees.json, dbh_sources.csv" in text


def test_the_processor_is_known_without_cpuinfo(tmp_path: Path) -> None:
    assert support.processor_name(tmp_path / "none")
    (tmp_path / "cpuinfo").write_text("processor\t: 0\nmodel name\t: Some Core 7\n", encoding="utf-8")
    assert support.processor_name(tmp_path / "cpuinfo") == "Some Core 7"


def test_damaged_records_are_packed(out: Path, tmp_path: Path) -> None:
    (out / ".fsinfer" / "poses.json").write_bytes(b'{"state": "sta\xc3')
    (out / "plot.json").unlink()
    files = unpack(write_support_zip(out, tmp_path / "s.zip"))
    assert files[".fsinfer/poses.json"].startswith(b'{"state": "sta')


def test_what_is_no_output_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "IMG_1.jpg").write_bytes(PICTURE)
    (tmp_path / "photos" / "edits.csv").write_text("action\n", encoding="utf-8")
    for folder in (tmp_path / "photos", tmp_path / "missing"):
        with pytest.raises(InputError, match="no output folder"):
            write_support_zip(folder, tmp_path / "s.zip")
    assert not (tmp_path / "s.zip").exists()


def test_a_target_that_cannot_be_written(out: Path, tmp_path: Path) -> None:
    (tmp_path / "s.zip" / "inside").mkdir(parents=True)
    with pytest.raises(OutputError, match="cannot write"):
        write_support_zip(out, tmp_path / "s.zip")


def fsinfer(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["fsinfer", "support", *(str(a) for a in arguments)])
    with pytest.raises(SystemExit) as stopped:
        main()
    return int(stopped.value.code or 0)


def test_the_command(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fsinfer(monkeypatch, out) == 0
    assert "No photographs" in capsys.readouterr().out
    assert "plot.json" in unpack(tmp_path / "my-plot-support.zip")
    monkeypatch.chdir(out)
    assert fsinfer(monkeypatch, ".", "--photos") == 0
    assert "The photographs are in it" in capsys.readouterr().out
    assert "frames/images/IMG_1.jpg" in unpack(tmp_path / "my-plot-support.zip")
    assert fsinfer(monkeypatch, ".", "--zip", tmp_path / "other.zip") == 0
    assert (tmp_path / "other.zip").is_file()
    capsys.readouterr()
    assert fsinfer(monkeypatch, tmp_path / "missing") == 2
    assert "Error: " in capsys.readouterr().err

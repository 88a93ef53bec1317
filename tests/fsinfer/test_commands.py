"""Every command of the documentation is one that exists, with options that exist and values that they take.

Commands of code blocks must parse as they stand; those within a sentence may leave out arguments that it is not about.
The quick ones are run.
"""

from __future__ import annotations

import argparse
import importlib
import json
import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer
import typer.core
from typer.testing import CliRunner

from fsinfer.cli.app import EXAMPLES, app
from fsinfer.io.cloud import write_cloud
from tests.bench import plot_speed
from tests.bench.results import check_result_options
from tests.support.places import ROOT
from tests.support.plane_scene import write_plane_scene
from tests.support.report_plot import plot_cloud, tree_rows, write_report_folder

DOCUMENTS = (
    "README.md",
    "CONTRIBUTING.md",
    "models/README.md",
    *(path.relative_to(ROOT).as_posix() for path in sorted((ROOT / "docs").rglob("*.md"))),
)
BLOCK = re.compile(r"^(?P<indent> *)```(?:sh|powershell)\n(?P<text>.*?)^(?P=indent)```", flags=re.DOTALL | re.MULTILINE)
FENCED = re.compile(r"^ *```.*?^ *```", flags=re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"`((?:fsinfer|python -m) [^`]+)`")
#: What the shell itself, or what is installed beside fsinfer, does.
OTHERS = {"pip", "dask", "pre-commit", "python3", ".", "for", "done", "do", "pytest", "mkdocs", "build"}
OTHERS |= {"colmap", "InterfaceCOLMAP", "DensifyPointCloud"}  # other programs that ours is held against
OTHERS |= {"py", "envScriptsActivate.ps1"}  # of PowerShell; a path without its backslashes
#: Words in capitals that stand for themselves and not for what the user puts there.
MEANT = {"A3", "A4"}
#: Modules of the project: one that is missing is a fault.
OWN = ("fsinfer", "training", "export", "tests")


@dataclass(frozen=True)
class Command:
    document: str
    words: tuple[str, ...]
    whole: bool

    def __str__(self) -> str:
        return f"{self.document}: {shlex.join(self.words)}"


def block_commands(document: str) -> Iterator[Command]:
    """The commands of the shell blocks, comments and line ends with a backslash taken out."""
    text = (ROOT / document).read_text(encoding="utf-8")
    for block in BLOCK.finditer(text):
        for line in block["text"].replace("\\\n", " ").splitlines():
            # PowerShell asks in other words whether the last command went well.
            line = re.sub(r"if \(\$\?\) \{(.*?)\}", r"\1", line)
            lexer = shlex.shlex(line, posix=True, punctuation_chars=";&|")
            lexer.whitespace_split = True
            words: list[str] = []
            for word in [*lexer, ";"]:
                if not set(word) <= set(";&|"):
                    words.append(word)
                else:
                    told = tuple(words[1:] if words[:1] == ["do"] else words)
                    if told:
                        yield Command(document, told, whole=True)
                    words = []


def inline_commands(document: str) -> Iterator[Command]:
    """Commands within sentences; a mark for what may stand there (``...``, ``[...]``) is no command line."""
    text = FENCED.sub("", (ROOT / document).read_text(encoding="utf-8"))
    for found in INLINE.findall(text):
        if "..." not in found and "[" not in found:
            yield Command(document, tuple(shlex.split(found)), whole=False)


def every_command() -> list[Command]:
    """Each once."""
    found = [c for document in DOCUMENTS for c in (*block_commands(document), *inline_commands(document))]
    return [command for command in dict.fromkeys(found) if command.words[0] not in OTHERS]


class _Parsed(BaseException):
    """Stops a module's ``main`` where it has read its arguments."""


def parse_module(words: tuple[str, ...], *, whole: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read ``python -m MODULE ...`` as the module would, and go no further."""
    name, rest = words[2], list(words[3:])
    if name in OTHERS:
        return
    try:
        module = importlib.import_module(name)
        if hasattr(module, "__path__"):
            module = importlib.import_module(f"{name}.__main__")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] in OWN:
            raise
        pytest.skip(f"{name} needs {error.name} of the extra dev")
    real = argparse.ArgumentParser.parse_args

    def parse_args(self: argparse.ArgumentParser, args: Any = None, namespace: Any = None) -> Any:
        if not whole:
            for action in self._actions:
                action.required = False
                if not action.option_strings and action.nargs in (None, "+"):
                    action.nargs = "*"
        found = real(self, rest if args is None else args, namespace)
        if hasattr(found, "result_set"):
            check_result_options(self, found)
        raise _Parsed

    def run_first(plot: Path, out: Path, photos: int, options: list[str]) -> None:
        # What this benchmark does not know itself it hands to fsinfer run.
        parse_fsinfer(("fsinfer", "run", str(plot), str(out), *options), whole=True, monkeypatch=monkeypatch)
        raise _Parsed

    monkeypatch.setattr(plot_speed, "run_first", run_first)
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_args)
    monkeypatch.setattr(sys, "argv", [name, *rest])
    with pytest.raises(_Parsed):
        module.main()


def parse_fsinfer(words: tuple[str, ...], *, whole: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read ``fsinfer COMMAND ...`` as fsinfer does."""
    group = typer.main.get_command(app)
    assert isinstance(group, typer.core.TyperGroup)
    if words[1:] in (("--version",), ("--help",)):
        return
    with group.make_context("fsinfer", list(words[1:])) as context:
        name, command, rest = group.resolve_command(context, list(words[1:]))
        assert command is not None
        if not whole:
            for parameter in command.params:
                monkeypatch.setattr(parameter, "required", False)
        command.make_context(name, rest).close()


@pytest.mark.parametrize("command", every_command(), ids=str)
def test_a_documented_command_can_be_given(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    if command.words[0] == "fsinfer":
        parse_fsinfer(command.words, whole=command.whole, monkeypatch=monkeypatch)
    else:
        assert command.words[:2] == ("python", "-m"), "say in OTHERS what this command belongs to"
        parse_module(command.words, whole=command.whole, monkeypatch=monkeypatch)


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_of_an_error_can_be_given(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    parse_fsinfer(("fsinfer", name, *EXAMPLES[name].split()), whole=True, monkeypatch=monkeypatch)


def test_a_wrong_command_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    for words in (("fsinfer", "run", "photos", "out", "--spale", "1"), ("fsinfer", "walk"), ("fsinfer", "run", "a")):
        with pytest.raises(Exception, match=r"such|Missing"):
            parse_fsinfer(words, whole=True, monkeypatch=monkeypatch)
    with pytest.raises(SystemExit):
        parse_module(("python", "-m", "training.train", "--data", "a"), whole=True, monkeypatch=monkeypatch)


def test_every_option_that_is_named_exists() -> None:
    group = typer.main.get_command(app)
    assert isinstance(group, typer.core.TyperGroup)
    known = {"--help", "--version"}
    for command in group.commands.values():
        for parameter in command.params:
            known |= {*parameter.opts, *parameter.secondary_opts}
    tests = ("bench", "mutation", "faults", "fuzz", "supply")
    for folder in ("training", "export", *(f"tests/{name}" for name in tests), "docs"):
        for path in (ROOT / folder).rglob("*.py"):
            known |= set(re.findall(r"\"(--[a-z][a-z0-9-]*)\"", path.read_text(encoding="utf-8")))
    known |= {
        "--strict",
        "--cov",
        "--cov-report",
        "--hypothesis-profile",
        "--all-files",
        "--nproc-per-node",
        "--local-directory",
        "--memory-limit",
    }  # mkdocs, pytest, pre-commit, torchrun, dask
    unknown = {}
    for document in DOCUMENTS:
        text = FENCED.sub("", (ROOT / document).read_text(encoding="utf-8"))
        named = {
            word for code in re.findall(r"`([^`]+)`", text) for word in re.findall(r"(?<!\S)--[a-z][a-z0-9-]*", code)
        }
        if named - known:
            unknown[document] = named - known
    assert unknown == {}


def quick_commands(*names: str) -> list[Command]:
    """The commands of the blocks, and those of sentences that are about files of an example, by subcommand."""
    return [
        command
        for command in every_command()
        if command.words[0] == "fsinfer"
        and command.words[1] in names
        and not any((word.isupper() and word not in MEANT) or "$" in word for word in command.words)
        and len(command.words) > 2
    ]


@pytest.mark.parametrize("command", quick_commands("marker", "evaluate", "report", "support", "trees"), ids=str)
def test_a_quick_command_runs_as_written(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Drawing takes most of the time, and is tested elsewhere.
    monkeypatch.setattr(
        "fsinfer.trees.outputs.figures.write_figures", lambda folder, *_, **__: folder.mkdir(exist_ok=True)
    )
    for name in ("my-plot", "out"):
        write_report_folder(tmp_path / name)
    cloud = plot_cloud(points_per_stem=6_000, ground=15_000)
    for path in ("out/cloud.ply", "plot.laz"):
        write_cloud(tmp_path / path, cloud)
    ring = [[-20.0, -20.0], [20.0, -20.0], [20.0, 20.0], [-20.0, 20.0], [-20.0, -20.0]]
    (tmp_path / "plot.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}), encoding="utf-8")
    rows = ["tree_id,x_m,y_m,dbh_cm", *(f"{r['tree_id']},{r['x_m']},{r['y_m']},{r['dbh_cm'] + 1}" for r in tree_rows())]
    (tmp_path / "measured.csv").write_text("\n".join(rows), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    made = {"marker": "marker.pdf", "report": "out/report.html", "trees": "out/trees.csv"}.get(command.words[1])
    if command.words[1] == "trees":
        made = f"{command.words[3]}/trees.csv"
    if made is not None:
        (tmp_path / made).unlink(missing_ok=True)
    done = CliRunner().invoke(app, list(command.words[1:]))
    assert done.exit_code == 0, done.output
    if made is not None:
        assert (tmp_path / made).stat().st_size > 300
    else:
        assert {"evaluate": "1.00 cm", "support": ".zip"}[command.words[1]] in done.output


def write_video(path: Path) -> None:
    """Two seconds along a wall."""
    wall = np.kron(
        np.random.default_rng(0).integers(40, 215, (60, 200, 3), dtype=np.uint8), np.ones((4, 4, 1), np.uint8)
    )
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10.0, (320, 240))
    for step in range(20):
        writer.write(np.ascontiguousarray(wall[:, 16 * step : 16 * step + 320]))
    writer.release()


def test_the_stages_of_the_quickstart_run_as_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_plane_scene(tmp_path / "scene")
    write_video(tmp_path / "video.mp4")
    monkeypatch.chdir(tmp_path)
    made = {
        "fsinfer frames video.mp4 work": ("work/images", "work/frames.csv"),
        "fsinfer poses work/images scene": (),  # takes too long; its photos are there, and the scene is
        "fsinfer depth scene out": ("out/depth", "out/confidence"),
        "fsinfer fuse scene out": ("out/cloud.ply", "out/cloud.laz"),
    }
    commands = [command for command in block_commands("docs/quickstart.md") if shlex.join(command.words) in made]
    assert [shlex.join(command.words) for command in commands] == list(made)
    for command in commands:
        if command.words[1] == "poses":
            assert len(list(Path(command.words[2]).glob("*.jpg"))) >= 3
            continue
        done = CliRunner().invoke(app, [*command.words[1:], "--quiet"])
        assert done.exit_code == 0, done.output
        assert [path for path in made[shlex.join(command.words)] if not Path(path).exists()] == []
    assert (tmp_path / "out" / "cloud.laz").stat().st_size > 500

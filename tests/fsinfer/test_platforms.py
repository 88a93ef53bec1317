"""Other machines: without pycolmap, with awkward paths, with decimal commas, with an encoding of their own."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from fsinfer.io.cloud import write_cloud
from fsinfer.io.images import write_image
from fsinfer.io.pfm import read_pfm
from fsinfer.scene import read_scene
from tests.support import foreign_scenes as made
from tests.support.command_line import Call
from tests.support.places import ROOT
from tests.support.plane_scene import write_plane_scene
from tests.support.rendered_room import photographs
from tests.support.report_plot import plot_cloud

AWKWARD = "Größe & Höhe 林 1,5 %"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    # Drawing takes most of the time, and is tested elsewhere.
    monkeypatch.setattr(
        "fsinfer.trees.outputs.figures.write_figures", lambda folder, *_, **__: folder.mkdir(exist_ok=True)
    )


def test_a_scene_on_a_disk_of_another_system_is_read(tmp_path: Path) -> None:
    """macOS puts a file of its own beside each one on exFAT."""
    scene = write_plane_scene(tmp_path / "scene", height=75, width=90)
    names = [view.name for view in read_scene(scene).views]
    for path in [*(scene / "cams").iterdir(), *(scene / "images").iterdir()]:
        path.with_name(f"._{path.name}").write_bytes(bytes([0, 5, 22, 7]))
    assert [view.name for view in read_scene(scene).views] == names


@pytest.mark.parametrize(
    ("system", "machine", "wanted"),
    [
        ("linux", "x86_64", True),
        ("linux", "aarch64", False),
        ("win32", "AMD64", True),
        ("win32", "ARM64", False),
        ("darwin", "arm64", True),
        ("darwin", "x86_64", False),
    ],
)
def test_pycolmap_is_asked_for_where_there_are_wheels_of_it(system: str, machine: str, wanted: bool) -> None:
    environment = {"sys_platform": system, "platform_machine": machine}
    asked = {
        found.name
        for found in map(Requirement, PROJECT["dependencies"])
        if found.marker is None or found.marker.evaluate(environment)
    }
    assert ("pycolmap" in asked) == wanted
    # Nothing else is left out anywhere.
    assert len(asked) == len(PROJECT["dependencies"]) - (not wanted)


def test_the_versions_of_python_are_named() -> None:
    named = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    assert named == ["3.11", "3.12", "3.13", "3.14"]
    assert PROJECT["requires-python"] == f">={named[0]}"


@pytest.fixture
def without_pycolmap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(ImportError):
        import pycolmap  # noqa: F401


@pytest.mark.usefixtures("without_pycolmap", "no_figures")
def test_trees_and_depth_need_no_pycolmap(call: Call, tmp_path: Path) -> None:
    write_cloud(tmp_path / "plot.laz", plot_cloud())
    code, text, _ = call("trees", tmp_path / "plot.laz", tmp_path / "trees", "-q")
    assert (code, "3 trees, 3 with DBH" in text) == (0, True), text
    scene = write_plane_scene(tmp_path / "scene", height=75, width=90)
    assert call("depth", scene, tmp_path / "depth", "--jobs", 1, "-q")[0] == 0
    made.write_colmap(made.truth(made.BROWN), tmp_path / "model", kind="OPENCV", binary=True)
    made.write_photos(made.truth(made.BROWN), tmp_path / "images")
    assert call("depth", tmp_path / "model", tmp_path / "imported", "--jobs", 1, "-q")[0] == 0
    assert call("fuse", tmp_path / "model", tmp_path / "imported", "--no-level", "-q")[0] == 0
    assert (tmp_path / "imported" / "cloud.laz").is_file()


@pytest.mark.usefixtures("without_pycolmap")
@pytest.mark.parametrize("command", ["poses", "run", "check"])
def test_poses_without_pycolmap_say_where_it_comes_from(call: Call, tmp_path: Path, command: str) -> None:
    write_plane_scene(tmp_path / "scene", height=75, width=90)
    code, out, err = call(command, tmp_path / "scene" / "images", tmp_path / "out", "-q")
    assert code == 2
    errors = [line for line in err.splitlines() if line.startswith("Error: ")]
    assert len(errors) == 1
    assert "conda install -c conda-forge 'pycolmap" in errors[0]
    assert "fsinfer depth reads scenes" in errors[0]
    assert "Traceback" not in out + err
    # Before all photographs are looked at, not after.
    assert not (tmp_path / "out" / "frames").exists()


def test_every_module_can_be_imported_without_pycolmap() -> None:
    code = (
        "import sys; sys.modules['pycolmap'] = None\n"
        "import importlib, pkgutil, fsinfer\n"
        "names = [m.name for m in pkgutil.walk_packages(fsinfer.__path__, 'fsinfer.')]\n"
        "for name in names: importlib.import_module(name)\n"
        "print(len(names))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 100


@pytest.mark.usefixtures("no_figures")
def test_frames_poses_depth_and_trees_in_folders_with_awkward_names(call: Call, tmp_path: Path) -> None:
    base = tmp_path / AWKWARD
    for index, image in enumerate(photographs()[:5]):
        write_image(base / "Fotos vom 3. Mai" / f"Bild {index} ü.jpg", image)
    assert call("frames", base / "Fotos vom 3. Mai", base / "gewählt", "-q")[0] == 0
    code, text, err = call("poses", base / "gewählt" / "images", base / "Szene ß", "--jobs", 1, "-q")
    assert code == 0, err
    assert "5 of 5" in text
    assert call("depth", base / "Szene ß", base / "aus 林", "--jobs", 1, "--max-size", 160, "-q")[0] == 0
    names = {view.name for view in read_scene(base / "Szene ß").views}
    assert names == {f"Bild {index} ü" for index in range(5)}
    assert all(read_pfm(base / "aus 林" / "depth" / f"{name}.pfm").size for name in names)
    write_cloud(base / "Wolke ä.laz", plot_cloud())
    code, text, _ = call("trees", base / "Wolke ä.laz", base / "Bäume", "-q")
    assert (code, "3 trees" in text) == (0, True)
    assert (base / "Bäume" / "trees.csv").is_file()


def test_powershell_is_told_the_same_as_sh() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = dict(re.findall(r"```(sh|powershell)\n(.*?demo demo-plot.*?)```", text, flags=re.DOTALL))
    of_sh = [part.strip() for part in blocks["sh"].split("&&")]
    # Windows PowerShell 5 knows no &&, and activates by a script of its own.
    assert "&&" not in blocks["powershell"]
    assert "Activate.ps1" in blocks["powershell"]
    found = [part.strip() for part in re.split(r"[;\n{}]", blocks["powershell"])]
    assert [part for part in found if part in of_sh] == of_sh == ["pip install .", "fsinfer demo demo-plot"]


def run_in(environment: dict[str, str], before: str, *arguments: object, flags: tuple[str, ...] = ()) -> str:
    """The command line in a process of its own, after the code ``before``; returns what it printed."""
    code = (
        f"{before}\nimport sys\nfrom fsinfer.cli.app import main\n"
        "import fsinfer.trees.outputs.figures as figures\n"
        "figures.write_figures = lambda folder, *_, **__: folder.mkdir(exist_ok=True)\n"
        f"sys.argv = {['fsinfer', *map(str, arguments)]!r}\nmain()"
    )
    done = subprocess.run(
        [sys.executable, *flags, "-c", code],
        cwd=ROOT, env=os.environ | environment, capture_output=True, encoding="utf-8", check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_decimal_commas_of_the_system_change_nothing(tmp_path: Path) -> None:
    if shutil.which("localedef") is None or not Path("/usr/share/i18n/locales/de_DE").is_file():
        pytest.skip("no German locale can be made here: localedef and its sources are missing")
    made_locale = tmp_path / "locale" / "de_DE.UTF-8"
    made_locale.parent.mkdir()
    subprocess.run(["localedef", "-i", "de_DE", "-f", "UTF-8", made_locale], check=True, capture_output=True)
    german = {"LOCPATH": str(made_locale.parent), "LC_ALL": "de_DE.UTF-8"}
    # Libraries of other languages set it for the whole process, Python by itself does not.
    use = "import locale; locale.setlocale(locale.LC_ALL, ''); assert locale.localeconv()['decimal_point'] == ','"
    write_cloud(tmp_path / "plot.ply", plot_cloud())
    scene = made.truth(made.BROWN, views=3)
    made.write_metashape(scene, tmp_path / "cameras.xml")
    made.write_photos(scene, tmp_path / "images")
    results = []
    for name, environment, before in (("c", {"LC_ALL": "C.UTF-8"}, ""), ("de", german, use)):
        out = tmp_path / name
        told = run_in(environment, before, "trees", tmp_path / "plot.ply", out, "--scale", "1.25", "-q")
        run_in(environment, before, "depth", tmp_path / "cameras.xml", out, "--jobs", 1, "-q")
        files = ["trees.csv", "scene/cams/IMG_0001_cam.txt", "scene/pair.txt", "depth/depth.json"]
        results.append([told.replace(str(out), ""), *((out / file).read_text(encoding="utf-8") for file in files)])
    assert results[0] == results[1]


def test_texts_are_read_and_written_as_utf8_wherever_it_runs(tmp_path: Path) -> None:
    # On Windows the system's own encoding is another one: whatever leaves it to the system is an error here.
    before = "import warnings; warnings.filterwarnings('error', category=EncodingWarning, module=r'fsinfer\\.')"
    flags = ("-X", "warn_default_encoding")
    write_cloud(tmp_path / "plot.ply", plot_cloud())
    scene = made.truth(made.BROWN, views=3)
    made.write_rtabmap(scene, tmp_path / "map")
    run_in({}, before, "trees", tmp_path / "plot.ply", tmp_path / "out", "-q", flags=flags)
    run_in({}, before, "depth", tmp_path / "map", tmp_path / "out", "--jobs", 1, "-q", flags=flags)
    run_in({}, before, "fuse", tmp_path / "map", tmp_path / "out", "--no-level", "-q", flags=flags)
    run_in({}, before, "report", tmp_path / "out", flags=flags)
    assert (tmp_path / "out" / "report.html").is_file()

"""``import fsinfer`` needs no torch and takes milliseconds; everything named is there."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.support.places import ROOT

HEAVY = ("torch", "distributed", "pycolmap", "matplotlib", "onnxruntime", "laspy", "cv2", "scipy", "numpy", "typer")
# Makes any "import torch" fail, as in an installation without it.
BLOCK_TORCH = "import sys; sys.modules['torch'] = None; "


def run_python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", BLOCK_TORCH + code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_loads_nothing_heavy() -> None:
    loaded = json.loads(run_python("import json, fsinfer; print(json.dumps([n for n, m in sys.modules.items() if m]))"))
    assert "fsinfer.errors" in loaded
    assert [name for name in HEAVY if name in loaded] == []


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import contextlib, io, json; sys.argv = ['fsinfer', '--help']; from fsinfer.cli.app import main\n"
        "with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit): main()\n"
        "print(json.dumps([text.getvalue(), [n for n, m in sys.modules.items() if m]]))"
    )
    text, loaded = json.loads(run_python(code))
    assert "evaluate" in text
    assert [name for name in HEAVY if name in loaded and name != "typer"] == []


@pytest.mark.parametrize("command", ["run", "batch", "depth", "frames", "trees", "evaluate", "check", "marker"])
def test_help_of_a_command_loads_nothing_heavy(command: str) -> None:
    code = (
        f"import contextlib, io, json; sys.argv = ['fsinfer', '{command}', '--help']\n"
        "from fsinfer.cli.app import main\n"
        "with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit): main()\n"
        "print(json.dumps([text.getvalue(), [n for n, m in sys.modules.items() if m]]))"
    )
    text, loaded = json.loads(run_python(code))
    assert "default" in text
    assert [name for name in HEAVY if name in loaded and name != "typer"] == []


def test_every_export_loads_without_torch() -> None:
    assert (
        run_python("import fsinfer; print([getattr(fsinfer, n) is not None for n in fsinfer.__all__])").count("True")
        == 9
    )


def test_fit_circle_is_reached_from_the_package() -> None:
    code = (
        "import numpy as np, fsinfer; a = np.linspace(0, 6.28, 200)\n"
        "fit = fsinfer.trees.fit_circle(np.stack([1 + 0.2 * np.cos(a), 2 + 0.2 * np.sin(a)], axis=1))\n"
        "print(round(float(fit.radius), 3))"
    )
    assert run_python(code).strip() == "0.2"


def test_no_module_of_the_package_imports_torch() -> None:
    code = (
        "import importlib, pkgutil, fsinfer\n"
        "names = [m.name for m in pkgutil.walk_packages(fsinfer.__path__, 'fsinfer.')]\n"
        "for name in names: importlib.import_module(name)\n"
        "print(len(names))"
    )
    assert int(run_python(code)) > 20


def test_unknown_name_is_an_attribute_error() -> None:
    import fsinfer

    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = fsinfer.no_such_thing
    assert {"DepthModel", "measure_trees", "trees"} <= set(dir(fsinfer))


def test_the_build_reads_the_version_that_the_package_tells() -> None:
    import tomllib

    import fsinfer

    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "version" in settings["project"]["dynamic"]
    source = ROOT / settings["tool"]["hatch"]["version"]["path"]
    assert f'__version__ = "{fsinfer.__version__}"' in source.read_text(encoding="utf-8")

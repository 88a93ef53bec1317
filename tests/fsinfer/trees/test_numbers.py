"""Numbers that decide say where they come from, and every setting is read."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import fsinfer

ROOT = Path(fsinfer.__file__).parent
FILES = sorted(path for part in ("trees", "silhouettes") for path in (ROOT / part).rglob("*.py"))
#: Numbers of a file format.
FORMATS = {"maps.py"}
KINDS = ("Source: ", "Numerics: ", "Drawing: ", "Mathematics: ")


def settings_classes() -> Iterator[tuple[Path, ast.ClassDef]]:
    for path in FILES:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and node.name.endswith("Settings"):
                yield path, node


def fields_of(node: ast.ClassDef) -> list[tuple[str, str]]:
    """Names and defaults of the fields."""
    return [
        (item.target.id, ast.unparse(item.value) if item.value is not None else "")
        for item in node.body
        if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
    ]


def entries_of(node: ast.ClassDef) -> dict[str, str]:
    """What the docstring says of each attribute."""
    text = (ast.get_docstring(node) or "").partition("----------\n")[2]
    parts = re.split(r"^([a-z_0-9, ]+): ", text, flags=re.MULTILINE)[1:]
    return {
        name.strip(): said for names, said in zip(parts[::2], parts[1::2], strict=True) for name in names.split(",")
    }


@pytest.mark.parametrize(("path", "node"), [pytest.param(p, n, id=n.name) for p, n in settings_classes()])
def test_settings_say_where_they_come_from_and_are_read(path: Path, node: ast.ClassDef) -> None:
    entries, everything = entries_of(node), "".join(file.read_text(encoding="utf-8") for file in FILES)
    for name, default in fields_of(node):
        assert name in entries, f"{node.name}.{name} is not in the docstring"
        if "default_factory" not in default and name != "seed":
            assert "Source: " in " ".join(entries[name].split()), f"{node.name}.{name} has no source"
        assert re.search(rf"\.{name}\b", everything), f"{node.name}.{name} is read nowhere"


@pytest.mark.parametrize("path", [p for p in FILES if p.name not in FORMATS], ids=lambda path: path.stem)
def test_constants_say_where_they_come_from(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    for node in ast.parse("\n".join(lines)).body:
        value = getattr(node, "value", None) if isinstance(node, ast.Assign | ast.AnnAssign) else None
        if value is None or not any(
            isinstance(x, ast.Constant) and type(x.value) in (int, float) for x in ast.walk(value)
        ):
            continue
        said, above = "", node.lineno - 2
        while lines[above].startswith("#"):
            said, above = f"{lines[above]} {said}", above - 1
        assert said.startswith("#: "), f"{path.name}: {lines[node.lineno - 1]}"
        assert any(kind in said for kind in KINDS), f"{path.name}: {lines[node.lineno - 1]}"

"""Settings are read by somebody, and say where their values come from; the page that lists them is the code's."""

from __future__ import annotations

import ast
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType

import pytest

from fsinfer.conventions.breast_height import BREAST_HEIGHT_M, BhRule
from fsinfer.trees import TreeSettings
from tests.support.places import ROOT


def _load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


make_settings = _load(ROOT / "docs" / "make_settings.py")

#: Packages whose every number says its source.
REQUIRED = (
    "batch",
    "check",
    "cluster",
    "cli",
    "conventions",
    "depth",
    "evaluation",
    "frames",
    "fsinfer",
    "fusion",
    "geometry",
    "importers",
    "io",
    "notices",
    "output",
    "placement",
    "plot_border",
    "poses",
    "report",
    "scale",
    "silhouettes",
    "trees",
    "workflow",
)


class _Settings:
    """The settings dataclasses of some modules, and which of their fields are read where their type is known."""

    def __init__(self, modules: dict[str, ast.Module]) -> None:
        classes = [node for tree in modules.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
        self.fields = {
            node.name: {
                item.target.id: ast.unparse(item.annotation)
                for item in node.body
                if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
            }
            for node in classes
            if make_settings.is_settings(node)
        }
        self.bases = {
            node.name: [ast.unparse(base) for base in node.bases if ast.unparse(base) in self.fields]
            for node in classes
        }
        #: Of every class, the settings that its attributes hold.
        self.attributes: dict[str, dict[str, str]] = {node.name: {} for node in classes}
        self.read: set[tuple[str, str]] = set()
        for node in classes:
            self._find_attributes(node)
        for tree in modules.values():
            self._look_into(tree.body, {})

    def unread(self) -> list[str]:
        """Fields that nobody reads, as ``Class.field``."""
        return [
            f"{name}.{field}"
            for name, fields in self.fields.items()
            for field in fields
            if (name, field) not in self.read
        ]

    def _find_attributes(self, owner: ast.ClassDef) -> None:
        for node in ast.walk(owner):
            if isinstance(node, ast.AnnAssign):
                name = node.target.id if isinstance(node.target, ast.Name) else getattr(node.target, "attr", "")
                for found in self._named(ast.unparse(node.annotation))[:1]:
                    self.attributes[owner.name][name] = found
            elif isinstance(node, ast.FunctionDef):
                types = self._arguments(node)
                for inner in ast.walk(node):
                    if not isinstance(inner, ast.Assign):
                        continue
                    for target in inner.targets:
                        if isinstance(target, ast.Attribute) and (found := self._type_of(inner.value, types)):
                            self.attributes[owner.name][target.attr] = found

    def _named(self, annotation: str) -> list[str]:
        words = "".join(c if c.isalnum() or c == "_" else " " for c in annotation).split()
        return [word for word in words if word in self.fields] or [word for word in words if word in self.attributes]

    def _arguments(self, function: ast.FunctionDef) -> dict[str, str]:
        arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
        return {
            argument.arg: named[0]
            for argument in arguments
            if argument.annotation is not None and (named := self._named(ast.unparse(argument.annotation)))
        }

    def _look_into(self, body: Sequence[ast.AST], types: dict[str, str]) -> None:
        """Find what is read in a body and the functions and classes within; ``types`` are those of its names."""
        inner = [node for node in body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        plain = [found for node in body if node not in inner for found in ast.walk(node)]
        inner += [node for node in plain if isinstance(node, ast.FunctionDef)]
        types = dict(types)
        for _ in range(2):
            for node in plain:
                if isinstance(node, ast.Assign):
                    for target in node.targets:
                        for one, value in make_settings._pairs(target, node.value):
                            if found := self._type_of(value, types):
                                types[one] = found
        for node in plain:
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
                owner = self._type_of(node.value, types)
                self.read |= {(name, node.attr) for name in self._line(owner) if node.attr in self.fields[name]}
        for node in inner:
            if isinstance(node, ast.ClassDef):
                self._look_into(node.body, types | {"self": node.name})
            else:
                self._look_into(
                    [*node.body, *node.args.defaults, *filter(None, node.args.kw_defaults)],
                    types | self._arguments(node),
                )

    def _line(self, name: str) -> Iterator[str]:
        if name in self.fields:
            yield name
            for base in self.bases[name]:
                yield from self._line(base)

    def _type_of(self, node: ast.expr, types: dict[str, str]) -> str:
        """The settings class of an expression, empty where it is none."""
        if isinstance(node, ast.Name):
            return types.get(node.id, node.id if node.id in self.fields else "")
        if isinstance(node, ast.BoolOp):
            return next((found for value in node.values if (found := self._type_of(value, types))), "")
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func)
            if name == "replace" and node.args:
                return self._type_of(node.args[0], types)
            return name if name in self.fields else ""
        if isinstance(node, ast.Attribute):
            owner = self._type_of(node.value, types)
            for name in self._line(owner):
                if node.attr in self.fields[name]:
                    return next(iter(self._named(self.fields[name][node.attr])), "")
            return self._attribute(owner, node.attr)
        return ""

    def _attribute(self, owner: str, attribute: str) -> str:
        if owner in self.attributes:
            return self.attributes[owner].get(attribute, "")
        # Of an object of unknown class: the settings that all attributes of this name hold.
        found = {known[attribute] for known in self.attributes.values() if attribute in known}
        return found.pop() if len(found) == 1 else ""


def _package() -> dict[str, ast.Module]:
    return {str(path): ast.parse(path.read_text(encoding="utf-8")) for path in sorted((ROOT / "fsinfer").rglob("*.py"))}


def test_every_setting_is_read() -> None:
    found = _Settings(_package())
    assert len(found.fields) > 20
    assert found.unread() == []


def test_a_setting_that_nobody_reads_is_found() -> None:
    source = """
@dataclass(frozen=True)
class InnerSettings:
    used: float = 1.0
    unused: float = 2.0

@dataclass(frozen=True)
class OuterSettings(InnerSettings):
    inner: InnerSettings = field(default_factory=InnerSettings)

def work(other, settings: OuterSettings | None = None):
    s = settings or OuterSettings()
    return s.inner.used + other.unused
"""
    assert _Settings({"m": ast.parse(source)}).unread() == ["InnerSettings.unused"]


def test_the_page_is_the_codes_and_every_number_says_its_source() -> None:
    assert make_settings.main(["--check", "--require", *REQUIRED]) == 0


def test_a_number_without_a_source_and_a_stale_page_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "fsinfer" / "depth"
    folder.mkdir(parents=True)
    (tmp_path / "docs").mkdir()
    monkeypatch.setattr(make_settings, "ROOT", tmp_path)
    monkeypatch.setattr(make_settings, "PAGE", tmp_path / "docs" / "settings.md")
    module = folder / "stage.py"
    module.write_text(
        "#: How far. Source: judgement.\nREACH_M = 2.5\n\n\n@dataclass(frozen=True)\nclass DepthSettings:\n"
        '    """All.\n\n    Attributes\n    ----------\n    one, two_px: both, as\n        one. Source: a paper.\n'
        '    """\n\n'
        "    one: float = 1.0\n    two_px: float = 2.0\n    three: int = 3  # alone. Source: numerics.\n",
        encoding="utf-8",
    )
    assert make_settings.main(["--check"]) == 1
    assert "stale" in capsys.readouterr().err
    assert make_settings.main([]) == 0
    assert make_settings.main(["--check", "--require", "depth"]) == 0
    page = (tmp_path / "docs" / "settings.md").read_text(encoding="utf-8")
    assert "| `two_px` | `2.0` | px | both, as one. | a paper |" in page
    assert "| [depth](#depth) | 3 | 0 | 1 | 0 | 0 | 0 |" in page
    module.write_text(
        module.read_text(encoding="utf-8") + "\n\n#: Numerics: steps.\nSTEPS = 9\n\nFAR = 7\n", encoding="utf-8"
    )
    assert make_settings.main(["--require", "depth"]) == 1
    told = capsys.readouterr().err
    assert "FAR does not say its source" in told
    assert "STEPS" not in told
    assert make_settings.main(["--check", "--require", "trees"]) == 0


def test_breast_height_is_one_number_and_one_rule() -> None:
    assert TreeSettings().bh_m == BREAST_HEIGHT_M
    assert BhRule(TreeSettings().bh_rule) == BhRule.midpoint

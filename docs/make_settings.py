"""Write docs/settings.md: every number of fsinfer that has a name, its unit, what it does, and where it comes from.

``python docs/make_settings.py`` writes the page; ``--check`` fails where the page is stale, and with ``--require
PACKAGE ...`` where a number of these packages does not say its source; ``--count FOLDER`` counts the numbers of another
checkout. The code is read, never imported.

What it reads:

- a *setting*: a field of a dataclass whose name ends in ``Settings``, ``Limits``, ``Tolerances`` or ``Request``. What
  it does stands in the class docstring's section ``Attributes`` or in a comment on its line;
- a *constant*: a name in capitals at the top of a module whose value is made of numbers, with a comment above it that
  begins with ``#:``.

Either text holds ``Source: ...`` up to its end. A source that begins with ``option`` (the user decides),
``numerics`` (how exactly or in what pieces something is computed or stored), ``layout`` (of a picture, page or
message) or ``format`` (given by a file format or library) marks a number that was not tuned; the others are
*tunables*. A line ``Source of the rest: ...`` in the class docstring holds for all of its fields that name none.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "settings.md"
UNSTATED = "source not stated"
# How the names of dataclasses of settings end.
_SETTINGS = ("Settings", "Limits", "Tolerances", "Request")
KINDS = ("tunable", "option", "numerics", "layout", "format")
# The end of a name and its unit; other numbers are counts, shares, factors, or say their unit in words.
_UNITS = {
    "m": "m", "mm": "mm", "cm": "cm", "px": "px", "px2": "px²", "deg": "°", "s": "s", "gb": "GB", "bytes": "bytes",
    "points": "points", "views": "views", "photos": "photos", "pixels": "pixels", "rad": "rad", "m2": "m²",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Number:
    """One setting or constant; ``owner`` is its class, empty for a constant of the module."""

    module: str
    owner: str
    name: str
    default: str
    text: str
    source: str

    @property
    def package(self) -> str:
        """The package of fsinfer that it belongs to; modules at the top are ``fsinfer`` itself."""
        parts = self.module.split(".")
        return parts[1] if len(parts) > 2 else "fsinfer"

    @property
    def unit(self) -> str:
        """From the end of the name."""
        return _UNITS.get(self.name.lower().rsplit("_", 1)[-1], "") if "_" in self.name.strip("_") else ""

    @property
    def kind(self) -> str:
        """One of ``KINDS``."""
        return next((kind for kind in KINDS[1:] if self.source.startswith(kind)), KINDS[0])


def read_numbers(folder: Path) -> list[Number]:
    """All numbers of the package whose folder is given, in the order of modules and lines."""
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(folder.rglob("*.py"))}
    trees = {path: ast.parse(text) for path, text in texts.items()}
    known = {name: value for tree in trees.values() for name, value in _simple_values(tree)}
    found: list[Number] = []
    for path, tree in trees.items():
        parts = path.relative_to(folder.parent).with_suffix("").parts
        module = ".".join(part for part in parts if part != "__init__")
        found += [_resolved(number, known) for number in _of_module(module, tree, texts[path].splitlines())]
    return found


def _simple_values(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """``NAME`` and ``Class.name`` of what is given a plain value, with that value."""
    for node in tree.body:
        statements = [(f"{node.name}.", item) for item in node.body] if isinstance(node, ast.ClassDef) else [("", node)]
        for owner, item in statements:
            if isinstance(item, ast.Assign | ast.AnnAssign) and isinstance(item.value, ast.Constant):
                target = item.targets[0] if isinstance(item, ast.Assign) else item.target
                yield owner + ast.unparse(target), ast.unparse(item.value)


def _resolved(number: Number, known: dict[str, str]) -> Number:
    """The same with the value in place of the name that its default is taken from."""
    return replace(number, default=known.get(number.default.removesuffix(".value"), number.default))


def unnamed_literals(folder: Path) -> int:
    """Numbers other than 0, 1, 2, 3 and 4 that stand in functions of the package and have no name."""
    plain = {0, 1, 2, 3, 4}
    count = 0
    for path in sorted(folder.rglob("*.py")):
        places: set[tuple[int, int]] = set()
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef | ast.Lambda):
                places |= {
                    (node.lineno, node.col_offset)
                    for node in ast.walk(function)
                    if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value not in plain
                }
        count += len(places)
    return count


def _of_module(module: str, tree: ast.Module, lines: list[str]) -> Iterator[Number]:
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and is_settings(node):
            documented, rest = _attributes(ast.get_docstring(node) or "")
            for field in _fields(node):
                if _is_nested(field):
                    continue
                name = field.target.id  # type: ignore[union-attr]
                text, source = _split(documented.get(name) or _comment(lines[(field.end_lineno or field.lineno) - 1]))
                default = "" if field.value is None else ast.unparse(field.value)
                yield Number(
                    module=module, owner=node.name, name=name, default=default, text=text, source=source or rest
                )
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            text, source = _split(_comment_above(lines, node.lineno) or _comment(lines[node.lineno - 1]))
            for name, value in (pair for target in targets for pair in _pairs(target, node.value)):
                if name.strip("_").isupper() and _is_number(value):
                    yield Number(module=module, owner="", name=name, default=_shown(value), text=text, source=source)


def is_settings(node: ast.ClassDef) -> bool:
    """Whether a class is a dataclass of settings."""
    if not any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list):
        return False
    return node.name.endswith(_SETTINGS)


def _fields(node: ast.ClassDef) -> list[ast.AnnAssign]:
    return [
        item for item in node.body if isinstance(item, ast.AnnAssign) and "ClassVar" not in ast.unparse(item.annotation)
    ]


def _is_nested(field: ast.AnnAssign) -> bool:
    """Settings within settings: they are listed themselves."""
    return field.value is not None and "default_factory" in ast.unparse(field.value)


def _pairs(target: ast.expr, value: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    if isinstance(target, ast.Name):
        yield target.id, value
    elif isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
        for one, its in zip(target.elts, value.elts, strict=True):
            yield from _pairs(one, its)


def _is_number(value: ast.expr) -> bool:
    """Whether a value is made of numbers: itself, a collection of them, or what a call makes of them."""
    if isinstance(value, ast.Subscript | ast.JoinedStr | ast.ListComp | ast.DictComp):
        return False
    if isinstance(value, ast.Call):
        name = ast.unparse(value.func).split(".")[-1]
        # An object that has a number in it is none, but settings of a special case are.
        if name == "field" or (name[0].isupper() and not name.endswith(_SETTINGS)):
            return False
    return any(isinstance(node, ast.Constant) and type(node.value) in (int, float) for node in ast.walk(value))


def _shown(value: ast.expr) -> str:
    text = ast.unparse(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _comment(line: str) -> str:
    """The comment at the end of a line of code."""
    found = re.search(r"\s#:?\s(?!noqa|type:)(.*)$", line)
    return found.group(1).strip() if found else ""


def _comment_above(lines: list[str], lineno: int) -> str:
    """The block of comment lines right above a line."""
    block: list[str] = []
    for line in reversed(lines[: lineno - 1]):
        if not line.startswith("#"):
            break
        block.insert(0, line.removeprefix("#").removeprefix(":").strip())
    return " ".join(block)


def _attributes(docstring: str) -> tuple[dict[str, str], str]:
    """What the section ``Attributes`` says of each name, and the source that holds for the rest."""
    entries: dict[str, str] = {}
    names: list[str] = []
    inside = False
    lines = docstring.splitlines()
    for index, line in enumerate(lines):
        following = lines[index + 1].strip() if index + 1 < len(lines) else ""
        if following and set(following) == {"-"}:
            inside = line.strip() == "Attributes"
            names = []
        elif not inside or (line.strip() and set(line.strip()) == {"-"}) or not line.strip():
            continue
        elif not line.startswith(" "):
            head, _, text = line.partition(":")
            names = [name.strip() for name in head.split(",")]
            entries |= dict.fromkeys(names, text.strip())
        else:
            entries |= {name: f"{entries[name]} {line.strip()}" for name in names}
    rest = re.search(r"Source of the rest:\s*(.+?)(?=\n\s*\n|\n\w+\n---|\Z)", docstring, re.DOTALL)
    return entries, " ".join(rest.group(1).split()).rstrip(".") if rest else ""


def _split(text: str) -> tuple[str, str]:
    """What it does, and its source."""
    what, _, source = text.partition("Source:")
    return what.strip(), source.strip().rstrip(".")


def page(numbers: list[Number]) -> str:
    """The page as Markdown."""
    packages = sorted({number.package for number in numbers})
    rows = [
        "<!-- Generated by docs/make_settings.py; change the code and run it again. -->",
        "",
        "# Settings and constants",
        "",
        "Every number of fsinfer that has a name. *Tunables* decide what comes out, and say where their value comes",
        "from; *judgement* means that it was not compared with others on data, and *renders only* that the data were",
        "rendered. *Options* are for the user to decide; *numerics* say how exactly or in what pieces something is",
        "computed or stored, *layout* how pictures, pages and messages look, *format* what a file or library asks for.",
        "",
        "| package | tunables | options | numerics | layout | format | source not stated |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    for package in packages:
        rows.append(f"| [{package}](#{package}) | {_counts([n for n in numbers if n.package == package])} |")
    rows.append(f"| **all** | {_counts(numbers)} |")
    for package in packages:
        own = [number for number in numbers if number.package == package]
        rows += ["", f"## {package}"]
        for place in dict.fromkeys((number.module, number.owner) for number in own):
            module, owner = place
            title = f"`{owner}` in `{module}`" if owner else f"`{module}`"
            rows += [
                "",
                f"### {title}",
                "",
                "| name | default | unit | what it does | source |",
                "|---|---|---|---|---|",
            ]
            for number in own:
                if (number.module, number.owner) == place:
                    cells = (f"`{number.name}`", f"`{number.default}`" if number.default else "", number.unit)
                    rows.append(
                        "| " + " | ".join(_cell(c) for c in (*cells, number.text, number.source or UNSTATED)) + " |"
                    )
    return "\n".join(rows) + "\n"


def _cell(text: str) -> str:
    # Roles of the API reference mean nothing on a page of Markdown.
    plain = re.sub(r":\w+:`([^`]*)`", r"`\1`", text).replace("``", "`")
    return plain.replace("|", "\\|")


def _counts(numbers: list[Number]) -> str:
    of_kind = [sum(number.kind == kind for number in numbers) for kind in KINDS]
    return " | ".join(str(count) for count in (*of_kind, sum(not number.source for number in numbers)))


def unstated(numbers: list[Number], packages: list[str]) -> list[str]:
    """The numbers of these packages that do not say their source."""
    return [
        f"{number.module}: {f'{number.owner}.' if number.owner else ''}{number.name} does not say its source"
        for number in numbers
        if number.package in packages and not number.source
    ]


def main(arguments: list[str] | None = None) -> int:
    """Write or check the page; the exit status says whether all is well."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0] if __doc__ else None)
    parser.add_argument("--check", action="store_true", help="write nothing; fail where the page is stale")
    parser.add_argument("--require", nargs="+", default=[], metavar="PACKAGE", help="whose numbers must say a source")
    parser.add_argument("--count", type=Path, metavar="FOLDER", help="count the numbers of this folder of a package")
    options = parser.parse_args(arguments)
    if options.count is not None:
        numbers = read_numbers(options.count)
        for package in sorted({number.package for number in numbers}):
            own = [number for number in numbers if number.package == package]
            fields = sum(bool(number.owner) for number in own)
            folder = options.count / package if package != "fsinfer" else options.count
            literals = unnamed_literals(folder) if package != "fsinfer" else 0
            sys.stdout.write(
                f"{package}: {fields} settings + {len(own) - fields} constants, of them "
                f"{sum(n.kind == 'tunable' for n in own)} tunable; {literals} unnamed in functions\n"
            )
        return 0
    numbers = read_numbers(ROOT / "fsinfer")
    faults = unstated(numbers, options.require)
    text = page(numbers)
    if not options.check:
        PAGE.write_text(text, encoding="utf-8")
    elif not PAGE.is_file() or PAGE.read_text(encoding="utf-8") != text:
        faults.append(f"{PAGE.relative_to(ROOT)} is stale: run python docs/make_settings.py")
    for fault in faults:
        sys.stderr.write(f"{fault}\n")
    return 1 if faults else 0


if __name__ == "__main__":
    raise SystemExit(main())

"""Small breakages of Python source: one place each, the rest of the file as it stands.

What is broken: numbers (doubled, halved, one more), arithmetic (the other operator, or its right side left out),
comparisons and conditions (turned round), ``and``/``or``, signs, bounds (``max`` for ``min``, no clipping), sums that
are built up (``+=`` left out), branches of a conditional expression (changed over), and the first two arguments of a
call (changed over).

What is not: texts, annotations, what is logged or raised; numbers below :data:`GUARD`, which only keep a division from
failing; ``strict`` of ``zip``, which only keeps a mistake from going on; numbers that the code declares to decide
nothing (``Source: numerics``, ``layout`` or ``format``); and whether a bound itself belongs to an interval of
floating-point numbers (``<`` against ``<=``), which no input shows.
"""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass

#: Numbers nearer to 0 keep a division from failing. Source: numerics.
GUARD = 1e-5
#: Sources of numbers that decide nothing (CONTRIBUTING.md, "A number that decides something").
UNDECIDING = ("numerics", "layout", "format")
OTHER_OPERATOR: dict[type[ast.operator], str] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.FloorDiv: "*",
    ast.Mod: "//",
    ast.Pow: "*",
    ast.BitAnd: "|",
    ast.BitOr: "&",
}
OTHER_COMPARISON: dict[type[ast.cmpop], str] = {
    ast.Lt: ">=",
    ast.LtE: ">",
    ast.Gt: "<=",
    ast.GtE: "<",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
OTHER_BOUND = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}
#: Calls whose arguments may change places without any effect.
SYMMETRIC = {*OTHER_BOUND, "hypot", "logical_and", "logical_or", "zip", "isclose", "multiply", "add"}


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """One breakage: ``source[start:end]`` (bytes of UTF-8) becomes ``after``.

    Attributes
    ----------
    file: below the repository. line: counted from 1. column: in bytes. where: the function or class it is in.
    kind: of the breakage. before, after: the text at that place. code: the stripped line.
    """

    file: str
    line: int
    column: int
    where: str
    kind: str
    start: int
    end: int
    before: str
    after: str
    code: str

    @property
    def name(self) -> str:
        """Stays the same while its line does: file, place, line's text and breakage, as a short digest."""
        told = "\0".join((self.file, self.where, self.code, str(self.column), self.kind, self.before, self.after))
        return hashlib.sha256(told.encode()).hexdigest()[:12]

    def apply(self, source: str) -> str:
        """The broken source."""
        data = source.encode()
        return (data[: self.start] + self.after.encode() + data[self.end :]).decode()


def mutants_of(source: str, file: str) -> list[Mutant]:
    """All breakages of a module, by place."""
    found = sorted(_Finder(source, file).find(), key=lambda mutant: (mutant.start, mutant.end, mutant.after))
    return [mutant for mutant in found if mutant.after != mutant.before]


def is_python(source: str) -> bool:
    """Whether it can be read: a breakage that cannot says nothing about the tests."""
    try:
        ast.parse(source)
    except SyntaxError:
        return False
    return True


class _Finder:
    """Walks a module with what it has to know of each place."""

    def __init__(self, source: str, file: str) -> None:
        self.file = file
        self.data = source.encode()
        self.lines = source.splitlines()
        starts = [0]
        for line in self.data.splitlines(keepends=True):
            starts.append(starts[-1] + len(line))
        self.line_starts = starts
        self.tree = ast.parse(source)

    def find(self) -> Iterator[Mutant]:
        yield from self._walk(self.tree, (), None)

    def _walk(self, node: ast.AST, where: tuple[str, ...], owner: ast.ClassDef | None) -> Iterator[Mutant]:
        if self._skipped(node, where, owner):
            return
        yield from self._at(node, ".".join(where))
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "bases", "type_params"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.ClassDef | ast.FunctionDef):
                    inner = child if isinstance(child, ast.ClassDef) else None
                    yield from self._walk(child, (*where, child.name), inner)
                elif isinstance(child, ast.AST):
                    yield from self._walk(child, where, owner)

    def _skipped(self, node: ast.AST, where: tuple[str, ...], owner: ast.ClassDef | None) -> bool:
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Assert):
            return True
        if isinstance(node, ast.keyword) and node.arg == "strict":
            return True
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return True
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return True  # a docstring
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            if called.startswith(("_log.", "logging.", "field", "progress", "notice", "print", "parser.")):
                return True
            return called.endswith(("add_argument", "warning")) or "Error" in called
        if isinstance(node, ast.Assign | ast.AnnAssign):
            if owner is not None and isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                return self._declared_undeciding(ast.get_docstring(owner) or "", node.target.id)
            if not where:
                return self._comment_above(node.lineno).endswith(tuple(f"Source: {kind}" for kind in UNDECIDING))
        return False

    @staticmethod
    def _declared_undeciding(docstring: str, name: str) -> bool:
        told = re.search(rf"^\s*(?:\w+, )*{name}\b.*?Source: (\w+)", docstring, flags=re.DOTALL | re.MULTILINE)
        return told is not None and told.group(1) in UNDECIDING

    def _comment_above(self, line: int) -> str:
        """The comment above a constant, cut off after the first word of its source."""
        above: list[str] = []
        while line >= 2 and self.lines[line - 2].startswith("#:"):
            above.insert(0, self.lines[line - 2][2:].strip())
            line -= 1
        told = re.match(r".*?Source: \w+", " ".join(above))
        return told.group(0) if told else ""

    def _at(self, node: ast.AST, where: str) -> Iterator[Mutant]:
        if isinstance(node, ast.Constant):
            yield from self._constant(node, where)
        elif isinstance(node, ast.BinOp):
            yield from self._arithmetic(node, where)
        elif isinstance(node, ast.AugAssign):
            yield self._mutant(node, where, "left out", "pass")
        elif isinstance(node, ast.Compare) and len(node.ops) == 1:
            other = OTHER_COMPARISON[type(node.ops[0])]
            text = f"{self._text(node.left)} {other} {self._text(node.comparators[0])}"
            yield self._mutant(node, where, "comparison", f"({text})")
        elif isinstance(node, ast.Compare):
            yield self._mutant(node, where, "comparison", f"(not ({self._text(node)}))")
        elif isinstance(node, ast.BoolOp):
            word, other = (" and ", " or ") if isinstance(node.op, ast.And) else (" or ", " and ")
            parts = [f"({self._text(value)})" for value in node.values]
            yield self._mutant(node, where, "condition", f"({other.join(parts)})")
            yield self._mutant(node, where, "left out", f"({word.join(parts[:-1])})")
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
            yield self._mutant(node, where, "sign", f"({self._text(node.operand)})")
        elif isinstance(node, ast.IfExp):
            body, other = f"({self._text(node.body)})", f"({self._text(node.orelse)})"
            yield self._mutant(node, where, "branches", f"({other} if {self._text(node.test)} else {body})")
        elif isinstance(node, ast.If | ast.While) and isinstance(node.test, ast.Name | ast.Call | ast.Attribute):
            yield self._mutant(node.test, where, "condition", f"not ({self._text(node.test)})")
        elif isinstance(node, ast.Call):
            yield from self._call(node, where)

    def _constant(self, node: ast.Constant, where: str) -> Iterator[Mutant]:
        value = node.value
        if isinstance(value, bool):
            yield self._mutant(node, where, "number", str(not value))
        elif isinstance(value, int):
            yield self._mutant(node, where, "number", str(value + 1))
        elif isinstance(value, float) and abs(value) >= GUARD:
            yield self._mutant(node, where, "number", repr(2 * value))
            yield self._mutant(node, where, "number", repr(value / 2))

    def _arithmetic(self, node: ast.BinOp, where: str) -> Iterator[Mutant]:
        if isinstance(node.left, ast.Constant) and isinstance(node.left.value, str):
            return
        left, right = self._text(node.left), self._text(node.right)
        other = OTHER_OPERATOR.get(type(node.op))
        if other is not None:
            yield self._mutant(node, where, "operator", f"(({left}) {other} ({right}))")
            yield self._mutant(node, where, "left out", f"({left})")

    def _call(self, node: ast.Call, where: str) -> Iterator[Mutant]:
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if called in OTHER_BOUND:
            text = self._text(node.func)
            swapped = text[: len(text) - len(called)] + OTHER_BOUND[called]
            yield self._mutant(node.func, where, "bound", swapped)
        if called in ("clip", "clamp", "clamp_min") and node.args:
            clipped = node.args[0] if called == "clip" else node.func.value  # type: ignore[attr-defined]
            yield self._mutant(node, where, "bound", f"({self._text(clipped)})")
        if called in SYMMETRIC or len(node.args) < 2 or any(isinstance(arg, ast.Starred) for arg in node.args[:2]):
            return
        first, second = node.args[:2]
        between = self.data[self._end(first) : self._start(second)].decode()
        text = self._text(second) + between + self._text(first)
        yield self._span(self._start(first), self._end(second), first.lineno, where, "arguments", text)

    def _start(self, node: ast.AST) -> int:
        return self.line_starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined, no-any-return]

    def _end(self, node: ast.AST) -> int:
        return self.line_starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined, no-any-return]

    def _text(self, node: ast.AST) -> str:
        return self.data[self._start(node) : self._end(node)].decode()

    def _mutant(self, node: ast.expr | ast.stmt, where: str, kind: str, after: str) -> Mutant:
        return self._span(self._start(node), self._end(node), node.lineno, where, kind, after)

    def _span(self, start: int, end: int, line: int, where: str, kind: str, after: str) -> Mutant:
        return Mutant(
            file=self.file,
            line=line,
            column=start - self.line_starts[line - 1],
            where=where,
            kind=kind,
            start=start,
            end=end,
            before=self.data[start:end].decode(),
            after=after,
            code=self.lines[line - 1].strip(),
        )

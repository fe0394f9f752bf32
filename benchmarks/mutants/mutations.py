"""Mutants of a source text: a comparison, sign, factor, bound or condition changed, or a term left out."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

_COMPARISONS = {
    ast.Lt: ("<", ("<=", ">")),
    ast.LtE: ("<=", ("<", ">=")),
    ast.Gt: (">", (">=", "<")),
    ast.GtE: (">=", (">", "<=")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: ("is not", ("is",)),
}
_ARITHMETIC = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Pow: ("**", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.BitAnd: ("&", "|"),
    ast.BitOr: ("|", "&"),
}
_PAIRS = [("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("any", "all"), ("sin", "cos")]
_OPPOSITES = {a: b for pair in _PAIRS for a, b in (pair, pair[::-1])}


@dataclass(frozen=True)
class Mutant:
    """Part of a file that is replaced.

    Attributes:
        path: of the file, relative to the project.
        line: of the part's beginning, counted from 1.
        start, end: of the part, in bytes of the file.
        old, new: text of the part.
    """

    path: str
    line: int
    start: int
    end: int
    old: str
    new: str

    def apply(self, source: bytes) -> bytes:
        """Return the source with the part replaced."""
        return source[: self.start] + self.new.encode() + source[self.end :]

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {' '.join(self.old.split()) or 'nothing'} -> {self.new or 'nothing'}"


def list_mutants(path: str, source: bytes) -> list[Mutant]:
    """Return all mutants of a file; annotations, messages, imports and class headers are left as they are."""
    begins = [0]
    for text in source.splitlines(keepends=True):
        begins.append(begins[-1] + len(text))
    mutants = []
    for line, first, last, new in _visit(ast.parse(source), source, begins):
        mutants.append(Mutant(path, line, first, last, source[first:last].decode(), new))
    return sorted(mutants, key=lambda mutant: (mutant.start, mutant.end, mutant.new))


def _visit(node: ast.AST, source: bytes, begins: list[int]) -> Iterator[tuple[int, int, int, str]]:
    """Yield line, first and last byte and replacement of all mutants in a node."""
    if isinstance(node, ast.expr):
        for first, last, new in _mutate(node, source, begins):
            yield node.lineno, first, last, new
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases", "type_params"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, (ast.JoinedStr, ast.Raise, ast.Import)):
                yield from _visit(child, source, begins)


def _mutate(node: ast.expr, source: bytes, begins: list[int]) -> Iterator[tuple[int, int, str]]:
    """Yield the mutants of one expression, without those of its parts."""

    def begin(part: ast.expr) -> int:
        return begins[part.lineno - 1] + part.col_offset

    def end(part: ast.expr) -> int:
        return begins[(part.end_lineno or part.lineno) - 1] + (part.end_col_offset or 0)

    def between(left: ast.expr, right: ast.expr, old: str, *new: str) -> Iterator[tuple[int, int, str]]:
        gap = re.sub(rb"#[^\n]*", lambda comment: b" " * len(comment[0]), source[end(left) : begin(right)])
        at = end(left) + gap.index(old.encode())
        yield from ((at, at + len(old), each) for each in new)

    match node:
        case ast.Compare(left=left, ops=ops, comparators=rights):
            for a, op, b in zip([left, *rights[:-1]], ops, rights, strict=True):
                if type(op) in _COMPARISONS:
                    yield from between(a, b, _COMPARISONS[type(op)][0], *_COMPARISONS[type(op)][1])
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _ARITHMETIC and not _is_text(left, right):
            yield from between(left, right, *_ARITHMETIC[type(op)])
            if isinstance(op, (ast.Add, ast.Sub)):  # without the right term
                ((at, _, _),) = between(left, right, *_ARITHMETIC[type(op)])
                yield at, end(node), ""
        case ast.BoolOp(op=op, values=values):
            old, new = ("and", "or") if isinstance(op, ast.And) else ("or", "and")
            for a, b in pairwise(values):
                yield from between(a, b, old, new)
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert() as op):
            yield begin(node), begin(node) + (3 if isinstance(op, ast.Not) else 1), ""
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name) as function) if name in _OPPOSITES:
            yield end(function) - len(name), end(function), _OPPOSITES[name]
        case ast.Constant(value=bool(value)):
            yield begin(node), end(node), str(not value)
        case ast.Constant(value=int(value)):
            yield begin(node), end(node), str(value + 1)
        case ast.Constant(value=float(value)):
            yield begin(node), end(node), repr(10.0 * value) if value else "1.0"


def _is_text(*parts: ast.expr) -> bool:
    """Return whether one of the parts is a string."""
    return any(
        isinstance(p, ast.JoinedStr) or (isinstance(p, ast.Constant) and isinstance(p.value, str)) for p in parts
    )

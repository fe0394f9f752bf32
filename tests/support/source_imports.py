"""Imports of source files."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")


@cache
def list_import_statements(file: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """Return the import statements anywhere in a file; expressions hold none and are not looked at."""
    found: list[ast.Import | ast.ImportFrom] = []
    left: list[ast.AST] = [ast.parse(file.read_bytes())]
    while left:
        node = left.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        for block in BLOCKS:
            left += getattr(node, block, ())
    return tuple(found)

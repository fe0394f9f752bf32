"""The folders of ``service`` import what the table of the architecture says, and nothing else."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from source_imports import list_import_statements

ROOT = Path(__file__).parents[2]
SERVICE = ROOT / "service"
EVERYWHERE = {"errors", "proto"}  # modules without imports of their own, and generated ones


def read_table() -> dict[str, set[str]]:
    """What each part of ``service`` may import, as ARCHITECTURE.md has it."""
    _, _, section = (ROOT / "ARCHITECTURE.md").read_text().partition("## What may import what\n")
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \|$", section.partition("\n## ")[0], flags=re.MULTILINE)
    return {name: set(re.findall(r"`(\w+)`", text)) for name, text in rows}


def list_parts() -> set[str]:
    found = {file.relative_to(SERVICE).parts[0].removesuffix(".py") for file in SERVICE.rglob("*.py")}
    return found - EVERYWHERE - {"__init__"}


def list_imports(file: Path) -> Iterator[str]:
    """Parts of ``service`` that a file imports, anywhere in it."""
    for node in list_import_statements(file):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            names = [f"{node.module}.{alias.name}" for alias in node.names if node.module]
        yield from (name.split(".")[1] for name in names if name.startswith("service."))


def test_each_folder_imports_what_the_table_allows() -> None:
    allowed, parts = read_table(), list_parts()
    assert set(allowed) == parts
    beyond = {
        f"{file.relative_to(ROOT)} imports {name}"
        for file in SERVICE.rglob("*.py")
        if (own := file.relative_to(SERVICE).parts[0].removesuffix(".py")) in parts
        for name in set(list_imports(file)) & parts
        if name != own and name not in allowed[own]
    }
    assert beyond == set(), "ask whether it should, then add it to the table of ARCHITECTURE.md"


def test_the_table_allows_nothing_that_nobody_imports() -> None:
    used: dict[str, set[str]] = {}
    for file in SERVICE.rglob("*.py"):
        used.setdefault(file.relative_to(SERVICE).parts[0].removesuffix(".py"), set()).update(list_imports(file))
    unused = {name: rest for name, allowed in read_table().items() if (rest := allowed - used[name])}
    assert unused == {}


def test_the_modules_of_the_verifier_are_imported_by_its_own_folder_only() -> None:
    inside = {
        f"{file.relative_to(ROOT)} imports {node.module}"
        for folder in ("service", "benchmarks", "examples", "tools")
        for file in (ROOT / folder).rglob("*.py")
        if file.relative_to(ROOT).parts[:2] != ("service", "verify")
        for node in list_import_statements(file)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("service.verify.")
    }
    assert inside == set(), "export what others need in service/verify/__init__.py"


def find_source(module: str) -> Path | None:
    path = ROOT / module.replace(".", "/")
    files = (path.with_suffix(".py"), path / "__init__.py")
    return next((file for file in files if file.is_file()), None)


def test_benchmarks_examples_and_tools_import_what_there_is() -> None:
    """No test runs all of them, and an import that fails is otherwise found years later."""
    missing, texts = set(), dict[str, str]()
    for folder in ("benchmarks", "examples", "tools"):
        for file in (ROOT / folder).rglob("*.py"):
            for node in list_import_statements(file):
                module = node.module or "" if isinstance(node, ast.ImportFrom) else node.names[0].name
                if module.split(".")[0] not in ("service", "costs", "perception", "benchmarks") or "_pb2" in module:
                    continue
                source = find_source(module)
                text = texts.setdefault(module, source.read_text() if source else "")
                names = [alias.name for alias in node.names] if isinstance(node, ast.ImportFrom) else []
                if source is None or any(
                    not re.search(rf"\b{name}\b", text) and find_source(f"{module}.{name}") is None for name in names
                ):
                    missing.add(f"{file.relative_to(ROOT)} imports {module}: {', '.join(names)}")
    assert missing == set()

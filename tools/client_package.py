"""Assemble the source tree of the distribution ``scopt-client``: ``python tools/client_package.py FOLDER``.

It has the modules that ``service.client`` and the reader of request files import, also within functions, and nothing
else. ``pip wheel --no-deps FOLDER`` makes the wheel; ``make client`` does both.
"""

from __future__ import annotations

import ast
import re
import shutil
import sys
import tomllib
from importlib.util import resolve_name
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGING = ROOT / "packaging" / "client"
ROOTS = ("service.client", "service.client.program", "service.request.file")
OWN = ("scopt", "costs", "perception", "service")


def list_modules() -> list[Path]:
    """Return the files of the client, relative to the root of the project."""
    found: set[Path] = set()
    waiting = list(ROOTS)
    while waiting:
        parts = waiting.pop().split(".")
        for length in range(1, len(parts) + 1):
            path = _find_file(".".join(parts[:length]))
            if path is None or path in found:
                continue
            found.add(path)
            waiting += _list_imports(".".join(parts[:length]), path)
    return sorted(path.relative_to(ROOT) for path in found)


def assemble(target: Path) -> None:
    """Write the source tree to a new folder."""
    shutil.copytree(PACKAGING, target)
    shutil.copy(ROOT / "LICENSE", target)
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    project = target / "pyproject.toml"
    project.write_text(re.sub(r"^version = .*$", f'version = "{version}"', project.read_text(), flags=re.MULTILINE))
    schema = ROOT / "service" / "proto"
    protocol = (path.relative_to(ROOT) for suffix in ("proto", "pyi") for path in schema.rglob(f"*.{suffix}"))
    types = (Path(name) / "py.typed" for name in ("costs", "service") if (ROOT / name / "py.typed").exists())
    for path in (*list_modules(), *protocol, *types):
        (target / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, target / path)


def _find_file(module: str) -> Path | None:
    path = ROOT.joinpath(*module.split("."))
    return next((file for file in (path / "__init__.py", path.with_suffix(".py")) if file.is_file()), None)


def _list_imports(module: str, path: Path) -> list[str]:
    """Return the modules of the project that a file imports, apart from those for type checkers alone."""
    tree = ast.parse(path.read_text())
    typing = {id(node) for block in ast.walk(tree) if _is_for_types(block) for node in ast.walk(block)}
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    names: list[str] = []
    for node in ast.walk(tree):
        if id(node) in typing:
            continue
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            source = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module or ""
            names += [source, *(f"{source}.{alias.name}" for alias in node.names)]
    return [name for name in names if name.partition(".")[0] in OWN]


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


if __name__ == "__main__":
    assemble(Path(sys.argv[1]))

"""Test files nearest to a module: the fewest imports away from it, and most alike in name."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

PACKAGES = ("scopt", "costs", "perception", "service", "benchmarks")


class ImportGraph:
    """Imports among the modules and test files of a project.

    Attributes:
        root: folder of the project.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    def find_nearest_tests(self, path: str, count: int, among: Sequence[str]) -> list[str]:
        """Return the test files that need the fewest imports to come to a module.

        Args:
            path: of the module's file, relative to the root.
            count: number of test files at most.
            among: folders, relative to ``tests``, that are preferred among those equally near.
        """
        distance, front, steps = {path: 0}, {path}, 0
        while front:
            steps += 1
            front = {user for name in front for user in self._users.get(name, ())} - set(distance)
            distance.update(dict.fromkeys(front, steps))
        words = set(re.split(r"\W|_", path))

        def rank(test: str) -> tuple[int, bool, int, str]:
            is_elsewhere = not test.removeprefix("tests/").startswith(tuple(among))
            return distance[test], is_elsewhere, -len(words & set(re.split(r"\W|_", test))), test

        tests = [name for name in distance if re.search(r"/test_\w+\.py$", name)]
        return sorted(tests, key=rank)[:count]

    @cached_property
    def _users(self) -> Mapping[str, set[str]]:
        """Files that import each file."""
        names = {module_name(file): file for file in self._files}
        users: dict[str, set[str]] = {}
        for file in self._files:
            for name in _list_imports(ast.parse((self.root / file).read_bytes())):
                if name in names and names[name] != file:
                    users.setdefault(names[name], set()).add(file)
        return users

    @cached_property
    def _files(self) -> list[str]:
        folders = [folder for name in (*PACKAGES, "tests") if (folder := self.root / name).is_dir()]
        return sorted(str(file.relative_to(self.root)) for folder in folders for file in folder.rglob("*.py"))


def module_name(file: str) -> str:
    """Return the name by which a file is imported; helpers of tests are on the path."""
    if file.startswith("tests/"):
        return Path(file).stem
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _list_imports(tree: ast.Module) -> Iterator[str]:
    """Yield the names of modules that may be imported anywhere in a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)

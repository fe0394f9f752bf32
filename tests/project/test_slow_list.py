"""The list of the tests that `make test-fast` leaves out."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

TESTS = Path(__file__).parents[1]


def test_every_entry_of_the_slow_list_names_a_module_or_a_test_of_it() -> None:
    entries = (TESTS / "slow.txt").read_text().split()
    assert entries == sorted(set(entries))
    for entry in entries:
        module, _, function = entry.partition("::")
        assert (TESTS / module).is_file(), entry
        assert entry == module or module not in entries, f"{entry}: {module} is an entry of its own"
        assert not function or function in _tests_of(TESTS / module), entry


@cache
def _tests_of(module: Path) -> frozenset[str]:
    body = ast.parse(module.read_text()).body
    return frozenset(node.name for node in body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))

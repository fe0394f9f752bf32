"""The list of the tests that `make test-fast` leaves out."""

from __future__ import annotations

import ast
from pathlib import Path

TESTS = Path(__file__).parent


def test_every_entry_of_the_slow_list_names_a_module_or_a_test_of_it() -> None:
    entries = (TESTS / "slow.txt").read_text().split()
    assert entries == sorted(set(entries))
    for entry in entries:
        module, _, function = entry.partition("::")
        assert (TESTS / module).is_file(), entry
        assert entry == module or module not in entries, f"{entry}: {module} is an entry of its own"
        if function:
            body = ast.parse((TESTS / module).read_text()).body
            assert function in {
                node.name for node in body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            }, entry

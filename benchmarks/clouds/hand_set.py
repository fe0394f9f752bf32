"""Counts the hand-set numbers of the detectors: literals other than 0, 1 and 2 in their code and data files.

A number inside a ``Size(...)`` of a template has a source there; fitted tables (``weights.csv``, ``usual.csv``) do not
count.  From the checkout's root: ``python -m benchmarks.clouds.hand_set``.
"""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

from benchmarks.tables import print_table

_DETECT = Path(__file__).parents[2] / "perception" / "detect"
_FREE = (0, 1, 2)
_FITTED = frozenset({"weights.csv", "usual.csv"})
_SOURCED = "Size"


def main() -> None:
    """Print the counts by folder."""
    counts = count_by_folder(_DETECT)
    rows = [(folder, str(total), str(sourced)) for folder, (total, sourced) in sorted(counts.items())]
    sums = [str(sum(values)) for values in zip(*counts.values(), strict=True)]
    print_table("numbers set by hand", ("folder", "numbers", "of these with a source"), [*rows, ("all", *sums)])


def count_by_folder(root: Path) -> dict[str, tuple[int, int]]:
    """Return, for each folder and module below a root, the numbers set by hand, and those with a source."""
    total: Counter[str] = Counter()
    sourced: Counter[str] = Counter()
    for file in sorted(root.rglob("*.py")):
        part = file.relative_to(root).parts[0]
        own, with_source = count_numbers(file.read_text())
        total[part] += own
        sourced[part] += with_source
    for file in sorted(root.rglob("*.csv")):
        if file.name not in _FITTED:
            total[file.relative_to(root).parts[0]] += sum(
                _is_number(cell) for line in file.read_text().splitlines() for cell in line.split(",")
            )
    return {part: (total[part], sourced[part]) for part in total if total[part]}


def count_numbers(code: str) -> tuple[int, int]:
    """Return the literals of a module other than 0, 1 and 2, and how many stand in a ``Size(...)``."""
    tree = ast.parse(code)
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    in_sizes = {
        id(node)
        for call in calls
        if isinstance(call.func, ast.Name) and call.func.id == _SOURCED
        for node in ast.walk(call)
    }
    numbers = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, int | float)
        and not isinstance(node.value, bool)
        and node.value not in _FREE
    ]
    return len(numbers), sum(id(node) in in_sizes for node in numbers)


def _is_number(text: str) -> bool:
    try:
        return float(text) not in _FREE
    except ValueError:
        return False


if __name__ == "__main__":
    main()

"""One name, one class: no two modules of ``service`` define classes of one name."""

import ast
from collections import defaultdict
from pathlib import Path

SERVICE = Path(__file__).parents[2] / "service"


def test_no_class_name_has_two_meanings() -> None:
    places = defaultdict(list)
    for path in sorted(SERVICE.rglob("*.py")):
        if "proto" not in path.parts:
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ClassDef):
                    places[node.name].append(path.relative_to(SERVICE).as_posix())
    twice = {name: paths for name, paths in places.items() if len(paths) > 1}
    assert twice == {}

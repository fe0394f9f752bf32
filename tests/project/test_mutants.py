"""Mutants: which parts of a text are changed, which samples are drawn, and which tests are nearest to a module."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.mutants.__main__ import GROUPS, ROOT, Copy, draw_mutants
from benchmarks.mutants.mutations import list_mutants
from benchmarks.mutants.nearest import ImportGraph


@pytest.mark.parametrize(
    ("expression", "mutants"),
    [
        ("a < b", {"a <= b", "a > b"}),
        ("a < b <= c", {"a <= b <= c", "a > b <= c", "a < b < c", "a < b >= c"}),
        ("a is not b", {"a is b"}),
        ("(a) - (b)", {"(a) + (b)", "(a) "}),
        ("-(a * b)", {"(a * b)", "-(a / b)"}),
        ("a**k", {"a*k"}),
        ("not a or b", {" a or b", "not a and b"}),
        ("max(a, b)", {"min(a, b)"}),
        ("a.argmin()", {"a.argmax()"}),
        ("np.minimum(a, b)", {"np.maximum(a, b)"}),
        ("0.25", {"2.5"}),
        ("a[7]", {"a[8]"}),
        ("True", {"False"}),
        ("'ü' + a", set()),
        ("f'{a < b}'", set()),
        ("ü[0]  # not one byte", {"ü[1]  # not one byte"}),
    ],
)
def test_one_part_of_an_expression_is_another_in_each_mutant(expression: str, mutants: set[str]) -> None:
    source = f"x = {expression}\n".encode()
    found = [mutant.apply(source).decode() for mutant in list_mutants("x.py", source)]
    assert sorted(found) == sorted(f"x = {mutant}\n" for mutant in mutants)


def test_annotations_messages_and_imports_are_left_as_they_are() -> None:
    source = b"""from . import a
class Some(Base[3]):
    size: Annotated[int, 1] = b
    def f(self, x: Between[1, 2] = c) -> Of[0.5]:
        raise ValueError(1 + 2)
"""
    assert list_mutants("x.py", source) == []


def test_a_seed_draws_the_same_sample_of_a_folder_and_all_of_it_compiles() -> None:
    sample = draw_mutants(("scopt",), 50, 3)
    assert sample == draw_mutants(("scopt",), 50, 3)
    assert sample != draw_mutants(("scopt",), 50, 4)
    assert len({str(mutant) + str(mutant.start) for mutant in sample}) == 50
    for mutant in sample:
        source = (ROOT / mutant.path).read_bytes()
        assert source[mutant.start : mutant.end].decode() == mutant.old
        compile(mutant.apply(source), mutant.path, "exec")


def test_every_group_has_files_and_tests() -> None:
    for paths, among in GROUPS.values():
        assert all(list((ROOT / path).rglob("*.py")) for path in paths)
        assert all(list((ROOT / "tests" / folder).rglob("test_*.py")) for folder in among)


def test_the_nearest_tests_import_a_module_by_the_fewest_steps_and_have_its_words(tmp_path: Path) -> None:
    files = {
        "scopt/deep.py": "",
        "scopt/middle.py": "from scopt.deep import x",
        "tests/support/helper.py": "import scopt.deep",
        "tests/other/test_far.py": "from scopt.middle import y",
        "tests/other/test_deep_thing.py": "from scopt import deep",
        "tests/own/test_direct.py": "import scopt.deep",
        "tests/own/test_by_helper.py": "from helper import z",
        "tests/own/test_nothing.py": "import os",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    graph = ImportGraph(tmp_path)
    direct, by_helper = "tests/own/test_direct.py", "tests/own/test_by_helper.py"
    named_alike, far = "tests/other/test_deep_thing.py", "tests/other/test_far.py"
    assert graph.find_nearest_tests("scopt/deep.py", 9, ("own/",)) == [direct, named_alike, by_helper, far]
    assert graph.find_nearest_tests("scopt/deep.py", 9, ("other/",)) == [named_alike, direct, far, by_helper]
    assert graph.find_nearest_tests("scopt/deep.py", 2, ("",)) == [named_alike, direct]


def test_a_mutant_is_killed_survives_or_never_ends_and_a_test_that_fails_anyway_tells_nothing(tmp_path: Path) -> None:
    project, copy = tmp_path / "project", tmp_path / "copy"
    for name in ("scopt", "tests"):
        (project / name).mkdir(parents=True)
    source = "def double(x):\n    n = 2\n    while n < 2:\n        pass\n    return min(x * 2, 5)\n"
    (project / "scopt/__init__.py").touch()
    (project / "scopt/few.py").write_text(source)
    (project / "tests/test_few.py").write_text(
        "from scopt.few import double\ndef test_1():\n    assert double(1) == 2\n"
    )
    (project / "tests/test_red.py").write_text("from scopt.few import x\n")
    tried = Copy(project, copy)
    few, red = ["tests/test_few.py"], ["tests/test_red.py"]
    mutants = {(mutant.line, mutant.new): mutant for mutant in list_mutants("scopt/few.py", source.encode())}
    # texts of one length, one right after the other: bytecode of the one before would be taken for the next one's
    assert tried.judge(mutants[5, "/"], few) == "tests/test_few.py::test_1"
    assert tried.judge(mutants[5, "6"], few) == ""
    assert tried.judge(mutants[3, "<="], few, seconds=2.0) is None
    assert (copy / "scopt/few.py").read_text() == source
    assert tried.judge(mutants[5, "6"], red + few) == ""
    assert tried.judge(mutants[5, "/"], red + few) == "tests/test_few.py::test_1"
    assert tried.broken == {"tests/test_red.py"}

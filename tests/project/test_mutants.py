"""Mutants: which parts of a text are changed, which samples are drawn, and which tests are nearest to a module."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.mutants.__main__ import GROUPS, ROOT, Copy, draw_mutants, find_reason, read_equivalents
from benchmarks.mutants.judge import TIMED_OUT, find_changed_functions
from benchmarks.mutants.mutations import list_mutants
from benchmarks.mutants.recording import record


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


def test_every_group_has_files() -> None:
    for paths in GROUPS.values():
        assert all(list((ROOT / path).rglob("*.py")) for path in paths)


def test_what_changes_nothing_is_a_mutant_of_today_and_has_a_reason() -> None:
    known = read_equivalents()
    for (path, lines), reason in known.items():
        mutants = list_mutants(path, (ROOT / path).read_bytes())
        assert any(find_reason(mutant, {(path, lines): reason}) for mutant in mutants), (path, lines)
        assert reason


def test_a_mutant_that_changes_nothing_is_known_by_its_line_as_it_was_and_becomes(tmp_path: Path) -> None:
    listed = tmp_path / "equivalent.txt"
    listed.write_text("# What is said first.\n\nx.py\na = b + 0\na = b - 0\nNothing is added.\n")
    (tmp_path / "x.py").write_text("if c:\n    a = b + 0\n")
    reasons = {
        mutant.new: find_reason(mutant, read_equivalents(listed), tmp_path)
        for mutant in list_mutants("x.py", (tmp_path / "x.py").read_bytes())
    }
    assert reasons == {"-": "Nothing is added.", "": None, "1": None}


def _project(tmp_path: Path) -> Copy:
    """A copy of a project with a module and its tests."""
    project = tmp_path / "project"
    for name in ("scopt", "tests"):
        (project / name).mkdir(parents=True)
    (project / "pyproject.toml").write_text(
        "[tool.pytest.ini_options]\nmarkers = ['slow']\naddopts = ['-p', 'no:dash']\n"
    )
    (project / "scopt/__init__.py").touch()
    (project / "scopt/few.py").write_text(FEW)
    (project / "tests/test_few.py").write_text(
        "from scopt.few import LIMIT, double\n"
        "def test_1():\n    assert double(1) == 2\n"
        "def test_limit():\n    assert LIMIT == 5\n"
        "def test_nothing():\n    pass\n"
        "def test_red():\n    assert double(2) == 7\n"
    )
    return Copy(project, tmp_path / "copy")


FEW = """LIMIT = 5
def double(x):
    n = 2
    while n < 2:
        pass
    return min(
        x * 2,
        LIMIT + 0,
    )
"""
TESTS = "tests/test_few.py::"


def test_a_line_is_tested_by_what_ran_its_statement_and_a_constant_by_all_that_ran_its_file(tmp_path: Path) -> None:
    copy = _project(tmp_path)
    recording = record(copy.root, tmp_path / "recorded")
    ran = {line: {name for name, _ in recording.find_tests("scopt/few.py", line)} for line in (1, 3, 5, 7)}
    assert ran == {1: {f"{TESTS}test_1"}, 3: {f"{TESTS}test_1"}, 5: set(), 7: {f"{TESTS}test_1"}}
    assert "scopt.few" in recording.modules
    assert record(copy.root, tmp_path / "recorded").folder == recording.folder
    (copy.root / "scopt/few.py").write_text(FEW + "# changed")
    assert record(copy.root, tmp_path / "recorded").folder != recording.folder


def test_a_mutant_is_killed_survives_or_never_ends_and_a_test_that_fails_anyway_tells_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # else each child imports plugins that nothing here uses
    copy = _project(tmp_path)
    mutants = {(mutant.line, mutant.new): mutant for mutant in list_mutants("scopt/few.py", FEW.encode())}
    one, limit, red = ((f"{TESTS}{name}", 0.01) for name in ("test_1", "test_limit", "test_red"))
    with copy.open(["scopt.few"]) as tried:
        # texts of one length, one right after the other: bytecode of the one before would be taken for the next one's
        assert tried.judge(mutants[7, "/"], [limit, one]) == one[0]
        assert tried.judge(mutants[7, "3"], [limit]) == ""
        assert tried.judge(mutants[1, "6"], [one, limit]) == limit[0], "a constant is imported afresh"
        assert tried.judge(mutants[4, "<="], [one], least_s=1.0) == TIMED_OUT
        assert (copy.root / "scopt/few.py").read_text() == FEW
        assert tried.judge(mutants[7, "3"], [red, limit]) == ""
        assert tried.judge(mutants[7, "3"], [red, one]) == one[0]
    assert tried.broken == {red[0]}


def test_a_change_within_functions_is_that_of_the_outermost_ones_and_one_elsewhere_is_none() -> None:
    text = "A = 1\nclass B:\n    def f(self):\n        return lambda: 2\ndef g():\n    return 3\n"

    def changed(old: str, new: str) -> list[str] | None:
        pairs = find_changed_functions(compile(text, "x", "exec"), compile(text.replace(old, new), "x", "exec"))
        return None if pairs is None else [pair[0].co_name for pair in pairs]

    assert changed("2", "5") == ["f"]
    assert changed("3", "5") == ["g"]
    assert changed("1", "5") is None
    assert changed("1", "1") == []

"""Figures of the benchmark of starts, from rows whose sums are known."""

from __future__ import annotations

from benchmarks.planning.starts import Row, compare, summarize, summarize_starts


def make_row(name: str, verdict: str, cpu_s: float, *tried: tuple[str, float, bool]) -> Row:
    attempts = [{"start": start, "cpu_s": cpu, "n_steps": 4, "is_feasible": ok} for start, cpu, ok in tried]
    return {"group": "arms", "name": name, "verdict": verdict, "cpu_s": cpu_s, "reason": "", "tried": attempts}


ROWS = [
    make_row("a", "CERTIFIED", 1.0, ("straight line", 0.5, False), ("path of RRT, tree 1", 0.25, True)),
    make_row("b", "NOT_FOUND", 3.0, ("straight line", 0.5, False), ("path of RRT, tree 2", 0.25, False)),
]


def test_a_group_has_its_plans_certificates_and_times():
    assert list(summarize(ROWS)) == [("arms", "2", "1", "4.00", "2.00", "2.90")]


def test_trees_of_a_kind_are_one_start():
    assert list(summarize_starts(ROWS)) == [
        ("arms: straight line", "2", "0", "1.00", "0.500", "4.0"),
        ("arms: path of RRT", "2", "1", "0.50", "0.250", "4.0"),
    ]


def test_runs_are_compared_on_the_problems_that_both_have():
    now = [make_row("b", "CERTIFIED", 1.5), make_row("c", "CERTIFIED", 9.0)]
    group, changed = compare(ROWS, now)
    assert group == ("arms", "1", "0", "1", "3.00", "1.50", "0.50")
    assert changed[0].startswith("  b: NOT_FOUND -> CERTIFIED")

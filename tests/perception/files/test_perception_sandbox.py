"""The process sandbox: results, limits, whose they are, and what becomes of a process that is no longer wanted."""

from __future__ import annotations

import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from executor_waiting import is_running, until
from sandboxed import (
    allocate,
    count_limits,
    crash,
    fill,
    print_and_return,
    return_values,
    sleep_beside_a_child,
    work_without_end,
)

from costs.stopping import Stopped, stops_when
from perception.sandbox import Cause, ProcessLimits, SandboxError, run_in_sandbox

LIMITS = ProcessLimits(max_bytes=2**30, max_wall_s=300.0, max_cpu_s=20)
# A process without this package's own imports, under limits that it did not choose.
UNDER_A_LIMIT = """
import resource, sys, types
package = types.ModuleType("perception")
package.__path__ = [sys.argv[1]]
sys.modules["perception"] = package
from perception.sandbox import ProcessLimits, SandboxError, run_in_sandbox
from sandboxed import {function}
resource.setrlimit(resource.{kind}, ({limit}, {limit}))
try:
    print(run_in_sandbox({function}, {values}, ProcessLimits(2**32, 300.0, {max_cpu_s})))
except SandboxError as error:
    print(error.cause.name, "|", error.limit, "|", error.ending)
"""

# In the place of a library that a process in the sandbox imports.
SLEEPING_LIBRARY = (
    "import os, pathlib, time; pathlib.Path(__file__).with_name('pid').write_text(str(os.getpid())); time.sleep(600)"
)
PARSE_A_SCAN = """
import sys
from pathlib import Path
from perception.files.read import parse_in_sandbox
sys.path.insert(0, sys.argv[1])
parse_in_sandbox(Path(sys.argv[1]) / "scan.las")
"""
SPLIT_A_MESH = """
import sys
import numpy as np
from perception.solids.mesh import Mesh
from perception.solids.process import run_coacd
sys.path.insert(0, sys.argv[1])
run_coacd([Mesh(np.eye(3), np.array([[0, 1, 2]]))], {})
"""


def run_under(kind: str, limit: int, function: str, values: dict[str, Any], max_cpu_s: int | None = 20) -> str:
    code = UNDER_A_LIMIT.format(kind=kind, limit=limit, function=function, values=values, max_cpu_s=max_cpu_s)
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", code, str(root / "perception")],
        env={"PYTHONPATH": f"{root}:{root / 'tests/support'}", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_values_and_arrays_come_back_whole() -> None:
    values = {
        "floats": np.random.default_rng(0).random((5, 3)),
        "columns": np.arange(12.0).reshape(3, 4).T,
        "integers": np.array([[1, -2], [2**40, 0]]),
        "flags": np.array([True, False]),
        "nothing": np.zeros((0, 3)),
        "words": ["a", "\u00e9", None, float("inf")],
    }
    result = run_in_sandbox(return_values, values, LIMITS)
    for key, value in values.items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(result[key], value)
            assert result[key].dtype == (np.float64 if value.dtype.kind == "f" else np.int64)
        else:
            assert result[key] == value


def test_a_fresh_process_imports_the_function_alone() -> None:
    result = run_in_sandbox(return_values, {}, LIMITS)
    assert result["loaded"] == ["perception"]  # without its __init__, which imports all of it
    assert not is_running(result["pid"])


def test_what_a_library_prints_is_no_part_of_the_result() -> None:
    assert run_in_sandbox(print_and_return, {"text": "{}\nMemoryError"}, LIMITS) == {"text": "{}\nMemoryError"}


def test_large_results_come_back_whole() -> None:
    numbers = run_in_sandbox(fill, {"n": 10_000_000}, LIMITS)["numbers"]
    np.testing.assert_array_equal(numbers, np.arange(10_000_000.0))


def test_a_result_larger_than_the_limit_is_an_error() -> None:
    with pytest.raises(SandboxError):
        run_in_sandbox(fill, {"n": 20_000_000}, replace(LIMITS, max_bytes=2**27))


def test_limits_hold_in_the_process() -> None:
    assert run_in_sandbox(count_limits, {}, LIMITS)["limits"] == [2**30, 20, 0]
    unbounded = run_in_sandbox(count_limits, {}, replace(LIMITS, max_cpu_s=None))["limits"]
    assert unbounded == [2**30, resource.getrlimit(resource.RLIMIT_CPU)[0], 0]


@pytest.mark.parametrize("n_bytes", [2**31, 2**40])
def test_too_much_memory_is_reported_with_the_limit(n_bytes: int) -> None:
    with pytest.raises(SandboxError) as caught:
        run_in_sandbox(allocate, {"n_bytes": n_bytes}, LIMITS)
    assert (caught.value.cause, caught.value.limit) == (Cause.MEMORY, "1024 MB")


def test_too_little_memory_to_begin_is_reported_as_such() -> None:
    for megabytes in (1, 20):
        with pytest.raises(SandboxError) as caught:
            run_in_sandbox(return_values, {"a": np.zeros(3)}, replace(LIMITS, max_bytes=megabytes * 2**20))
        assert (caught.value.cause, caught.value.limit) == (Cause.MEMORY, f"{megabytes} MB")


def test_too_much_processor_time_is_reported_with_the_limit() -> None:
    with pytest.raises(SandboxError) as caught:
        run_in_sandbox(work_without_end, {}, replace(LIMITS, max_cpu_s=1))
    assert (caught.value.cause, caught.value.limit, caught.value.ending) == (Cause.CPU_TIME, "1 s", "SIGXCPU")


def test_a_process_that_sleeps_is_killed_with_its_children_when_the_time_is_over(tmp_path: Path) -> None:
    note = tmp_path / "pids"
    for wall_s in (2.0, 10.0, 60.0):  # a busy machine takes longer until there is a child
        with pytest.raises(SandboxError) as caught:
            run_in_sandbox(sleep_beside_a_child, {"note": str(note)}, replace(LIMITS, max_wall_s=wall_s))
        assert (caught.value.cause, caught.value.limit) == (Cause.WALL_TIME, f"{wall_s:g} s")
        if note.exists():
            break
    assert until(lambda: not any(is_running(int(pid)) for pid in note.read_text().split()))


def test_a_process_ends_as_soon_as_the_caller_is_to_stop(tmp_path: Path) -> None:
    note = tmp_path / "pids"
    with pytest.raises(Stopped), stops_when(lambda: note.exists() and bool(note.read_text())):
        run_in_sandbox(sleep_beside_a_child, {"note": str(note)}, LIMITS)
    assert until(lambda: not any(is_running(int(pid)) for pid in note.read_text().split()))


@pytest.mark.parametrize(
    ("how", "ending"),
    [
        ("segfault", "SIGSEGV"),
        ("abort", "SIGABRT"),
        ("exit", "exit 3"),
        ("error", "exit 1"),
        ("no JSON\n", "an unreadable result"),
        ("{}\n", "an unreadable result"),
        ("[]\n", "an unreadable result"),
        ('{"values": {}, "arrays": []}\n', "an unreadable result"),
        ("[" * 100_000, "an unreadable result"),
        ('{"values": {}, "arrays": {"a": ["|O", [1]]}}\n', "an unreadable result"),
        ('{"values": {}, "arrays": {"a": ["<f8", [1000000000000]]}}\n', "an unreadable result"),
        ('{"values": {}, "arrays": {"a": ["<f8", [-1]]}}\n', "an unreadable result"),
    ],
)
def test_a_crash_is_reported_by_how_the_process_ended(how: str, ending: str) -> None:
    with pytest.raises(SandboxError) as caught:
        run_in_sandbox(crash, {"how": how}, LIMITS)
    assert (caught.value.cause, caught.value.ending) == (Cause.CRASH, ending)


def test_a_lower_inherited_limit_of_memory_holds_and_is_named() -> None:
    shown = run_under("RLIMIT_AS", 2**29, "allocate", {"n_bytes": 2**30})
    limit = "512 MB (the hard limit RLIMIT_AS that scopt was started with; its own is 4096 MB)"
    assert shown == f"MEMORY | {limit} | exit 1"
    assert run_under("RLIMIT_AS", 2**29, "allocate", {"n_bytes": 2**20}) == "{'n_bytes': 1048576}"


@pytest.mark.parametrize(("max_cpu_s", "own"), [(20, "; its own is 20 s"), (None, "")])
def test_a_lower_inherited_limit_of_processor_time_holds_and_is_named(max_cpu_s: int | None, own: str) -> None:
    shown = run_under("RLIMIT_CPU", 2, "work_without_end", {}, max_cpu_s)
    assert shown == f"CPU_TIME | 2 s (the hard limit RLIMIT_CPU that scopt was started with{own}) | SIGXCPU"


def test_a_higher_inherited_limit_changes_nothing() -> None:
    shown = run_under("RLIMIT_AS", 2**33, "count_limits", {})
    assert shown == f"{{'limits': [{2**32}, 20, 0]}}"


@pytest.mark.parametrize(("code", "library"), [(PARSE_A_SCAN, "laspy"), (SPLIT_A_MESH, "coacd")])
def test_a_process_ends_with_the_one_that_started_it(tmp_path: Path, code: str, library: str) -> None:
    (tmp_path / f"{library}.py").write_text(SLEEPING_LIBRARY)
    (tmp_path / "scan.las").write_bytes(b"LASF" + bytes(400))
    pid = tmp_path / "pid"
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)]) as parent:
        assert until(lambda: pid.exists() and pid.read_text())
        parent.kill()
        assert until(lambda: not is_running(int(pid.read_text())))

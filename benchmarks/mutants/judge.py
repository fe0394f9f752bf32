"""A process with all libraries and the project imported, which forks a child for each mutant."""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import select
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest

CRASH, TIMED_OUT = "crash", "timed out"
OPTIONS = (
    *("-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # what the parent imported is not rewritten
)
WALL = 3.0  # wall time of a child, at most, as a multiple of its processor time
LATER = ("grpc", "ray")  # libraries with threads of their own, which a fork would leave without them
_OPTIMIZED = 1  # flag of the code of a function, which classes and modules lack


class _FirstFailure:
    """Plugin of pytest: the first test that fails, or file that cannot be collected."""

    name = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.name = self.name or report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.name = self.name or report.nodeid


def judge(path: str, old: str, tests: list[str], cpu_s: float, *, is_fresh: bool = False) -> str:
    """Return the first test that fails with the file as it is, or why none could; an empty text if all pass.

    Args:
        path: of the file that has been changed.
        old: its text before.
        tests: to run in this order.
        cpu_s: processor time at most.
        is_fresh: whether the project is imported anew.
    """
    read, write = os.pipe()
    child = os.fork()
    if not child:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (int(cpu_s) + 1, int(cpu_s) + 2))
        null = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(null, stream)
        try:
            forget_project() if is_fresh else patch(path, old)
            first = _FirstFailure()
            code = pytest.main([*OPTIONS, *tests], plugins=[first])
            answer = first.name or ("" if code in (0, 5) else CRASH)
        except BaseException:
            answer = CRASH
        os.write(write, f"={answer}".encode())
        os._exit(0)
    os.close(write)
    end = time.monotonic() + WALL * cpu_s
    is_late = not select.select([read], [], [], end - time.monotonic())[0]
    answer = "" if is_late else os.read(read, 65536).decode()
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    _, ended = os.waitpid(child, 0)
    os.close(read)
    if is_late or (os.WIFSIGNALED(ended) and os.WTERMSIG(ended) == signal.SIGXCPU):
        return TIMED_OUT
    return answer[1:] if answer else CRASH


def patch(path: str, old: str) -> None:
    """Give the functions of a loaded file the code of its new text; forget the project where that is not enough."""
    file = str(Path(path).resolve())
    new = Path(path).read_text()
    pairs = find_changed_functions(compile(old, file, "exec"), compile(new, file, "exec"))
    if pairs is None:
        forget_project()
        return
    gc.unfreeze()
    functions = [each for each in gc.get_objects() if type(each) is FunctionType]
    for was, becomes in pairs:
        for each in functions:
            if each.__code__ == was and each.__code__.co_filename == file:
                each.__code__ = becomes


def find_changed_functions(old: CodeType, new: CodeType) -> list[tuple[CodeType, CodeType]] | None:
    """Return the outermost functions in which two codes differ; None where they differ elsewhere."""
    if old == new:
        return []
    if old.co_flags & _OPTIMIZED:
        return [(old, new)]
    if old.replace(co_consts=()) != new.replace(co_consts=()) or len(old.co_consts) != len(new.co_consts):
        return None
    changed: list[tuple[CodeType, CodeType]] = []
    for a, b in zip(old.co_consts, new.co_consts, strict=True):
        if isinstance(a, CodeType) and isinstance(b, CodeType):
            inner = find_changed_functions(a, b)
            if inner is None:
                return None
            changed += inner
        elif type(a) is not type(b) or a != b:
            return None
    return changed


def forget_project() -> None:
    """Remove the modules of the project and of its tests, so that they are imported afresh."""
    root = f"{Path.cwd()}{os.sep}"
    for name, module in list(sys.modules.items()):
        if name != "__main__" and (getattr(module, "__file__", None) or "").startswith(root):
            del sys.modules[name]


def _serve() -> None:
    """Answer one line of JSON after the other."""
    order: dict[str, Any] = json.loads(sys.stdin.readline())
    sys.path[:0] = order["paths"]
    sys.modules.update(dict.fromkeys(LATER))  # type: ignore[arg-type]  # None: importing it fails
    for name in order["modules"]:
        with suppress(BaseException):
            importlib.import_module(name)
    for name in LATER:
        del sys.modules[name]
    gc.freeze()
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        print(json.dumps(judge(**json.loads(line))), flush=True)


if __name__ == "__main__":
    _serve()

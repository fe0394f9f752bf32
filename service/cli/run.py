"""Run of a command: exit code, one line per error, cancellation with Ctrl-C, progress on stderr."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from types import FrameType
from typing import Any

import typer
from rich.console import Console

from costs.stopping import Stopped
from service.cli.foreign import explain_foreign_libraries
from service.cli.report import print_verdict
from service.errors import DamagedResultError, ServiceError

EXIT_CODES = {
    "CERTIFIED": 0,
    "FEASIBLE_AT_SAMPLES": 4,
    "NOT_FOUND": 4,
    "INFEASIBLE": 4,
    "VIOLATED": 4,
    "INVALID_REQUEST": 3,
    "TIME_LIMIT": 5,
    "CANCELLED": 130,
    "DONE": 0,
    "STOOD": 1,
    "FELL": 7,
    "TRACKED": 0,
    "ABORTED": 8,
    "MATCHES": 0,
    "DIFFERS": 10,
    "HELD_BEFORE": 9,
    "DAMAGED": 74,
    "LOST": 70,
}
EXIT_INTERNAL = 70
INTERNAL_ERROR = "INTERNAL_ERROR"
SILENT_S = 0.2  # after Ctrl-C, in which work polls whether to stop
MIN_WIDTH = 120  # a table in a log file need not be squeezed into 80 columns
TRACEBACK_VARIABLE = "SCOPT_TRACEBACK"
Report = Callable[[str, float | None], None]
"""Report of progress: step, and the fraction that is done, None if unknown."""


def consoles() -> tuple[Console, Console]:
    """Return stdout for results and stderr for everything else."""
    pair = Console(highlight=False), Console(stderr=True, highlight=False)
    for console in pair:
        if not console.is_terminal:
            console.width = max(console.width, MIN_WIDTH)
    return pair


def print_json(data: Mapping[str, Any]) -> None:
    """Write a JSON object as one line on stdout."""
    sys.stdout.write(json.dumps(data, allow_nan=False) + "\n")
    sys.stdout.flush()


class EndedError(Exception):
    """End of a command with an exit code of its own.

    Attributes:
        verdict: one word for the reason.
        lines: messages for stderr.
    """

    def __init__(self, verdict: str, lines: tuple[str, ...], exit_code: int) -> None:
        super().__init__("\n".join(lines))
        self.verdict = verdict
        self.lines = lines
        self.exit_code = exit_code


def run(command: Callable[[], str | None], as_json: bool = False, has_verdict: bool = False) -> int:
    """Run a command that returns a verdict, or None without one; return its exit code, whatever happens.

    Wrong input is one line per problem on stderr.  Then stdout, too, gets an object with ``as_json``, else, with
    ``has_verdict``, a line that starts with the verdict.

    Raises:
        typer.BadParameter: options that exclude each other.
    """

    def print_end(ended: EndedError) -> None:
        """Print why there is no result."""
        stdout, stderr = consoles()
        for line in ended.lines:
            stderr.print(line, style="red", markup=False, soft_wrap=True)
        if as_json:
            figures = {"planning_time_s": 0.0, "timings": {}, "min_clearance_m": None, "phases": []}
            print_json({"verdict": ended.verdict, "explanation": ended.lines, **figures})
        elif has_verdict:
            print_verdict(stdout, {"verdict": ended.verdict, "explanation": ended.lines})

    token = _PRINT_END.set(print_end)
    try:
        verdict = command()
        return 0 if verdict is None else EXIT_CODES[verdict]
    except typer.BadParameter:
        raise
    except EndedError as error:
        ended = error
    except DamagedResultError as error:
        ended = EndedError("DAMAGED", tuple(str(error).splitlines()), EXIT_CODES["DAMAGED"])
    except ServiceError as error:
        ended = EndedError("INVALID_REQUEST", tuple(str(error).splitlines()), EXIT_CODES["INVALID_REQUEST"])
    except (KeyboardInterrupt, Stopped):
        ended = _CANCELLED
    except BrokenPipeError:
        # Nobody reads stdout any more; without this, Python fails again when it flushes it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_INTERNAL
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        cause = explain_foreign_libraries(error)
        line = cause or f"internal error, please report it: {type(error).__name__}: {error}"
        line = f"{' '.join(line.split())} ({TRACEBACK_VARIABLE}=1 shows where)"
        ended = EndedError(INTERNAL_ERROR, (line,), EXIT_INTERNAL)
    finally:
        _PRINT_END.reset(token)
    print_end(ended)
    return ended.exit_code


_CANCELLED = EndedError("CANCELLED", ("cancelled",), EXIT_CODES["CANCELLED"])
_PRINT_END: ContextVar[Callable[[EndedError], None]] = ContextVar("print_end", default=lambda _: None)


@contextmanager
def cancellable(stderr: Console) -> Iterator[Callable[[], bool]]:
    """Stop the work of the body, which returns its best result, on Ctrl-C; the second Ctrl-C ends this process.

    Work that polls is not interrupted by an exception, since it may run native code whose threads would go on.  A step
    that does not poll within ``SILENT_S`` (imports, reading and writing files) ends by ``KeyboardInterrupt``.  Yields a
    function that returns whether to stop.
    """
    stop, heard = threading.Event(), threading.Event()

    def should_stop() -> bool:
        if stop.is_set():
            heard.set()
            return True
        return False

    def interrupt_silent_step() -> None:
        if not heard.wait(SILENT_S) and not is_over.is_set():
            is_silent.set()
            signal.raise_signal(signal.SIGINT)

    def request_stop(signum: int, frame: FrameType | None) -> None:
        if is_silent.is_set() and not is_ended.is_set():
            is_ended.set()
            raise KeyboardInterrupt
        if is_ended.is_set():
            return  # the command ends already
        if stop.is_set():
            with suppress(RuntimeError, OSError):  # a write may be in progress
                _PRINT_END.get()(_CANCELLED)
                sys.stdout.flush()
            os._exit(_CANCELLED.exit_code)
        stop.set()
        stderr.print("stopping; Ctrl-C again stops at once", style="yellow")
        threading.Thread(target=interrupt_silent_step, daemon=True).start()

    is_silent, is_ended, is_over = threading.Event(), threading.Event(), threading.Event()
    earlier = signal.signal(signal.SIGINT, request_stop)
    try:
        yield should_stop
    finally:
        is_over.set()
        if not is_ended.is_set():
            signal.signal(signal.SIGINT, earlier)


@contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """Treat SIGTERM as Ctrl-C in the body, so that no partial output is left."""
    earlier = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, earlier)


@contextmanager
def progress(stderr: Console, first_step: str, *, is_quiet: bool = False) -> Iterator[Report]:
    """Show a progress bar, or one line per new step if stderr is no terminal; nothing where it is to be quiet."""
    if is_quiet:
        yield lambda step, fraction: None
        return
    if not stderr.is_terminal:
        seen: set[str] = set()

        def print_step(step: str, fraction: float | None) -> None:
            if step not in seen:
                seen.add(step)
                stderr.print(step if fraction is None else f"{100.0 * fraction:3.0f} % {step}", markup=False)

        yield print_step
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=stderr, transient=True) as bar:
        task = bar.add_task(first_step, total=None)

        def show(step: str, fraction: float | None) -> None:
            bar.update(task, description=step, total=None if fraction is None else 1.0, completed=fraction)

        yield show

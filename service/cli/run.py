"""What all commands share: exit codes, one line for an error, cancelling with Ctrl-C, progress on stderr."""

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

from rich.console import Console

from costs.stopping import Stopped
from service.cli.report import print_verdict
from service.errors import ServiceError

EXIT_CODES = {
    "CERTIFIED": 0,
    "FEASIBLE_AT_SAMPLES": 4,
    "NOT_FOUND": 4,
    "INFEASIBLE": 4,
    "INVALID_REQUEST": 3,
    "TIME_LIMIT": 5,
    "CANCELLED": 130,
}
EXIT_INTERNAL = 70
INTERNAL_ERROR = "INTERNAL_ERROR"
MIN_WIDTH = 120  # a table in a log file need not be squeezed into 80 columns
TRACEBACK_VARIABLE = "SCOPT_TRACEBACK"


def consoles() -> tuple[Console, Console]:
    """Where results go (stdout) and where everything else goes (stderr)."""
    pair = Console(highlight=False), Console(stderr=True, highlight=False)
    for console in pair:
        if not console.is_terminal:
            console.width = max(console.width, MIN_WIDTH)
    return pair


def print_json(data: Mapping[str, Any]) -> None:
    """One object, and nothing else, on stdout."""
    sys.stdout.write(json.dumps(data, allow_nan=False) + "\n")
    sys.stdout.flush()


def without_result(verdict: str, explanation: tuple[str, ...], **more: object) -> dict[str, Any]:
    """What ``--json`` prints when there is no plan to speak of."""
    return {
        "verdict": verdict,
        "explanation": list(explanation),
        "planning_time_s": 0.0,
        "timings": {},
        "min_clearance_m": None,
        "phases": [],
        **more,
    }


class EndedError(Exception):
    """A command that ended for a reason with an exit code of its own.

    Attributes:
        verdict: one word for it; lines: what to say on stderr.
    """

    def __init__(self, verdict: str, lines: tuple[str, ...], exit_code: int) -> None:
        super().__init__("\n".join(lines))
        self.verdict = verdict
        self.lines = lines
        self.exit_code = exit_code


def run(command: Callable[[], str | None], as_json: bool = False, has_verdict: bool = False) -> int:
    """Run a command that returns a verdict, or None where there is nothing to judge; its exit code, whatever happens.

    Wrong input is one line per problem on stderr. On stdout, such an end too is an object with ``as_json``, else, with
    ``has_verdict``, a line that starts with the verdict.
    """

    def tell(ended: EndedError) -> None:
        """Say why there is no result."""
        out, err = consoles()
        for line in ended.lines:
            err.print(line, style="red", markup=False, soft_wrap=True)
        if as_json:
            print_json(without_result(ended.verdict, ended.lines))
        elif has_verdict:
            print_verdict(out, {"verdict": ended.verdict, "explanation": ended.lines})

    token = _TELL.set(tell)
    try:
        given = command()
        return 0 if given is None else EXIT_CODES[given]
    except EndedError as error:
        ended = error
    except ServiceError as error:
        ended = _ended("INVALID_REQUEST", *str(error).splitlines())
    except (KeyboardInterrupt, Stopped):
        ended = _CANCELLED
    except BrokenPipeError:
        # The reader of stdout has gone; nobody is left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_INTERNAL
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        line = " ".join(f"internal error, please report it: {type(error).__name__}: {error}".split())
        ended = EndedError(INTERNAL_ERROR, (f"{line} ({TRACEBACK_VARIABLE}=1 shows where)",), EXIT_INTERNAL)
    finally:
        _TELL.reset(token)
    tell(ended)
    return ended.exit_code


def _ended(verdict: str, *lines: str) -> EndedError:
    return EndedError(verdict, lines, EXIT_CODES[verdict])


_CANCELLED = _ended("CANCELLED", "cancelled")
_TELL: ContextVar[Callable[[EndedError], None]] = ContextVar("tell", default=lambda _: None)


@contextmanager
def cancellable(err: Console) -> Iterator[Callable[[], bool]]:
    """The first Ctrl-C asks the work in the body to stop and hand over its best; the second ends this process.

    Neither raises anything where the work is: that could be in native code whose threads go on.

    Yields what that work asks: whether to stop.
    """
    stop = threading.Event()

    def ask(signum: int, frame: FrameType | None) -> None:
        if stop.is_set():
            _end_at_once()
        stop.set()
        err.print("stopping; Ctrl-C again stops at once", style="yellow")

    earlier = signal.signal(signal.SIGINT, ask)
    try:
        yield stop.is_set
    finally:
        signal.signal(signal.SIGINT, earlier)


def _end_at_once() -> None:
    with suppress(RuntimeError, OSError):  # what is being written just now cannot be written into
        _TELL.get()(_CANCELLED)
        sys.stdout.flush()
    os._exit(_CANCELLED.exit_code)


@contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """SIGTERM is Ctrl-C while the body runs, so that nothing half done stays behind."""
    earlier = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, earlier)


@contextmanager
def progress(err: Console, first_step: str) -> Iterator[Callable[[str, float | None], None]]:
    """A progress bar on stderr; yields ``report(step, fraction done)``, None where nobody can tell how much is done.

    Where stderr is no terminal, each new step is one line.
    """
    if not err.is_terminal:
        seen: set[str] = set()

        def say(step: str, fraction: float | None) -> None:
            if step not in seen:
                seen.add(step)
                err.print(step if fraction is None else f"{100.0 * fraction:3.0f} % {step}", markup=False)

        yield say
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task(first_step, total=None)

        def show(step: str, fraction: float | None) -> None:
            bar.update(task, description=step, total=None if fraction is None else 1.0, completed=fraction)

        yield show

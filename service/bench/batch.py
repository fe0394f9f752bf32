"""Many requests planned at once on the cores of this machine, each into a folder of its own."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

from service.errors import RequestError, ServiceError

POLL_S = 0.2  # in which a batch notices that it is to stop
LOST = "LOST"
"""Verdict of a request whose process ended: killed, or out of memory."""


@dataclass(frozen=True)
class BatchRow:
    """Outcome of one request of a batch.

    Attributes:
        name: of the request in the batch.
        verdict: of the plan; INVALID_REQUEST for one that is refused, CANCELLED for one that was not begun, ``LOST``.
        clearance_m: proven clearance; None without a certificate of pairs [m].
        planning_time_s: wall time of the plan [s].
        reason: first line of the explanation; empty for a certified plan.
        folder: of the result; None where none was written.
    """

    name: str
    verdict: str
    clearance_m: float | None = None
    planning_time_s: float = 0.0
    reason: str = ""
    folder: Path | None = None


def plan_many(
    requests: Mapping[str, Path],
    out: Path,
    *,
    jobs: int | None = None,
    options: Mapping[str, Any] | None = None,
    on_row: Callable[[BatchRow], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> list[BatchRow]:
    """Plan request files at once; return a row for each, in their order.

    One that is refused, or not found, costs the others nothing. A script that calls this needs the usual guard
    ``if __name__ == "__main__":``, since its processes import it.

    Args:
        requests: request files by name; the result of ``NAME`` is written to the folder ``out / NAME``.
        out: folder of the results.
        jobs: processes at once; by default as many as there are cores.
        options: fields of ``options`` that replace those of every request.
        on_row: called with each row as it is made, in any order.
        should_stop: polled; once it returns True, plans that run end as cancelled and no further one begins.

    Raises:
        RequestError: there are no requests, or ``jobs`` is not positive.
    """
    if not requests:
        raise RequestError("requests: there are none; expected at least one request file")
    if jobs is not None and jobs < 1:
        raise RequestError(f"jobs: {jobs} processes cannot plan; expected at least 1")
    count = min(len(requests), jobs or len(os.sched_getaffinity(0)))
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    rows: dict[str, BatchRow] = {}
    with ProcessPoolExecutor(count, mp_context=context, initializer=_set_up, initargs=(stop,)) as pool:
        futures: dict[Future[BatchRow], str] = {
            pool.submit(_plan_one, name, path.resolve(), out / name, dict(options or {})): name
            for name, path in requests.items()
        }
        open_futures = set(futures)
        while open_futures:
            done, open_futures = wait(open_futures, POLL_S, FIRST_COMPLETED)
            for future in done:
                rows[futures[future]] = row = _take(future, futures[future])
                if on_row is not None:
                    on_row(row)
            if should_stop is not None and should_stop():
                stop.set()
    return [rows[name] for name in requests]


def find_batch_verdict(rows: Sequence[BatchRow]) -> str:
    """Return CERTIFIED if all are, else the verdict of the first that is not."""
    return next((row.verdict for row in rows if row.verdict != "CERTIFIED"), "CERTIFIED")


def _take(future: Future[BatchRow], name: str) -> BatchRow:
    try:
        return future.result()
    except BrokenProcessPool:
        return BatchRow(name, LOST, reason="a process of the batch ended; less memory may be free than --jobs need")


_STOP: Event | None = None


def _set_up(stop: Event) -> None:
    """Prepare a process: Ctrl-C is for the one that leads the batch."""
    global _STOP
    _STOP = stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _is_stopped() -> bool:
    return _STOP is not None and _STOP.is_set()


def _plan_one(name: str, path: Path, folder: Path, options: Mapping[str, Any]) -> BatchRow:
    """Plan a request file and write its result, in a process of the batch."""
    if _is_stopped():
        return BatchRow(name, "CANCELLED", reason="cancelled before it began")
    from service.planner import plan
    from service.request.file import load_request, replace_options
    from service.result.folder import check_folder
    from service.result.output import write_result

    try:
        request = replace_options(load_request(path), options)
        check_folder(folder)
        result = plan(request, should_stop=_is_stopped)
        write_result(result, folder)
    except ServiceError as error:
        return BatchRow(name, "INVALID_REQUEST", reason=str(error).splitlines()[0])
    except Exception as error:  # one request must not cost the others their rows
        return BatchRow(name, LOST, reason=" ".join(f"internal error: {type(error).__name__}: {error}".split()))
    clearance = None if result.certificate is None else result.certificate.min_clearance_m
    return BatchRow(
        name,
        result.verdict.value,
        clearance if clearance is not None and clearance == clearance else None,
        result.planning_time_s,
        next(iter(result.explanation), ""),
        folder,
    )

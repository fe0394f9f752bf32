"""Overhead of the pool of workers, and time until it stops or replaces a worker.

``python -m benchmarks.executor.overhead``.  Wall times in milliseconds under the present load of this machine, first
with empty workers, then with those of the planning service (imports shared, robot loaded).  Last, the gain from an idle
worker that tries further starts of a plan (``benchmarks.planning.spread``).
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from typing import Any

from benchmarks.executor import jobs
from benchmarks.planning import spread
from benchmarks.tables import print_table
from service.executor import Job, LocalPool, WorkerState

N_HOPS, N_EVENTS, N_STOPS, N_KILLS = 1000, 300, 100, 10
MIB = 2**20


def main() -> None:
    """Measure both pools, print."""
    from service.server.serve import PRELOAD
    from service.work.plan import warm_up

    columns = {"empty workers": _measure((), None), "planning workers": _measure(PRELOAD, warm_up)}
    rows = [(name, *(column[name] for column in columns.values())) for name in columns["empty workers"]]
    print_table("executor, two workers: median / p99 [ms]", ("", *columns), rows)
    spread.main()


def _measure(preload: tuple[str, ...], warm_up: Callable[[], object] | None) -> dict[str, str]:
    began = time.perf_counter()
    with LocalPool(2, preload=preload, warm_up=warm_up) as pool:
        pool.wait_ready()
        figures = {"start to full pool": _figure([time.perf_counter() - began])}
        cpu = time.process_time()
        figures["empty job, there and back"] = _figure([_timed(pool.submit, jobs.nothing) for _ in range(N_HOPS)])
        figures["  of it CPU of the server"] = _figure([(time.process_time() - cpu) / N_HOPS])
        figures["1 MiB there and back"] = _figure([_timed(pool.submit, jobs.echo, bytes(MIB)) for _ in range(50)])
        figures["event"] = _figure(_events(pool))
        seen, answered = zip(*(_stopped(pool) for _ in range(N_STOPS)), strict=True)
        figures["stop until the function sees it"] = _figure(seen)
        figures["stop until its answer is there"] = _figure(answered)
        killed, full = zip(*(_stuck(pool) for _ in range(N_KILLS)), strict=True)
        figures["stuck: stop until answered"] = _figure(killed)
        figures["stuck: stop until full pool"] = _figure(full)
        figures["kill -9 until full pool"] = _figure([_healed(pool) for _ in range(N_KILLS)])
        figures["memory of a worker alone [MiB]"] = f"{pool.submit(jobs.private_bytes).result() / MIB:.0f}"
        figures["  with what it shares [MiB]"] = f"{pool.stats().workers[0].rss_bytes / MIB:.0f}"
    return figures


def _figure(times_s: tuple[float, ...] | list[float]) -> str:
    ordered = sorted(times_s)
    median, p99 = ordered[len(ordered) // 2], ordered[int(0.99 * (len(ordered) - 1))]
    return f"{1e3 * median:.2f}" if len(ordered) == 1 else f"{1e3 * median:.2f} / {1e3 * p99:.2f}"


def _timed(submit: Callable[..., Job[Any]], *arguments: object) -> float:
    began = time.perf_counter()
    submit(*arguments).result()
    return time.perf_counter() - began


def _events(pool: LocalPool) -> list[float]:
    took: list[float] = []
    pool.submit(jobs.tell_the_time, N_EVENTS, on_event=lambda sent: took.append(time.monotonic() - sent)).result()
    return took


def _running(pool: LocalPool, fn: Callable[..., Any]) -> Job[Any]:
    """Return a job that has reported that it runs."""
    said: list[None] = []
    job = pool.submit(fn, on_event=said.append)
    while not said:
        time.sleep(0.001)
    return job


def _stopped(pool: LocalPool) -> tuple[float, float]:
    job = _running(pool, jobs.ask_without_rest)
    began = time.monotonic()
    job.cancel()
    return job.result() - began, time.monotonic() - began


def _stuck(pool: LocalPool) -> tuple[float, float]:
    job = _running(pool, jobs.stick)
    began = time.monotonic()
    job.cancel()
    job.exception()
    answered = time.monotonic()
    pool.wait_ready()
    return answered - began, time.monotonic() - began


def _healed(pool: LocalPool) -> float:
    victim = _idle(pool)[0]
    began = time.monotonic()
    os.kill(victim, signal.SIGKILL)
    while victim in (idle := _idle(pool)) or len(idle) < 2:
        time.sleep(0.0005)
    return time.monotonic() - began


def _idle(pool: LocalPool) -> list[int]:
    return [w.pid for w in pool.stats().workers if w.state is WorkerState.IDLE and w.pid is not None]


if __name__ == "__main__":
    main()

"""Twice as many requests as the workers can handle: admitted ones are answered in time, others refused at once."""

from __future__ import annotations

import time
from pathlib import Path
from statistics import fmean

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options, ms, percentile, spread
from benchmarks.service.load import Call, Load, generating
from benchmarks.service.servers import Server, started

WORKERS, QUEUE = 2, 4  # QUEUE for each worker
OVER, SLACK, REFUSED_S, GROWTH = 2.0, 1.2, 10e-3, 0.05
SAMPLE_EVERY_S = 2.0
WARM_SHARE = 0.2  # of the time, before memory is measured


def measure(options: Options, folder: Path) -> list[Figure]:
    """Measure an overload of ten minutes."""
    seconds = options.time_s(600.0, 20.0)
    request = asks.plan_request(asks.OVER_A_TABLE).SerializeToString()
    with started(folder, workers=WORKERS, queue=QUEUE) as server:
        warm = Load(server.address, request, "capacity", clients=WORKERS, seconds=min(20.0, seconds / 3.0))
        with generating(warm) as load:
            calls = load.result()
        capacity = len(calls) / (max(call.began + call.took for call in calls) - min(call.began for call in calls))
        rate = OVER * capacity
        over = Load(server.address, request, "overload", rate=rate, seconds=seconds, seed=options.seed)
        memory: list[tuple[float, float]] = []
        with generating(over) as load:
            while not load.done():
                memory.append(server.resident_mib())
                time.sleep(SAMPLE_EVERY_S)
            calls = load.result()
        return _figures(calls, capacity, memory, server)


def _figures(calls: list[Call], capacity: float, memory: list[tuple[float, float]], server: Server) -> list[Figure]:
    admitted = [call for call in calls if call.code == "OK"]
    refused = [call for call in calls if call.code == "RESOURCE_EXHAUSTED"]
    others = len(calls) - len(admitted) - len(refused)
    planned = [call.planned_s for call in admitted]
    solve = fmean(planned) if planned else float("nan")
    bound = (QUEUE + 1) * solve * SLACK
    took, at_once = [call.took for call in admitted], [call.took for call in refused]
    warm = memory[int(WARM_SHARE * len(memory)) :]
    grown = [last / first - 1.0 for first, last in zip(_mean(warm[:3]), _mean(warm[-3:]), strict=True)]
    return [
        Figure(
            f"{OVER:g}x overload: {len(calls)} requests, capacity {capacity:.1f}/s, solve {ms(solve)}; admitted",
            f"p99 <= (queue / workers + 1) x solve x 1.2 ({ms(bound)})",
            f"{spread(took)} ({len(admitted)})",
            percentile(took, 99) <= bound,
        ),
        Figure("  refused", f"p50 <= {ms(REFUSED_S)}", f"{spread(at_once)} ({len(refused)})",
               percentile(at_once, 50) <= REFUSED_S),
        Figure("  neither answered nor refused", "0", str(others), others == 0),
        Figure("  memory of the server", "grows < 5 %", f"{warm[-1][0]:.0f} MiB, {grown[0]:+.1%}", grown[0] < GROWTH),
        Figure("  memory of the largest worker", "grows < 5 %", f"{warm[-1][1]:.0f} MiB, {grown[1]:+.1%}",
               grown[1] < GROWTH),
        Figure("  incidents in the log", "0", str(server.incidents()), server.incidents() == 0),
    ]  # fmt: skip


def _mean(samples: list[tuple[float, float]]) -> tuple[float, ...]:
    return tuple(sum(column) / len(samples) for column in zip(*samples, strict=True))

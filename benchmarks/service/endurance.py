"""Thousands of solves in a row: the workers' memory does not grow with their number."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options, spread
from benchmarks.service.load import Load, generating
from benchmarks.service.servers import MIB, Server, started
from service.executor.linux import rss_bytes

WORKERS, CLIENTS = 2, 3
SAMPLE_EVERY_S = 0.5
WARM_SHARE = 0.3  # of the solves, before memory is measured
MOST_GROWTH = 0.02  # of a worker's memory over all solves of a run: the slope of a straight line through the samples
ATLAS_SHARE = 10  # one solve in this number is of Atlas


def measure(options: Options, folder: Path) -> list[Figure]:
    """Run 10,000 solves, one in ten of Atlas, the others of an arm."""
    n = options.solves or options.count(10_000, 200)
    found = []
    with started(folder, workers=WORKERS) as server:
        atlas = asks.plan_request(asks.OVER_A_TABLE).SerializeToString()
        arm = asks.plan_request(asks.ARM_TURNS).SerializeToString()
        n_atlas = max(n // ATLAS_SHARE, 1)
        samples: dict[int, list[tuple[float, float]]] = {}
        took, failed, began = [], 0, time.monotonic()
        loads = [Load(server.address, atlas, "atlas", clients=1, requests=n_atlas),
                 Load(server.address, arm, "arm", clients=CLIENTS - 1, requests=n - n_atlas)]  # fmt: skip
        with generating(loads[0]) as one, generating(loads[1]) as other:
            while not (one.done() and other.done()):
                _sample(server, samples)
                time.sleep(SAMPLE_EVERY_S)
            for load in (one, other):
                took += [call.took for call in load.result()]
                failed += sum(call.verdict != "CERTIFIED" for call in load.result())
        seconds = time.monotonic() - began
        restarts = server.status().worker_restarts
        server_mib = rss_bytes(server.process.pid) / MIB
    for pid, values in samples.items():
        slope, mean = _slope(np.array(values))
        growth = slope * values[-1][0] / mean
        found.append(
            Figure(
                f"  memory of worker {pid} over {values[-1][0]:.0f} solves",
                f"no slope (within {MOST_GROWTH:.0%} of {mean:.0f} MiB)",
                f"{1024 * slope:+.2f} KiB per solve, {growth:+.2%} in all",
                growth < MOST_GROWTH,
            )
        )
    return [
        Figure(f"{len(took)} solves in a row: not certified, workers replaced", "0", f"{failed}, {restarts}",
               failed == 0 and restarts == 0),
        *found,
        Figure("  memory of the server at the end", "", f"{server_mib:.0f} MiB"),
        Figure(f"  {len(took) / seconds:.1f} solves per second; time of an answer", "", spread(took)),
    ]  # fmt: skip


def _sample(server: Server, samples: dict[int, list[tuple[float, float]]]) -> None:
    """Record the finished jobs and the memory [MiB] of every worker."""
    for worker in server.status().workers:
        if worker.pid:
            samples.setdefault(worker.pid, []).append((float(worker.jobs_done), worker.resident_bytes / MIB))


def _slope(values: np.ndarray) -> tuple[float, float]:
    """Return the slope of a line through the later samples [MiB per solve], and their mean [MiB]."""
    jobs, memory = values[values[:, 0] >= WARM_SHARE * values[-1, 0]].T
    if np.ptp(jobs) == 0.0:
        return 0.0, float(memory.mean())
    return float(np.polyfit(jobs, memory, 1)[0]), float(memory.mean())

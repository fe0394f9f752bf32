"""Gain from further starts in an idle worker (``scopt serve --spread 2``).

``python -m benchmarks.planning.spread [N]``.

Crowded scenes whose straight line is blocked are planned by one worker, then by two as a server with ``--spread 2``
does, where the first certificate wins.  Wall time and processor time of both workers, on this machine and with whatever
else it does; with one core or less to itself, the second start can only cost.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from statistics import median

from benchmarks.planning.crowded_scenes import crowded_scenes
from benchmarks.tables import print_table
from costs.robot import load_robot
from service.executor import LocalPool, WorkerState
from service.request.schema import PlanRequest
from service.server.admission import Admission
from service.server.jobs import JobRunner
from service.server.spread import await_certified, with_other_seed
from service.work.plan import PlanAnswer, PlanTask, Refused, run_plan, warm_up

N_SCENES, N_BOXES = 12, 120
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Planned:
    """One plan: its verdict, wall time and the workers' processor time [s]."""

    verdict: str
    wall_s: float
    cpu_s: float


def main() -> None:
    """Measure, print; the number of scenes is the first argument."""
    from service.server.serve import PRELOAD

    n = int(sys.argv[1]) if len(sys.argv) > 1 else N_SCENES
    scenes = (s for s in crowded_scenes(load_robot("atlas"), N_BOXES, is_pose=True) if not s.is_straight_enough)
    requests = [scene.request for scene in islice(scenes, n)]
    with LocalPool(2, preload=PRELOAD, warm_up=warm_up) as pool:
        pool.wait_ready()
        pairs = asyncio.run(_both(pool, requests))
    _print(pairs)


async def _both(pool: LocalPool, requests: Sequence[PlanRequest]) -> list[tuple[Planned, Planned]]:
    """Each planned by one worker, and by two; which of them comes first alternates."""
    shop, pairs = JobRunner(pool, Admission(2, 8)), []
    for k, request in enumerate(requests):
        found = {n: await _planned(pool, shop, request, n) for n in ((1, 2) if k % 2 == 0 else (2, 1))}
        pairs.append((found[1], found[2]))
    await _idle(pool)
    return pairs


async def _idle(pool: LocalPool) -> None:
    """Wait until nobody works: who has lost still stops."""
    while any(worker.state is not WorkerState.IDLE for worker in pool.stats().workers):
        await asyncio.sleep(0.005)


async def _planned(pool: LocalPool, shop: JobRunner, request: PlanRequest, n_workers: int) -> Planned:
    await _idle(pool)
    pids = [worker.pid for worker in pool.stats().workers if worker.pid is not None]
    cpu, began, task = _cpu_s(pids), time.perf_counter(), PlanTask(request)
    piece = shop.start("pose_goal", run_plan, task, deadline=None, budget_s=60.0)
    spares = [shop.start_spare(run_plan, with_other_seed(task, k)) for k in range(1, n_workers)]
    answer: PlanAnswer | Refused = await await_certified(piece, [spare for spare in spares if spare is not None])
    wall = time.perf_counter() - began
    return Planned(answer.verdict if isinstance(answer, PlanAnswer) else "refused", wall, _cpu_s(pids) - cpu)


def _cpu_s(pids: Sequence[int]) -> float:
    """Processor time of processes so far [s], to a hundredth."""
    stats = (Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in pids)
    return sum(int(fields[11]) + int(fields[12]) for fields in stats) / TICKS_PER_S


def _print(pairs: Sequence[tuple[Planned, Planned]]) -> None:
    rows = []
    for name, column in (("one worker", [pair[0] for pair in pairs]), ("two workers", [pair[1] for pair in pairs])):
        certified = sum(one.verdict == "CERTIFIED" for one in column)
        walls, cpus = [one.wall_s for one in column], [one.cpu_s for one in column]
        times = (median(walls), max(walls), sum(walls), sum(cpus))
        rows.append((name, f"{certified} of {len(column)}", *(f"{seconds:.2f}" for seconds in times)))
    columns = ("", "certified", "median [s]", "slowest [s]", "all [s]", "processor time of all [s]")
    print_table("one plan from several workers, among 120 boxes", columns, rows)
    ratios = [alone.wall_s / spread.wall_s for alone, spread in pairs]
    whole = sum(alone.wall_s for alone, _ in pairs) / sum(spread.wall_s for _, spread in pairs)
    print(f"speed-up: median {median(ratios):.2f}, of all together {whole:.2f}")


if __name__ == "__main__":
    main()

"""One plan on several workers: idle ones try further starts, and the first certificate wins."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace

from service.result.result import Verdict
from service.server.jobs import JobHandle, await_result
from service.work.plan import PlanAnswer, PlanTask, Refused

SEED_STEP = 1000  # more than the seeds that the starts of one plan use
SEEDS = 2**32
# Verdicts that other starts may improve.
OPEN_VERDICTS = frozenset(
    verdict.value for verdict in (Verdict.NOT_FOUND, Verdict.FEASIBLE_AT_SAMPLES, Verdict.TIME_LIMIT)
)

Answer = PlanAnswer | Refused


def with_other_seed(task: PlanTask, number: int) -> PlanTask:
    """Return the same task with other random starts; ``number`` counts from 1."""
    request = task.request
    seed = (request.options.seed + SEED_STEP * number) % SEEDS
    seeded = replace(request, options=replace(request.options, seed=seed))
    return replace(task, request=seeded, original=task.original or request)


async def await_certified(own: JobHandle[Answer], others: Sequence[JobHandle[Answer]]) -> Answer:
    """Return the first certified answer, else the plan's own; the remaining jobs are stopped.

    Raises:
        Refusal: as ``await_result`` of the plan's own job.
    """
    main = asyncio.ensure_future(await_result(own))
    helpers = {asyncio.ensure_future(await_result(other)) for other in others}
    try:
        while helpers:
            if main.done() and not _is_open(main.result()):
                break
            waiting = helpers if main.done() else {main, *helpers}
            done, _ = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
            if main not in done or _is_open(main.result()):
                for helper in done & helpers:
                    if helper.exception() is None and _is_certified(helper.result()):
                        return helper.result()
            helpers -= done
        return await main
    finally:
        for handle in (own, *others):
            handle.cancel()
        for task in (main, *helpers):
            task.cancel()


def _is_open(answer: Answer) -> bool:
    return isinstance(answer, PlanAnswer) and answer.verdict in OPEN_VERDICTS


def _is_certified(answer: Answer) -> bool:
    return isinstance(answer, PlanAnswer) and answer.verdict == Verdict.CERTIFIED.value

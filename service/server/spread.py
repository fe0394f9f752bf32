"""One plan from several workers: those that nobody else needs try further starts, and the first certificate wins."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace

from service.request.schema import PlanRequest
from service.result.result import Verdict
from service.server.workshop import Piece, outcome
from service.work.plan import PlanAnswer, PlanTask, Refused

SEED_STEP = 1000  # more than the random draws that one plan's starts are numbered by
SEEDS = 2**32
# What another worker's starts may better; everything else is an answer that no start can change.
OPEN = frozenset(one.value for one in (Verdict.NOT_FOUND, Verdict.FEASIBLE_AT_SAMPLES, Verdict.TIME_LIMIT))

Answer = PlanAnswer | Refused


def with_other_starts(task: PlanTask, number: int) -> PlanTask:
    """The same task from other random draws; ``number`` counts from 1."""
    seed = (task.request.options.seed + SEED_STEP * number) % SEEDS
    return replace(task, request=_seeded(task.request, seed), original=task.original or task.request)


async def first_certified(own: Piece[Answer], others: Sequence[Piece[Answer]]) -> Answer:
    """The first certified answer, else the plan's own; whatever still runs then is stopped.

    Raises:
        Refusal: what ``outcome`` says of the plan's own.
    """
    main = asyncio.ensure_future(outcome(own))
    helping = {asyncio.ensure_future(outcome(other)) for other in others}
    try:
        while helping:
            if main.done() and not _is_open(main.result()):
                break
            waiting = helping if main.done() else {main, *helping}
            done, _ = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
            if main not in done or _is_open(main.result()):
                for other in done & helping:
                    if other.exception() is None and _is_certified(other.result()):
                        return other.result()
            helping -= done
        return await main
    finally:
        for piece in (own, *others):
            piece.cancel()
        for task in (main, *helping):
            task.cancel()


def _is_open(answer: Answer) -> bool:
    return isinstance(answer, PlanAnswer) and answer.verdict in OPEN


def _is_certified(answer: Answer) -> bool:
    return isinstance(answer, PlanAnswer) and answer.verdict == Verdict.CERTIFIED.value


def _seeded(request: PlanRequest, seed: int) -> PlanRequest:
    return replace(request, options=replace(request.options, seed=seed))

"""Work handed over from the event loop: what the server ends itself, it says so."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import grpc
import pytest
from executor_jobs import nap

from service.executor.local_pool import LocalPool
from service.server import workshop
from service.server.admission import Admission
from service.server.workshop import Piece, Workshop, outcome
from service.trust.rpc import Refusal


@pytest.fixture(scope="module")
def pool() -> Iterator[LocalPool]:
    with LocalPool(1, grace_s=0.05) as made:
        yield made


async def _begun(shop: Workshop) -> Piece[None]:
    piece = shop.start("scene", nap, 60.0, deadline=None, budget_s=0.0)
    while piece.job.started is None:
        await asyncio.sleep(0.01)
    return piece


def test_work_that_took_longer_than_it_may_is_told_how_long_that_is(
    pool: LocalPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workshop, "OVERTIME_S", 0.0)

    async def ends() -> Refusal:
        shop = Workshop(pool, Admission(1, 4))
        piece = await _begun(shop)
        shop.stop_overtime()
        with pytest.raises(Refusal) as refused:
            await outcome(piece)
        return refused.value

    refusal = asyncio.run(ends())
    assert refusal.code is grpc.StatusCode.DEADLINE_EXCEEDED
    assert refusal.text.startswith("scene is allowed 0 s")


def test_what_a_stopping_server_ends_is_sent_elsewhere(pool: LocalPool) -> None:
    async def ends() -> list[grpc.StatusCode]:
        shop = Workshop(pool, Admission(1, 4))
        pieces = [await _begun(shop), shop.start("scene", nap, 60.0, deadline=None, budget_s=60.0)]
        shop.stop_all()
        found = await asyncio.gather(*(outcome(piece) for piece in pieces), return_exceptions=True)
        await asyncio.wait_for(shop.emptied(), 5.0)
        return [error.code for error in found if isinstance(error, Refusal)]

    assert asyncio.run(ends()) == [grpc.StatusCode.UNAVAILABLE] * 2

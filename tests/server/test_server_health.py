"""Health is that of all parts of the server together, and damage is logged for the operator."""

from __future__ import annotations

import asyncio
from typing import Any

import grpc
from grpc_health.v1 import health_pb2
from structlog.testing import capture_logs

from service.server.lifecycle import Health
from service.server.refusals import refuse_error
from service.store import DamagedError

SERVING = health_pb2.HealthCheckResponse.SERVING
NOT_SERVING = health_pb2.HealthCheckResponse.NOT_SERVING


def test_a_server_serves_while_all_parts_are_ready_and_does_not_end() -> None:
    async def run() -> list[int]:
        health, context = Health(("planner",)), None
        seen = []

        async def check() -> None:
            request = health_pb2.HealthCheckRequest(service="planner")
            seen.append((await health.Check(request, as_any(context))).status)

        await check()
        for part, is_ready, is_new in (
            ("workers", False, True),
            ("disk", False, True),
            ("disk", False, False),
            ("workers", True, True),
            ("disk", True, True),
        ):
            assert health.set_ready(part, is_ready) == is_new
            await check()
        health.end()
        await check()
        return seen

    assert asyncio.run(run()) == [SERVING, *[NOT_SERVING] * 4, SERVING, NOT_SERVING]


def test_damage_is_told_to_the_client_by_its_id_and_to_the_log_by_its_file() -> None:
    with capture_logs() as lines:
        refusal = refuse_error(DamagedError("plan p1: is damaged", "/data/store.sqlite3: is damaged (row 7)"))
    assert (refusal.code, refusal.text) == (grpc.StatusCode.DATA_LOSS, "plan p1: is damaged")
    assert [line["detail"] for line in lines] == ["/data/store.sqlite3: is damaged (row 7)"]


def as_any(value: object) -> Any:
    return value

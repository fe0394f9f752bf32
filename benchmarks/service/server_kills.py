"""Kills of the server: all that it confirmed is there after a restart, and no process is left over."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import grpc

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options, spread
from benchmarks.service.servers import Server, descendants, started, still_there
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub

WORKERS, CLIENTS = 2, 4
LONGEST_S = 3.0  # until the kill
ORPHANS_S = 1.0
UNLIMITED = ("--requests-per-s", "100000")  # many plans are read at once


@dataclass
class _Told:
    """Confirmations by a server before it was killed.

    Attributes:
        plans: hashes of trajectory and certificate by plan id.
        reviewed: ids of plans whose acceptance was confirmed.
    """

    plans: dict[str, tuple[str, str]] = field(default_factory=dict)
    reviewed: set[str] = field(default_factory=set)


def measure(options: Options, folder: Path) -> list[Figure]:
    """Kill the server (``kill -9``) at random times."""
    n, random = options.count(20, 3), Random(options.seed)
    told, back = _Told(), []
    orphans = missing = unapproved = 0
    for _ in range(n):
        began = time.monotonic()
        with started(folder, *UNLIMITED, workers=WORKERS) as server:
            back.append(time.monotonic() - began)
            missing, unapproved = _count_missing(server, told)  # of all plans that earlier servers confirmed
            processes = _killed_under_load(server, told, random.uniform(0.5, LONGEST_S))
            time.sleep(ORPHANS_S)
            orphans += len(still_there(processes))
    with started(folder, *UNLIMITED, workers=WORKERS) as server:
        missing, unapproved = _count_missing(server, told)
    return [
        Figure(f"server killed {n} times: finished plans that are gone, of {len(told.plans)}", "0", str(missing),
               missing == 0 and bool(told.plans)),
        Figure("  accepted reviews that are gone, of " + str(len(told.reviewed)), "0", str(unapproved),
               unapproved == 0 and bool(told.reviewed)),
        Figure("  processes left over after 1 s", "0", str(orphans), orphans == 0),
        Figure("  start to the first answer", "", spread(back)),
    ]  # fmt: skip


def _killed_under_load(server: Server, told: _Told, after_s: float) -> dict[int, str]:
    """Plan and review until the server is killed; return the processes that it had started, by id."""
    request = asks.plan_request(asks.ELBOW)
    clients = [threading.Thread(target=_plan_and_review, args=(server.address, request, told)) for _ in range(CLIENTS)]
    for client in clients:
        client.start()
    time.sleep(after_s)
    processes = descendants(server.process.pid)
    server.kill()
    for client in clients:
        client.join()
    return processes


def _plan_and_review(address: str, request: wire.PlanRequest, told: _Told) -> None:
    """Plan and review as one client until the server is gone."""
    with grpc.insecure_channel(address) as channel, suppress(grpc.RpcError):
        stub: Any = PlannerServiceStub(channel)  # type: ignore[no-untyped-call]
        while True:
            finished = next(
                one.finished for one in stub.Plan(request, timeout=60) if one.WhichOneof("event") == "finished"
            )
            hashes = finished.result.trajectory.sha256, finished.result.certificate.sha256
            told.plans[finished.plan_id] = hashes
            if len(told.plans) % 2:
                review = wire.ReviewPlanRequest(
                    plan_id=finished.plan_id,
                    decision=wire.DECISION_ACCEPTED,
                    trajectory_sha256=hashes[0],
                    certificate_sha256=hashes[1],
                )
                stub.ReviewPlan(review, timeout=20)
                told.reviewed.add(finished.plan_id)


def _count_missing(server: Server, told: _Told) -> tuple[int, int]:
    """Count the finished plans that are lost or changed, and the accepted ones without their acceptance."""
    missing = unapproved = 0
    with server.stub() as stub:
        for plan_id, hashes in told.plans.items():
            try:
                record = next(iter(stub.GetPlan(wire.GetPlanRequest(plan_id=plan_id), timeout=20))).record
            except grpc.RpcError:
                record = wire.PlanRecord()
            result = record.result
            missing += hashes != (result.trajectory.sha256, result.certificate.sha256)
            unapproved += plan_id in told.reviewed and not record.is_approved
    return missing, unapproved

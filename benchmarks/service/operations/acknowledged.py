"""Plans and reviews that were confirmed, under kills of every process and a full disk: none lost, doubled or undone.

Clients plan and review with names of their own (``request_id``) and repeat what was not answered, as the client of the
package does.  Meanwhile, in random order, the server is killed, also while its store grows, as are the process that
workers are forked from and a worker, and for a while nothing that the server writes is taken.
"""

from __future__ import annotations

import resource
import shutil
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import grpc

from benchmarks.service import asks
from benchmarks.service.figures import Figure, Options
from benchmarks.service.servers import Server, descendants, kill, started
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub

WORKERS, CLIENTS = 2, 4
ITEMS, FEW_ITEMS = 1000, 4  # plans and reviews that are to be confirmed; in a short run
LEAST_S, LONGEST_S = 0.5, 8.0  # between two blows
FULL_S, GROWS_S = 0.5, 3.0  # of a full disk, and longest wait for a growing store
SMALL_BYTES = 512 << 20  # free on a file system that is filled in a moment
PAGE = 500
BUSY = ("UNAVAILABLE", "RESOURCE_EXHAUSTED", "DEADLINE_EXCEEDED", "CANCELLED", "ABORTED")  # such calls are repeated
ARGUMENTS = ("--requests-per-s", "100000")


@dataclass
class _Told:
    """What servers have confirmed.

    Attributes:
        plans: by the client's name of it, id and hashes of trajectory and certificate.
        reviews: names of the plans whose acceptance was confirmed.
        refused: what the server said where it ought to take a plan or a review.
        address: of the present server; empty while there is none.
        is_over: whether clients are to stop.
    """

    plans: dict[str, tuple[str, str, str]] = field(default_factory=dict)
    reviews: set[str] = field(default_factory=set)
    refused: list[str] = field(default_factory=list)
    address: str = ""
    is_over: bool = False

    @property
    def count(self) -> int:
        """Number of confirmed plans and reviews."""
        return len(self.plans) + len(self.reviews)


def measure(options: Options, folder: Path) -> list[Figure]:
    """Strike until enough is confirmed or time is over, then compare all that is stored with all that was confirmed."""
    random, told, blows = Random(options.seed), _Told(), Counter[str]()
    due = list(BLOWS)  # each kind once, first those that leave the server alive; then at random
    until, items = time.monotonic() + options.time_s(1200.0, 60.0), options.count(ITEMS, FEW_ITEMS)
    clients = [threading.Thread(target=_plan_and_review, args=(told, k)) for k in range(CLIENTS)]
    for client in clients:
        client.start()
    while time.monotonic() < until and told.count < items:
        with started(folder, *ARGUMENTS, workers=WORKERS) as server:
            told.address = server.address
            while server.is_alive() and time.monotonic() < until and told.count < items:
                time.sleep(random.uniform(LEAST_S, LONGEST_S))
                name = due.pop() if due else random.choices(list(BLOWS), WEIGHTS)[0]
                blows[name] += BLOWS[name](server, folder)
            told.address = ""
    told.is_over = True
    for client in clients:
        client.join()
    with started(folder, *ARGUMENTS, workers=WORKERS) as server:
        lost, undone, doubled = _compare(server, told)
    words = ", ".join(f"{name} {count}" for name, count in sorted(blows.items()))
    plans, reviews = len(told.plans), len(told.reviews)
    return [
        Figure(f"{sum(blows.values())} blows ({words})", "", ""),
        Figure("  confirmed plans and reviews", str(items), str(told.count), told.count >= items),
        Figure("  refused for what it asks", "0", " ".join(told.refused[:1]) or "0", not told.refused),
        Figure(f"  lost or changed plans, of {plans}", "0", str(lost), lost == 0 and plans > 0),
        Figure(f"  undone or repeated reviews, of {reviews}", "0", str(undone), undone == 0 and reviews > 0),
        Figure(f"  plans made twice, of {plans}", "0", str(doubled), doubled == 0 and plans > 0),
    ]


def _plan_and_review(told: _Told, client: int) -> None:
    """Plan and review one request after the other; repeat each until it is confirmed."""
    request, number = asks.plan_request(asks.SWING), 0
    while not told.is_over:
        name = f"client-{client}-{number}"
        request.request_id = name
        try:
            with grpc.insecure_channel(told.address or "127.0.0.1:1") as channel:
                stub: Any = PlannerServiceStub(channel)  # type: ignore[no-untyped-call]
                while not told.is_over:
                    name = request.request_id = f"client-{client}-{number}"
                    if name not in told.plans:
                        told.plans[name] = _plan(stub, request)
                    if told.plans[name][1]:  # one that met its deadline has no trajectory, and cannot be accepted
                        _review(stub, told.plans[name])
                        told.reviews.add(name)
                    number += 1
        except grpc.RpcError as error:
            if error.code().name not in BUSY:
                told.refused.append(f"{error.code().name} {error.details()}")
            time.sleep(0.1)


def _plan(stub: Any, request: wire.PlanRequest) -> tuple[str, str, str]:
    """Return id and hashes of a finished plan."""
    events = (event for event in stub.Plan(request, timeout=20) if event.WhichOneof("event") == "finished")
    finished = next(events).finished
    return finished.plan_id, finished.result.trajectory.sha256, finished.result.certificate.sha256


def _review(stub: Any, plan: tuple[str, str, str]) -> None:
    """Accept a plan, unless an acceptance whose answer was lost has been stored."""
    record = next(iter(stub.GetPlan(wire.GetPlanRequest(plan_id=plan[0]), timeout=20))).record
    if not record.is_approved:
        review = wire.ReviewPlanRequest(
            plan_id=plan[0], decision=wire.DECISION_ACCEPTED, trajectory_sha256=plan[1], certificate_sha256=plan[2]
        )
        stub.ReviewPlan(review, timeout=20)


def _compare(server: Server, told: _Told) -> tuple[int, int, int]:
    """Count plans that are gone or changed, reviews that are not there once, and requests with two finished plans."""
    lost = undone = 0
    finished, token = Counter[str](), ""
    with server.stub() as stub:
        for name, (plan_id, *hashes) in told.plans.items():
            try:
                record = next(iter(stub.GetPlan(wire.GetPlanRequest(plan_id=plan_id), timeout=60))).record
            except grpc.RpcError:
                record = wire.PlanRecord()
            result = record.result
            lost += hashes != [result.trajectory.sha256, result.certificate.sha256] or record.request_id != name
            undone += name in told.reviews and (len(record.reviews) != 1 or not record.is_approved)
        while True:
            page = stub.ListPlans(wire.ListPlansRequest(page_size=PAGE, page_token=token), timeout=60)
            finished.update(plan.request_id for plan in page.plans if plan.trajectory_sha256)
            token = page.next_page_token
            if not token:
                return lost, undone, sum(count > 1 for count in finished.values())


def _kill_server(server: Server, folder: Path) -> bool:
    server.kill()
    return True


def _kill_writer(server: Server, folder: Path) -> bool:
    """Kill the server while its store grows."""
    files = list((folder / "data").rglob("*-wal"))
    sizes, end = {file: file.stat().st_size for file in files}, time.monotonic() + GROWS_S
    while time.monotonic() < end:
        with suppress(OSError):
            if any(file.stat().st_size != size for file, size in sizes.items()):
                break
    server.kill()
    return True


def _kill_named(name: str) -> Callable[[Server, Path], bool]:
    """Return a blow at one process of the server of a name."""

    def strike(server: Server, folder: Path) -> bool:
        pids = []
        for pid in descendants(server.process.pid):
            with suppress(OSError):
                if Path(f"/proc/{pid}/comm").read_text().strip() == name:
                    pids.append(pid)
        return bool(pids) and kill(pids[-1])

    return strike


def _fill_disk(server: Server, folder: Path) -> bool:
    """Let nothing that the server writes to a file be taken for a while; fill its file system, if that is small.

    ``TMPDIR`` may name a folder on such a file system.
    """
    free = shutil.disk_usage(folder).free
    if free < SMALL_BYTES:
        ballast = folder / "ballast"
        with suppress(OSError), ballast.open("wb", buffering=0) as file:
            while file.write(bytes(1 << 20)):
                pass
        time.sleep(FULL_S)
        ballast.unlink()
        return True
    pid = server.process.pid
    try:
        before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, before[1]))
        time.sleep(FULL_S)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, before)
    except ProcessLookupError:
        return False
    return True


BLOWS: Mapping[str, Callable[[Server, Path], bool]] = {
    "server": _kill_server,
    "server while it writes": _kill_writer,
    "fork server": _kill_named("scopt-forksrv"),
    "worker": _kill_named("scopt-worker"),
    "full disk": _fill_disk,
}
WEIGHTS = (1, 1, 2, 4, 2)  # a server takes longer to come back than a worker

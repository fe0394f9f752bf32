"""A real server that is killed, robbed of its workers, stopped, or started where it cannot be."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import grpc
import pytest
from executor_waiting import until
from grpc_health.v1 import health_pb2, health_pb2_grpc
from planner_calls import ENDLESS, finished, plan_request, refusal, search_for, wait_for
from planner_server import ServerProcess, never_ready, planner_server

from benchmarks.service.servers import descendants, still_there
from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.proto.planner.v1.result_pb2 import VERDICT_NOT_FOUND, VERDICT_TIME_LIMIT

pytestmark = pytest.mark.filterwarnings("error")

ENDED = {VERDICT_NOT_FOUND, VERDICT_TIME_LIMIT}  # for lack of time, after the attempts that there was time for
NOT_SERVING = health_pb2.HealthCheckResponse.NOT_SERVING


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("server") / "data"


@pytest.fixture(scope="module")
def server(data: Path) -> Iterator[ServerProcess]:
    with planner_server(data, workers=2) as started:
        yield started


@pytest.fixture
def stub(server: ServerProcess) -> Iterator[PlannerServiceStub]:
    with grpc.insecure_channel(server.address) as channel:
        yield PlannerServiceStub(channel)


def test_plan_whose_worker_is_killed_is_answered_once(stub: PlannerServiceStub) -> None:
    call = stub.Plan(plan_request(search_for(5.0)), timeout=240)
    wait_for(call, "progress")
    (busy,) = [one.pid for one in stub.GetStatus(wire.GetStatusRequest(), timeout=120).workers if one.state == "busy"]
    os.kill(busy, signal.SIGKILL)
    assert finished(call).result.verdict in ENDED
    status = stub.GetStatus(wire.GetStatusRequest(), timeout=120)
    assert (status.worker_restarts, sum(status.verdicts.values())) == (1, 1)


def test_second_server_on_the_same_folder_is_refused(server: ServerProcess, data: Path) -> None:
    code, words = never_ready(data)
    assert code == 3
    assert words.splitlines()[-1] == (f"{data / 'plans'}: in use by another server; stop it, or choose another folder")


def test_second_server_on_the_same_port_is_refused(server: ServerProcess, tmp_path: Path) -> None:
    code, words = never_ready(tmp_path / "data", "--listen", server.address)
    assert code == 3
    assert words.splitlines()[-1] == f"--listen {server.address}: cannot listen there; does another server use it?"


def test_killed_server_leaves_no_process_and_loses_nothing_that_it_told(
    server: ServerProcess, stub: PlannerServiceStub, data: Path
) -> None:
    told = finished(stub.Plan(plan_request(request_id="mine", with_files=True), timeout=240))
    hashes = told.result.trajectory.sha256, told.result.certificate.sha256
    page = next(stub.GetPlan(wire.GetPlanRequest(plan_id=told.plan_id), timeout=120)).record.page_sha256
    stub.ReviewPlan(
        wire.ReviewPlanRequest(
            plan_id=told.plan_id,
            decision=wire.DECISION_ACCEPTED,
            trajectory_sha256=hashes[0],
            certificate_sha256=hashes[1],
            page_sha256=page,
        ),
        timeout=120,
    )
    under_way = stub.Plan(plan_request(ENDLESS, request_id="lost"), timeout=240)
    lost_id = wait_for(under_way, "accepted").accepted.plan_id
    wait_for(under_way, "progress")
    processes = descendants(server.process.pid)
    assert len(processes) >= 2
    server.process.kill()
    server.process.wait()
    assert until(lambda: not still_there(processes))
    code, _, _ = refusal(lambda: list(under_way))
    assert code == "UNAVAILABLE"
    with planner_server(data) as again, grpc.insecure_channel(again.address) as channel:
        back = PlannerServiceStub(channel)
        record = next(back.GetPlan(wire.GetPlanRequest(plan_id=told.plan_id, with_files=True), timeout=120)).record
        assert record.is_approved
        assert record.result == told.result
        assert finished(back.Plan(plan_request(request_id="mine", with_files=True), timeout=120)) == told
        open_plan = next(back.GetPlan(wire.GetPlanRequest(plan_id=lost_id))).record
        assert open_plan.state in (wire.PLAN_STATE_QUEUED, wire.PLAN_STATE_RUNNING)
        joined = back.Plan(plan_request(ENDLESS, request_id="lost"), timeout=240)
        accepted = wait_for(joined, "accepted").accepted
        assert accepted.plan_id == lost_id
        assert wait_for(joined, "progress")


def test_stopping_server_finishes_what_is_under_way_and_takes_nothing_more(tmp_path: Path) -> None:
    with planner_server(tmp_path / "data") as server, grpc.insecure_channel(server.address) as channel:
        stub, watches = PlannerServiceStub(channel), [_Watch(channel) for _ in range(2)]
        call = stub.Plan(plan_request(search_for(6.0)), timeout=240)
        wait_for(call, "progress")
        processes = descendants(server.process.pid)
        server.process.terminate()
        for watch in watches:  # also the second of them
            assert watch.until(NOT_SERVING)
        with grpc.insecure_channel(server.address) as another:
            late = PlannerServiceStub(another)
            assert late.GetStatus(wire.GetStatusRequest(), timeout=120).is_draining
            code, words, _ = refusal(lambda: list(late.Plan(plan_request(), timeout=120)))
        assert (code, words) == ("UNAVAILABLE", "the server is stopping; try another one, or later")
        assert server.process.poll() is None
        assert finished(call).result.verdict in ENDED
        # Who watches the health of a server does not keep it from going.
        assert server.process.wait(120.0) == 0
        assert until(lambda: not still_there(processes))


def test_what_is_under_way_when_the_drain_is_over_is_told_so(tmp_path: Path) -> None:
    with (
        planner_server(tmp_path / "data", "--drain", "0.2") as server,
        grpc.insecure_channel(server.address) as channel,
    ):
        call = PlannerServiceStub(channel).Plan(plan_request(ENDLESS), timeout=240)
        wait_for(call, "progress")
        server.process.terminate()
        code, words, _ = refusal(lambda: list(call))
        assert (code, words) == ("UNAVAILABLE", "the server is stopping; try another one, or later")
        assert server.process.wait(120.0) == 0


def test_second_signal_ends_at_once_and_says_so_to_every_call(tmp_path: Path) -> None:
    with planner_server(tmp_path / "data") as server, grpc.insecure_channel(server.address) as channel:
        stub, more = PlannerServiceStub(channel), threading.Event()
        call = stub.Plan(plan_request(ENDLESS), timeout=240)
        wait_for(call, "progress")
        waiting = stub.Plan(plan_request(ENDLESS), timeout=240)
        wait_for(waiting, "queued")
        upload = stub.UploadCloud.future(_never_ending(more), timeout=240)
        assert until(lambda: list((tmp_path / "data" / "clouds").glob(".partial-*")))
        processes = descendants(server.process.pid)
        server.process.terminate()
        assert until(lambda: "draining" in server.log.read_text())
        time.sleep(0.2)
        assert server.process.poll() is None
        assert server.stop() == 0
        for ended in (lambda: list(call), lambda: list(waiting), upload.result):
            code, words, _ = refusal(ended)
            assert (code, words) == ("UNAVAILABLE", "the server is going down now; try another one, or later")
        more.set()
        assert until(lambda: not still_there(processes))


def test_server_can_be_stopped_while_it_starts(tmp_path: Path) -> None:
    found: dict[int, str] = {}

    def stop(pid: int) -> None:
        assert until(lambda: descendants(pid))
        found.update(descendants(pid))
        os.kill(pid, signal.SIGTERM)

    _, words = never_ready(tmp_path / "data", at_start=stop)
    assert "Traceback" not in words
    assert until(lambda: not still_there(found))


def _never_ending(more: threading.Event) -> Iterator[wire.UploadCloudRequest]:
    """The beginning of a cloud."""
    yield wire.UploadCloudRequest(header={"format": "xyz"})  # type: ignore[arg-type]
    yield wire.UploadCloudRequest(chunk=b"1 2 3\n")
    more.wait(240.0)


class _Watch:
    """Watches the health of a server in a thread of its own."""

    def __init__(self, channel: grpc.Channel) -> None:
        self._seen: list[Any] = []
        self._call = health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest(), timeout=240)
        threading.Thread(target=self._watch, daemon=True).start()
        assert self.until(health_pb2.HealthCheckResponse.SERVING)

    def _watch(self) -> None:
        with suppress(grpc.RpcError):
            for response in self._call:
                self._seen.append(response.status)

    def until(self, status: Any) -> bool:
        """Whether a status is told, soon."""
        return until(lambda: self._seen and self._seen[-1] == status)

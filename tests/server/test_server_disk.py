"""A real server whose disk takes no more for a while; a limit for the size of its files stands for that."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import grpc
import pytest
from executor_waiting import until
from grpc_health.v1 import health_pb2, health_pb2_grpc
from planner_calls import finished, plan_request, refusal, search_for, uploaded, wait_for
from planner_server import ServerProcess, planner_server

from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.store import DiskError, Store

pytestmark = pytest.mark.filterwarnings("error")

REFUSED = "the server's disk cannot store new results; try another server, or later"


@contextmanager
def _full_disk(pid: int = 0) -> Iterator[None]:
    """Nothing that a process writes to a file is taken."""
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, hard))
    try:
        yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    with planner_server(tmp_path_factory.mktemp("server") / "data") as started:
        yield started


def test_nothing_new_is_taken_in_while_the_disk_is_full_and_what_is_kept_is_there(server: ServerProcess) -> None:
    with grpc.insecure_channel(server.address) as channel:
        stub, health = PlannerServiceStub(channel), health_pb2_grpc.HealthStub(channel)

        def is_serving() -> bool:
            told = health.Check(health_pb2.HealthCheckRequest(service="planner.v1.PlannerService"), timeout=120)
            return bool(told.status == health_pb2.HealthCheckResponse.SERVING)

        before = finished(stub.Plan(plan_request(request_id="before"), timeout=240))
        cloud_id = stub.UploadCloud(uploaded(b"1 2 3\n"), timeout=120).cloud_id
        watch = health.Watch(health_pb2.HealthCheckRequest(), timeout=240)
        assert next(watch).status == health_pb2.HealthCheckResponse.SERVING
        under_way = stub.Plan(plan_request(search_for(3.0)), timeout=240)
        lost_id = wait_for(under_way, "accepted").accepted.plan_id
        wait_for(under_way, "progress")
        with _full_disk(server.process.pid):
            assert refusal(lambda: list(under_way))[:2] == ("UNAVAILABLE", REFUSED)
            clouds = wire.CloudsSpec(clouds=[{"file": cloud_id}])  # type: ignore[list-item]
            for call in (
                lambda: list(stub.Plan(plan_request(), timeout=120)),
                lambda: stub.UploadCloud(uploaded(b"4 5 6\n"), timeout=120),
                lambda: list(stub.BuildScene(wire.BuildSceneRequest(clouds=clouds), timeout=120)),
                lambda: stub.ReviewPlan(_review(before), timeout=120),
            ):
                assert refusal(call)[:2] == ("UNAVAILABLE", REFUSED)
            assert next(watch).status == health_pb2.HealthCheckResponse.NOT_SERVING
            assert not is_serving()
            lost = next(stub.GetPlan(wire.GetPlanRequest(plan_id=lost_id), timeout=120)).record
            assert (lost.state, lost.reason) == (wire.PLAN_STATE_LOST, "its end could not be stored")
            assert finished(stub.Plan(plan_request(request_id="before"), timeout=120)) == before
        assert next(watch).status == health_pb2.HealthCheckResponse.SERVING
        assert is_serving()
        assert finished(stub.Plan(plan_request(), timeout=240)).plan_id
        stub.ReviewPlan(_review(before), timeout=120)
        stub.UploadCloud(uploaded(b"4 5 6\n"), timeout=120)


def test_first_plan_that_a_full_disk_does_not_take_is_refused_in_the_same_words(server: ServerProcess) -> None:
    with grpc.insecure_channel(server.address) as channel:
        stub = PlannerServiceStub(channel)
        assert until(lambda: refusal(lambda: list(stub.Plan(plan_request(), timeout=120)))[0] == "OK")
        with _full_disk(server.process.pid):
            assert refusal(lambda: list(stub.Plan(plan_request(), timeout=120)))[:2] == ("UNAVAILABLE", REFUSED)
        assert "results can be stored again" in server.log.read_text()


def test_store_says_where_it_could_not_write_until_it_can(tmp_path: Path) -> None:
    with Store(tmp_path) as store:
        scene = store.scenes.put("ann", b"{}")
        with _full_disk():
            with pytest.raises(DiskError, match=r"store\.sqlite3: cannot be written"):
                store.plans.begin("ann", "", "0" * 64, "posture")
            assert "store.sqlite3" in store.write_error
            assert store.scenes.get(scene) == b"{}"
            with pytest.raises(DiskError):
                store.probe()
        store.probe()
        assert not store.write_error
        store.plans.begin("ann", "", "0" * 64, "posture")


def _review(plan: wire.PlanFinished) -> wire.ReviewPlanRequest:
    return wire.ReviewPlanRequest(
        plan_id=plan.plan_id,
        decision=wire.DECISION_ACCEPTED,
        trajectory_sha256=plan.result.trajectory.sha256,
        certificate_sha256=plan.result.certificate.sha256,
    )

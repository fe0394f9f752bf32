"""A server whose workers are on a Ray cluster plans as one whose workers are its own."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path

import grpc
import pytest
from planner_calls import ENDLESS, QUICK, finished, plan_request, uploaded, wait_for
from planner_server import planner_server
from ray_cluster import ray_cluster

from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.proto.planner.v1.result_pb2 import VERDICT_CERTIFIED

if importlib.util.find_spec("ray") is None:
    pytest.skip("ray is not installed (make test-ray has an environment with it)", allow_module_level=True)


SCAN = Path(__file__).parents[2] / "examples" / "data" / "valve_scan.pcd"


@pytest.fixture(scope="module")
def stub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlannerServiceStub]:
    data = tmp_path_factory.mktemp("server") / "data"
    with (
        ray_cluster() as cluster,
        planner_server(data, "--executor", cluster, "--spread", "2", workers=2) as server,
        grpc.insecure_channel(server.address) as channel,
    ):
        yield PlannerServiceStub(channel)


def test_plan_on_a_cluster_is_certified_and_told_step_by_step(stub: PlannerServiceStub) -> None:
    responses = list(stub.Plan(plan_request(QUICK), timeout=120))
    assert responses[-1].finished.result.verdict == VERDICT_CERTIFIED
    assert any(response.WhichOneof("event") == "progress" for response in responses)


def test_plan_on_a_cluster_can_be_stopped_and_the_next_one_made(stub: PlannerServiceStub) -> None:
    call = stub.Plan(plan_request(ENDLESS), timeout=120)
    wait_for(call, "progress")
    call.cancel()
    assert finished(stub.Plan(plan_request(QUICK), timeout=120)).result.verdict == VERDICT_CERTIFIED


def test_object_in_an_uploaded_scan_is_found_on_a_cluster(stub: PlannerServiceStub) -> None:
    cloud_id = stub.UploadCloud(uploaded(SCAN.read_bytes(), format="pcd"), timeout=240).cloud_id
    clouds = wire.CloudsSpec(clouds=[{"file": cloud_id}])  # type: ignore[list-item]
    assert stub.Detect(wire.DetectRequest(clouds=clouds, kind="valve"), timeout=120).hits[0].confidence >= 0.5

"""A client that knows nothing but where the server is: it learns the service from its reflection, and plans."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from planner_server import ServerProcess, planner_server

# In a process of its own, so that nothing of the project and no generated code can be known to it.
CLIENT = """
import json, sys
import grpc
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.json_format import MessageToDict
from google.protobuf.message_factory import GetMessageClass
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase

with grpc.insecure_channel(sys.argv[1]) as channel:
    database = ProtoReflectionDescriptorDatabase(channel)
    pool = DescriptorPool(database)

    def call(service, name, request):
        method = pool.FindServiceByName(service).methods_by_name[name]
        make = channel.unary_stream if method.server_streaming else channel.unary_unary
        answer = GetMessageClass(method.output_type)
        invoke = make(f"/{service}/{name}", request_serializer=lambda it: it.SerializeToString(),
                      response_deserializer=answer.FromString)
        return invoke(GetMessageClass(method.input_type)(**request), timeout=60)

    health = call("grpc.health.v1.Health", "Check", {"service": "planner.v1.PlannerService"})
    goal = {"robot": {"name": "atlas"}, "start": {"posture": "stand"}, "goal": {"joints": {"l_arm_elx": 1.2}}}
    responses = list(call("planner.v1.PlannerService", "Plan", {"request": goal}))
    robots = call("planner.v1.PlannerService", "ListRobots", {})
    print(json.dumps({
        "services": sorted(database.get_services()),
        "health": MessageToDict(health)["status"],
        "events": list(dict.fromkeys(it.WhichOneof("event") for it in responses)),
        "result": MessageToDict(responses[-1].finished.result, preserving_proto_field_name=True),
        "robots": [it.name for it in robots.robots],
        "modules": sorted(sys.modules),
    }))
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    with planner_server(tmp_path_factory.mktemp("server") / "data") as started:
        yield started


def test_client_made_of_reflection_alone_plans_and_reads_the_verdict(server: ServerProcess, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-I", "-c", CLIENT, server.address], capture_output=True, text=True, timeout=120, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert not {"service", "scopt", "numpy"} & {name.partition(".")[0] for name in told["modules"]}
    assert {"planner.v1.PlannerService", "grpc.health.v1.Health"} <= set(told["services"])
    assert told["health"] == "SERVING"
    assert told["robots"] == ["atlas"]
    assert told["events"][0] == "accepted"
    assert told["events"][-1] == "finished"
    result = told["result"]
    assert result["verdict"] == "VERDICT_CERTIFIED"
    assert result["certificate"]["status"] == "CERTIFIED"
    elbow = result["trajectory"]["joint_names"].index("l_arm_elx")
    last = result["trajectory"]["positions"][-len(result["trajectory"]["joint_names"]) :]
    assert last[elbow] == pytest.approx(1.2, abs=1e-3)

"""A client that knows nothing but where the server is: it learns the service from its reflection, and plans.

The server is started from a configuration file, and probed at its Unix socket.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import grpc
import pytest
from grpc_reflection.v1alpha import reflection_pb2
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
        return invoke(GetMessageClass(method.input_type)(**request), timeout=240)

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
def server() -> Iterator[ServerProcess]:
    with tempfile.TemporaryDirectory(dir="/tmp") as scratch:  # the path of a socket is short
        config = Path(scratch) / "server.toml"
        config.write_text('socket = "probe.sock"\nmetrics = "127.0.0.1:0"\nbudget = ["egress=200"]\n')
        with planner_server(Path(scratch) / "data", "--config", str(config)) as started:
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


@pytest.mark.parametrize("version", ["v1", "v1alpha"])
def test_reflection_answers_in_both_versions_and_describes_itself(server: ServerProcess, version: str) -> None:
    ask = reflection_pb2.ServerReflectionRequest
    with grpc.insecure_channel(server.address) as channel:
        call = channel.stream_stream(
            f"/grpc.reflection.{version}.ServerReflection/ServerReflectionInfo",
            request_serializer=ask.SerializeToString,
            response_deserializer=reflection_pb2.ServerReflectionResponse.FromString,
        )
        names = {f"grpc.reflection.{it}.ServerReflection" for it in ("v1", "v1alpha")}
        requests = [ask(list_services=""), *(ask(file_containing_symbol=name) for name in sorted(names))]
        services, *files = call(iter(requests), timeout=120)
    assert names <= {it.name for it in services.list_services_response.service}
    assert [len(it.file_descriptor_response.file_descriptor_proto) for it in files] == [1, 1]


def test_a_probe_at_the_socket_learns_that_the_server_accepts_work(server: ServerProcess) -> None:
    def probe(target: str) -> subprocess.CompletedProcess[str]:
        program = [sys.executable, "-c", "from service.cli.app import main; main()", "health", "--target", target]
        return subprocess.run(program, capture_output=True, text=True, timeout=240)

    socket = server.log.parent / "probe.sock"
    answer = probe(f"unix:{socket}")
    assert (answer.returncode, answer.stdout) == (0, "SERVING\n"), answer.stderr
    nobody = probe("127.0.0.1:1")
    assert nobody.returncode == 69
    assert nobody.stderr == "UNAVAILABLE: 127.0.0.1:1 does not answer within 3 s (UNAVAILABLE)\n"

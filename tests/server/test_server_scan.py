"""A real server from a scan to a motion: the cloud is brought, looked at, and worked in."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import grpc
import numpy as np
import pytest
import yaml
from planner_calls import QUICK, finished, plan_request, refusal, uploaded
from planner_server import planner_server

from service.proto.planner.v1 import planner_pb2 as wire
from service.proto.planner.v1.planner_pb2_grpc import PlannerServiceStub
from service.proto.planner.v1.result_pb2 import VERDICT_CERTIFIED

pytestmark = pytest.mark.filterwarnings("error")

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def stub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlannerServiceStub]:
    data = tmp_path_factory.mktemp("server") / "data"
    with planner_server(data) as server, grpc.insecure_channel(server.address) as channel:
        yield PlannerServiceStub(channel)


def test_valve_of_an_uploaded_scan_is_found_and_turned(stub: PlannerServiceStub) -> None:
    scan, truth = EXAMPLES / "data" / "valve_scan.pcd", json.loads((EXAMPLES / "data" / "valve_scan.json").read_text())
    cloud_id = stub.UploadCloud(uploaded(scan.read_bytes(), format="pcd"), timeout=120).cloud_id
    request = yaml.safe_load((EXAMPLES / "requests" / "valve.yaml").read_text())
    clouds = wire.CloudsSpec(clouds=[{"file": cloud_id}], robot="atlas", start=request["start"])  # type: ignore[list-item]

    built = list(stub.BuildScene(wire.BuildSceneRequest(clouds=clouds, detect=["valve"]), timeout=240))
    assert [one.WhichOneof("event") for one in built[:-1]] == ["step"] * (len(built) - 1)
    scene = built[-1].scene
    assert len(scene.pieces) == len(json.loads(scene.json)["pieces"]) > 0
    assert all(len(piece.vertices) % 3 == 0 for piece in scene.pieces)

    assert stub.GetScene(wire.GetSceneRequest(scene_id=scene.scene_id), timeout=120).scene == scene

    low = wire.CloudsSpec(clouds=[{"file": cloud_id}], top_m=0.5, bottom_m=-0.2)  # type: ignore[list-item]
    cropped = stub.Detect(wire.DetectRequest(clouds=low, kind="valve"), timeout=240)
    assert any(" above 0.5 m" in note for note in cropped.notes)

    hit = stub.Detect(wire.DetectRequest(clouds=clouds, kind="valve"), timeout=240).hits[0]
    assert hit == scene.detections[0]
    assert hit.confidence >= 0.5
    pose = np.reshape(hit.pose_world_object, (4, 4))
    assert pose[:3, 3] == pytest.approx(truth["valve"]["centre"], abs=0.01)
    assert hit.sizes["rim_radius"] == pytest.approx(truth["valve"]["rim_radius"], abs=0.005)

    json_id = stub.UploadCloud(uploaded(scene.json, format="json"), timeout=120).cloud_id
    request["task"]["valve"]["turn_deg"] = 45
    for surroundings in ({"cloud": cloud_id}, {"file": scene.scene_id}, {"file": json_id}):
        done = finished(stub.Plan(plan_request({**request, "scene": surroundings}), timeout=240))
        assert done.result.verdict == VERDICT_CERTIFIED, surroundings
        assert done.result.trajectory.is_timed
        assert len(done.result.trajectory.phases) > 1


def test_uploaded_mesh_is_an_obstacle_and_one_that_is_none_is_told_by_its_name(stub: PlannerServiceStub) -> None:
    frame = (EXAMPLES / "data" / "window_frame.obj").read_bytes()
    mesh_id = stub.UploadCloud(uploaded(frame, format="obj"), timeout=120).cloud_id
    request = yaml.safe_load((EXAMPLES / "requests" / "mesh.yaml").read_text())
    request["scene"]["obstacles"][0]["file"] = mesh_id
    assert finished(stub.Plan(plan_request(request), timeout=240)).result.verdict == VERDICT_CERTIFIED
    empty_id = stub.UploadCloud(uploaded(b"solid nothing\nendsolid\n", format="stl"), timeout=120).cloud_id
    cloud_id = stub.UploadCloud(uploaded(b"1 2 3\n4 5 6\n", format="xyz"), timeout=120).cloud_id
    for name, words in ((empty_id, "0 triangles"), (cloud_id, "format '.xyz' is not read"), ("/etc/hostname", "an")):
        request["scene"]["obstacles"][0]["file"] = name
        code, text, fields = refusal(lambda: list(stub.Plan(plan_request(request), timeout=240)))
        assert (code, list(fields)) == ("INVALID_ARGUMENT", ["request.scene.obstacles[0].file"])
        assert words in text
        assert "/data/" not in text


def test_what_was_uploaded_and_is_no_scene_is_told_by_its_name(stub: PlannerServiceStub) -> None:
    no_scene = stub.UploadCloud(uploaded(b'{"format": "other"}', format="json"), timeout=120).cloud_id
    code, _, fields = refusal(lambda: stub.Plan(plan_request(QUICK | {"scene": {"file": no_scene}}), timeout=120))
    assert code == "INVALID_ARGUMENT"
    assert fields == {
        "request.scene.file": f"scene.file: {no_scene} is no scene, its format is 'other'; expected scopt-scene/1"
    }
    code, _, fields = refusal(lambda: stub.Plan(plan_request(QUICK | {"scene": {"cloud": no_scene}}), timeout=120))
    assert code == "INVALID_ARGUMENT"
    assert list(fields) == ["request.scene.cloud"]


def test_a_scene_that_was_never_built_is_told(stub: PlannerServiceStub) -> None:
    scene = {"file": "scene:" + "0" * 64}
    code, _, fields = refusal(lambda: stub.Plan(plan_request(QUICK | {"scene": scene}), timeout=120))
    assert code == "INVALID_ARGUMENT"
    assert "it was removed when the store was full, or never was" in fields["request.scene.file"]
